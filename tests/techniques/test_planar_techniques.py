"""Planar techniques beyond their contract: exact integrals of their densities, and mistakes that must be caught."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discover import examples, nested_types

from mcmc1d.quadrature import integrate_plane
from mcmc1d.techniques import (
    ConcentricDisk,
    MarginalConditional,
    Mixture,
    Planar,
    PolarDisk,
    ProjectedCap,
    Rectangle,
    Technique,
    Triangle,
    sample_shape,
)
from mcmc1d.techniques.planar import outlines
from mcmc1d.verify import check_technique

PLANAR = {
    name: technique
    for name, technique in examples("mcmc1d.techniques").items()
    if any(issubclass(kind, Planar) for kind in nested_types(technique))
}
TABLE = MarginalConditional([[1, 2, 0.5], [0, 0, 0], [4, 0, 1]], (-1, 0), (1, 3))
PLANAR["disk over a table"] = Mixture((TABLE, PolarDisk((0.2, 0.8), 1.1)), (0.6, 0.4))


@pytest.mark.parametrize("name", PLANAR)
def test_the_density_integrates_to_one_and_over_cells_to_their_share_of_samples(name):
    """The integral to 1e-9; the share of 2^14 samples in each cell within 6 standard deviations, 4e-7 for 200 cells."""
    technique = PLANAR[name]
    assert sample_shape(technique) == (2,)
    lower, upper = (np.asarray(corner, np.float64) for corner in technique.support)
    x_edges, y_edges = (np.linspace(lower[k], upper[k], n) for k, n in enumerate((6, 5)))
    masses, error = integrate_plane(lambda x: jnp.exp(technique.log_prob(x)), x_edges, y_edges, outlines(technique))
    assert error < 1e-10
    assert abs(masses.sum() - 1) < 1e-9
    u = np.random.default_rng(1).random((2**14, technique.dim_u))
    with jax.enable_x64(True):
        x = np.asarray(jax.jit(jax.vmap(lambda u: technique.forward(u)[0]))(jnp.asarray(u)))
    found = np.histogram2d(*x.T, (x_edges, y_edges))[0]
    assert np.all(np.abs(found - len(u) * masses) <= 6 * np.sqrt(len(u) * masses) + 1e-6)


class PolarDiskWithoutTheRoot(Technique):
    """r = u0: the area's Jacobian is missing, and the density is not the one claimed."""

    dim_u = 2
    support = (np.array([-1.0, -1.0]), np.array([1.0, 1.0]))

    def forward(self, u):
        x, v, log_det = PolarDisk().forward(u)
        return x * jnp.sqrt(u[0]), v, log_det

    def inverse(self, x, v):
        u, log_det = PolarDisk().inverse(x, v)
        return u.at[0].set(jnp.sqrt(u[0])), log_det

    def log_prob(self, x):
        return PolarDisk().log_prob(x)


class ConcentricDiskOfTheSquare(Technique):
    """The determinant of the map from [-1, 1]^2, pi / 4: the factor 4 of the square's area is forgotten."""

    dim_u = 2
    support = (np.array([-1.0, -1.0]), np.array([1.0, 1.0]))

    def forward(self, u):
        x, v, log_det = ConcentricDisk().forward(u)
        return x, v, log_det - np.log(4)

    def inverse(self, x, v):
        u, log_det = ConcentricDisk().inverse(x, v)
        return u, log_det + np.log(4)

    def log_prob(self, x):
        return ConcentricDisk().log_prob(x) + np.log(4)


@pytest.mark.parametrize("wrong", [PolarDiskWithoutTheRoot(), ConcentricDiskOfTheSquare()])
def test_a_wrong_jacobian_breaks_the_contract(wrong):
    report = check_technique(wrong, points=500, dtypes=(np.float64,))
    assert "forward's log_det = log|det d(x, v)/du| by autodiff" in str([f.equation for f in report.failures])


def test_the_concentric_map_is_continuous_and_the_centre_its_own():
    with jax.enable_x64(True):
        disk = ConcentricDisk()
        t = jnp.linspace(0, 1 - 1e-12, 401)
        along = jnp.stack([t, t], 1)  # a diagonal, where the formula changes
        beside = jnp.stack([t, jnp.minimum(t + 1e-9, 1 - 1e-12)], 1)
        x, y = (np.asarray(jax.vmap(lambda u: disk.forward(u)[0])(u)) for u in (along, beside))
        assert np.abs(x - y).max() < 4e-9
        assert np.all(np.asarray(disk.forward(jnp.array([0.5, 0.5]))[0]) == 0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rectangle((0, 0), (1, 0)), "lower corner must lie under"),
        (lambda: Rectangle(0.0, 1.0), "corners must be points of the plane"),
        (lambda: PolarDisk(radius=0), "radius must be positive"),
        (lambda: ConcentricDisk((0, np.nan)), "centre must be finite"),
        (lambda: ConcentricDisk((0, 0, 0)), "centre must be a point of the plane"),
        (lambda: ProjectedCap(0.0), "strictly between 0 and 1"),
        (lambda: Triangle([[0, 0], [1, 1], [2, 2]]), "not on one line"),
        (lambda: Triangle([[0, 0], [1, 1]]), "three vertices"),
        (lambda: MarginalConditional([1, 2]), "table of shape"),
        (lambda: MarginalConditional([[1, -2]]), "not negative"),
        (lambda: MarginalConditional([[0, 0]]), "zero everywhere"),
    ],
)
def test_what_is_no_technique_is_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()
