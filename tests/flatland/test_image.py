"""Sums of layers: their values, errors, and intervals at their shares of a level, by hand."""

import numpy as np

from mcmc1d.flatland.integrators import Layer, Stacked, Sums
from mcmc1d.flatland.integrators.compare import interval

ONE = Layer(2, 3.0, Sums(100, np.array([20.0, 40.0]), np.array([6.0, 18.0]), 1.0), None, 200.0)
B = Sums(10, np.array([20.0]), np.array([44.0]), 5.0)
TWO = Layer(2, 1.0, Sums(50, np.array([10.0, 0.0]), np.array([4.0, 0.0]), 1.0), B, 70.0)


def test_a_sum_of_layers_adds_up():
    both = Stacked((ONE, TWO))
    assert np.allclose(both.value, [3 * 0.2 + 2 * 0.2, 3 * 0.4])
    assert np.allclose(both.error**2, ONE.error**2 + TWO.error**2)
    assert (both.edges, both.rays) == (2, 270.0)
    assert np.allclose(both.scaled(0.5).value, both.value / 2)
    assert np.allclose(both.scaled(0.5).error, both.error / 2)


def test_each_layer_is_held_at_its_share_of_the_level():
    low, high = interval(Stacked((ONE, TWO)), 1e-3)
    parts = [interval(part, 0.5e-3) for part in (ONE, TWO)]
    assert np.array_equal(low, parts[0][0] + parts[1][0])
    assert np.array_equal(high, parts[0][1] + parts[1][1])
    assert np.all(high - low > sum(b - a for a, b in (interval(part, 1e-3) for part in (ONE, TWO))))
