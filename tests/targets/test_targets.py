import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discover import examples

from mcmc1d.targets import FromFunction, GaussianMixture, PiecewiseLinear, Sinusoid, Tabulated

TARGETS = {name: t for name, t in examples("mcmc1d.targets").items() if np.ndim(t.domain[0]) == 0}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


def uneven_edges(target):
    """Bins of many widths, from outside the domain to outside it; one lies wholly beyond, one across each end."""
    lower, upper = (float(end) for end in target.domain)
    inside = [0.001, 0.05, 0.1, 0.3001, 0.55, 0.5500001, 0.83, 0.9999]
    return np.array([lower - 2, lower - 1, *(lower + (upper - lower) * np.array(inside)), upper + 0.5, upper + 3])


def gauss_masses(target, edges):
    """The reference: Gauss-Legendre on 64 pieces of every stretch between edges, breaks and the domain's ends."""
    lower, upper = (float(end) for end in target.domain)
    cuts = np.unique(np.clip([*edges, *target.breaks, lower, upper], lower, upper))
    cuts = np.unique(np.concatenate([np.linspace(a, b, 65) for a, b in itertools.pairwise(cuts)]))
    half = np.diff(cuts)[:, None] / 2
    x = cuts[:-1, None] + half * (1 + NODES)
    with jax.enable_x64(True):
        f = np.exp(jax.jit(jax.vmap(target.log_f))(jnp.asarray(x.ravel()))).reshape(x.shape)
    bins = np.searchsorted(edges, cuts[:-1] + half[:, 0]) - 1
    return np.bincount(bins, (f * half) @ WEIGHTS, minlength=len(edges) - 1)


@pytest.mark.parametrize("name", TARGETS)
def test_bin_masses_are_the_integral_of_the_density(name):
    target = TARGETS[name]
    edges = uneven_edges(target)
    masses = target.bin_masses(edges)
    expected = gauss_masses(target, edges)
    tolerance = 1e-10 * expected.sum()
    np.testing.assert_allclose(masses, expected, rtol=0, atol=tolerance)
    np.testing.assert_allclose(target.quadrature(edges), expected, rtol=0, atol=tolerance)
    assert masses[0] == 0  # beyond the domain
    assert expected.sum() > 0


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_density_is_zero_outside_the_domain_and_not_nan_inside(name, dtype):
    target = TARGETS[name]
    lower, upper = (dtype(end) for end in target.domain)
    step = (upper - lower) * np.finfo(dtype).eps
    x = np.array([lower - 1, lower - step, upper + step, upper + 1, lower, upper - step, upper], dtype)
    with jax.enable_x64(True):
        log_f = np.asarray(jax.jit(jax.vmap(target.log_f))(jnp.asarray(x)))
    np.testing.assert_array_equal(log_f[:4], -np.inf)
    assert not np.isnan(log_f).any()
    assert (log_f < np.inf).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sinusoid(1.1), "amplitude of 1.1 makes the target negative"),
        (lambda: Sinusoid(scale=0), "scale must be positive"),
        (lambda: GaussianMixture([0.5], [0.1, 0.2], [1.0]), "lists of one length"),
        (lambda: GaussianMixture([0.5], [0.0], [1.0]), "sigmas must be positive"),
        (lambda: GaussianMixture([np.nan], [0.1], [1.0]), "means must be finite"),
        (lambda: PiecewiseLinear([0, 0], [1, 1]), "edges must rise"),
        (lambda: PiecewiseLinear([0, 1], [1, -1]), "not negative"),
        (lambda: PiecewiseLinear([0, 1], [1, 1, 1]), "2 edges need 2 values"),
        (lambda: Tabulated([0, 0]), "zero everywhere"),
        (lambda: Tabulated([1, np.nan]), "finite"),
    ],
)
def test_what_is_no_density_is_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_function_that_turns_negative_becomes_nan_inside_its_domain_only():
    target = FromFunction(lambda x: x - 0.5, -1, 2)
    assert jnp.isnan(target.log_f(jnp.asarray(0.25)))
    assert target.log_f(jnp.asarray(2.5)) == -jnp.inf
    assert target.log_f(jnp.asarray(1.5)) == 0
