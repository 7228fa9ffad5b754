"""Exact masses of planar targets: against closed forms, each other, and a plain fine rule."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discover import examples
from scipy.special import ndtr

from mcmc1d.quadrature import Outline, integrate_plane
from mcmc1d.targets import Banana, Checkerboard, Ring, RotatedMixture
from mcmc1d.techniques import PolarDisk

PLANAR = {name: t for name, t in examples("mcmc1d.targets").items() if np.shape(t.domain[0]) == (2,)}


def uneven_edges(target):
    """From outside the domain to outside it; one bin lies wholly beyond, one across each end."""
    lower, upper = target.domain
    inside = np.array([-1, -0.5, 0.05, 0.3001, 0.55, 0.5500001, 0.9, 1.5])
    return [lower[k] + (upper[k] - lower[k]) * inside for k in range(2)]


@pytest.mark.parametrize("name", PLANAR)
def test_masses_are_the_integral_of_the_density(name):
    """Against Gauss and Legendre's rule of 12 nodes on 96 x 96 boxes, cut at the edges and the outline."""
    target = PLANAR[name]
    edges = uneven_edges(target)
    masses = target.bin_masses(edges)
    t, weights = np.polynomial.legendre.leggauss(12)
    axes = []
    for k, (own, outline) in enumerate(
        zip(edges, (target.outline.x, target.outline.y_at(np.zeros(1))[0]), strict=True)
    ):
        lower, upper = target.domain[0][k], target.domain[1][k]
        cuts = np.unique(np.clip(np.concatenate([own, outline, np.linspace(lower, upper, 97)]), lower, upper))
        half = np.diff(cuts)[:, None] / 2
        axes.append((cuts[:-1, None] + half * (1 + t), half * weights))
    (x, wx), (y, wy) = axes
    with jax.enable_x64(True):
        grid = jnp.stack(jnp.meshgrid(jnp.asarray(x.ravel()), jnp.asarray(y.ravel()), indexing="ij"), -1)
        f = np.exp(jax.jit(jax.vmap(jax.vmap(target.log_f)))(grid))
    expected = np.histogram2d(
        *(part.ravel() for part in np.meshgrid(x.ravel(), y.ravel(), indexing="ij")),
        edges,
        weights=(wx.ravel()[:, None] * wy.ravel() * f).ravel(),
    )[0]
    np.testing.assert_allclose(masses, expected, rtol=0, atol=1e-10 * expected.sum())
    assert masses[0].max() == masses[:, 0].max() == 0  # beyond the domain
    assert expected.sum() > 0


@pytest.mark.parametrize("name", PLANAR)
def test_the_density_is_zero_outside_the_domain(name):
    target = PLANAR[name]
    lower, upper = (np.asarray(corner) for corner in target.domain)
    step = (upper - lower) * 1e-6
    x = np.stack([lower - step, upper + step, np.array([lower[0] - 1, upper[1]]), lower, upper, (lower + upper) / 2])
    with jax.enable_x64(True):
        log_f = np.asarray(jax.jit(jax.vmap(target.log_f))(jnp.asarray(x)))
    np.testing.assert_array_equal(log_f[:3], -np.inf)
    assert not np.isnan(log_f).any()


def test_a_rotated_normal_has_the_marginal_that_rotation_gives_it():
    angle, sigmas = 0.5, np.array([0.06, 0.03])
    target = RotatedMixture([[0.5, 0.45]], [sigmas], [angle], [1.0])
    edges = np.linspace(0, 1, 11)
    deviation = np.sqrt((sigmas[0] * np.cos(angle)) ** 2 + (sigmas[1] * np.sin(angle)) ** 2)
    found = target.bin_masses((edges, np.array([0.0, 1.0])))[:, 0]
    np.testing.assert_allclose(found, np.diff(ndtr((edges - 0.5) / deviation)), rtol=0, atol=1e-10)


def test_the_part_of_a_disk_in_a_cell_is_known():
    """A quadrant's share, and a corner that the circle cuts off: exact by hand."""
    disk = PolarDisk()
    masses, error = integrate_plane(
        lambda x: jnp.exp(disk.log_prob(x)), np.array([-1.0, 0.0, 0.5, 1]), np.array([-1.0, 0, 1]), [disk.outline]
    )
    beyond = (np.pi / 3 - np.sqrt(3) / 4) / np.pi / 2  # half of the segment beyond x = 1/2
    np.testing.assert_allclose(masses[:, 1], [0.25, 0.25 - beyond, beyond], rtol=0, atol=1e-10)
    assert error < 1e-10


def test_a_jump_that_no_outline_names_is_an_error_and_no_number():
    disk = PolarDisk()
    with pytest.raises(ValueError, match="in `outline`"):
        integrate_plane(
            lambda x: jnp.exp(disk.log_prob(x)), np.linspace(-1, 1, 3), np.linspace(-1, 1, 3), [Outline(np.zeros(0))]
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RotatedMixture([[0.5, 0.5]], [[0.1, 0.1]], [0.0, 1.0], [1.0]), "1 weights need"),
        (lambda: RotatedMixture([[0.5, 0.5]], [[0.1, 0.0]], [0.0], [1.0]), "sigmas must be positive"),
        (lambda: Ring(width=0), "width must be positive"),
        (lambda: Banana(noise=-1), "noise must be positive"),
        (lambda: Banana(lower=(3, 0)), "lower corner must lie under"),
        (lambda: Checkerboard([1, 2]), "table of shape"),
        (lambda: Checkerboard([[1, -1]]), "not negative"),
        (lambda: Ring().bin_masses(np.linspace(0, 1, 5)), "a pair"),
        (lambda: Checkerboard([[1.0]]).bin_masses((np.array([0, 1]), np.array([1, 0]))), "edges must rise"),
    ],
)
def test_what_can_not_be_is_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()
