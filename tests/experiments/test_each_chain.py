"""The autocorrelation time by the spread of the chains' means, of a process whose time is known."""

import numpy as np
import pytest

from experiments.support.each_chain import autocorrelation_time


@pytest.mark.parametrize("r", [0.0, 0.5, 0.9])
def test_the_time_of_an_autoregression(r):
    """(1 + r) / (1 - r), less its share of 4000 steps, to six standard errors of 4096 chains' variance (6e-9)."""
    steps, chains = 4000, 4096
    rng = np.random.default_rng(3)
    x = rng.standard_normal(chains)
    sums, squares = np.zeros(chains), np.zeros(chains)
    for _ in range(steps):
        x = r * x + np.sqrt(1 - r * r) * rng.standard_normal(chains)
        sums, squares = sums + x + 5, squares + (x + 5) ** 2
    expected = (1 + r) / (1 - r) - 2 * r * (1 - r**steps) / (1 - r) ** 2 / steps
    found = autocorrelation_time((sums.reshape(8, -1), squares.reshape(8, -1)), steps)
    assert found == pytest.approx(expected, rel=6 * np.sqrt(2 / chains))
