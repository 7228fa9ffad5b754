import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from mcmc1d.quadrature import integrate, integrate_box, midpoints

EDGES = np.array([-0.5, 0.0, 0.1, 0.35, 0.9, 2.0])


@pytest.mark.parametrize(
    ("function", "antiderivative"),
    [
        (lambda x: x**3 - x, lambda x: x**4 / 4 - x**2 / 2),
        (lambda x: jnp.exp(-3 * x) * jnp.cos(20 * x), lambda x: (np.exp((-3 + 20j) * x) / (-3 + 20j)).real),
        (lambda x: 1 / (1e-4 + x * x), lambda x: 100 * np.arctan(100 * x)),
    ],
    ids=["polynomial", "wave", "peak"],
)
def test_known_integrals_and_an_error_estimate_that_bounds_the_error(function, antiderivative):
    value, estimate = integrate(function, EDGES)
    exact = np.diff(antiderivative(EDGES))
    tolerance = 1e-11 * np.abs(exact).sum()
    np.testing.assert_allclose(value, exact, rtol=0, atol=tolerance)
    assert (np.abs(value - exact) <= np.maximum(estimate, 1e-13 * np.abs(exact).sum())).all()


def test_a_function_with_several_values():
    value, _ = integrate(lambda x: jnp.stack([jnp.ones_like(x), 2 * x]), EDGES)
    assert value.shape == (5, 2)
    np.testing.assert_allclose(value, np.stack([np.diff(EDGES), np.diff(EDGES**2)], 1), atol=1e-12)


def test_the_zero_function_integrates_to_zero():
    np.testing.assert_array_equal(integrate(lambda x: 0 * x, EDGES)[0], np.zeros(5))


def step(x):
    return jnp.where(x < 1 / 3, 1.0, 5.0)


STEP_MASSES = [0.5, 0.1, (1 / 3 - 0.1) + 5 * (0.35 - 1 / 3), 2.75, 5.5]


@pytest.mark.parametrize("breaks", [(1 / 3,), (1 / 3, 1 / 3), (-7, 1 / 3, 50, -0.5, 2.0)])
def test_a_declared_jump_is_exact_and_breaks_outside_the_range_do_no_harm(breaks):
    np.testing.assert_allclose(integrate(step, EDGES, breaks)[0], STEP_MASSES, atol=1e-13)


def test_an_undeclared_jump_is_right_all_the_same_or_an_error():
    try:
        value, _ = integrate(step, EDGES)
    except ValueError as error:
        assert "breaks" in str(error)  # noqa: PT017
    else:
        np.testing.assert_allclose(value, STEP_MASSES, atol=1e-10)


def test_hundreds_of_undeclared_jumps_are_an_error_that_names_breaks():
    with pytest.raises(ValueError, match="name the points where the function jumps or bends in `breaks`"):
        integrate(lambda x: jnp.floor(997 * x) % 2, EDGES)


@pytest.mark.parametrize("edges", [[0.0, 0.2, 0.5, 1.0], [0.0, 1.0], np.linspace(0, 1, 22)])
@pytest.mark.parametrize("width", [1e-3, 3e-4, 1e-4, 2e-5])
def test_a_narrow_peak_is_found_whatever_the_bins(width, edges):
    """By a scan of 2**14 points; with coarse bins it fell between the nodes: half a unit of mass was lost."""
    centre = 0.4321

    def function(x):
        return 1 + 0.5 / (width * np.sqrt(2 * np.pi)) * jnp.exp(-0.5 * ((x - centre) / width) ** 2)

    exact = np.diff(np.asarray(edges) + 0.5 * ndtr((np.asarray(edges) - centre) / width))
    np.testing.assert_allclose(integrate(function, np.array(edges))[0], exact, rtol=0, atol=2e-11)


@pytest.mark.parametrize("edges", [[0, 1, 1], [1, 0], [0], [[0, 1], [2, 3]]])
def test_edges_must_rise(edges):
    with pytest.raises(ValueError, match="the edges must rise"):
        integrate(jnp.exp, np.array(edges, float))


def test_a_function_that_is_not_finite_is_an_error():
    with pytest.raises(ValueError, match="not finite"):
        integrate(lambda x: jnp.where(x > 0.5, jnp.nan, 1.0), EDGES)


def test_boxes_finite_and_infinite():
    def normal(x):
        return jnp.exp(-(x @ x) / 2) / (2 * jnp.pi)

    value, error = integrate_box(normal, np.full(2, -np.inf), np.full(2, np.inf))
    assert value == pytest.approx(1, abs=1e-10)
    assert error < 1e-9
    value, _ = integrate_box(lambda x: x[0] * x[1] ** 2, np.array([0.0, 1.0]), np.array([2.0, 4.0]))
    assert value == pytest.approx(42, abs=1e-10)


def test_midpoints():
    np.testing.assert_allclose(midpoints(np.array(0.0), np.array(2.0), 4), [0.25, 0.75, 1.25, 1.75])
    grid = midpoints(np.array([0.0, -1.0]), np.array([1.0, 1.0]), 4)
    np.testing.assert_allclose(grid, [[0.25, -0.5], [0.25, 0.5], [0.75, -0.5], [0.75, 0.5]])


@pytest.mark.parametrize("mark", [np.nextafter(1.0, 0.0), 0.5, np.nextafter(0.5, 1.0)])
def test_a_break_that_rounding_has_put_beside_an_edge_or_another_is_that_one(mark):
    """A piece of one rounding would have nodes at its ends, at which this function is infinite."""

    def function(x):
        return jnp.where((x == 0.5) | (x == 1.0), jnp.inf, step(x))

    value, _ = integrate(function, np.array([0.0, 1.0]), (1 / 3, np.nextafter(0.5, 0.0), mark))
    np.testing.assert_allclose(value, [1 / 3 + 5 * 2 / 3], rtol=1e-12)
