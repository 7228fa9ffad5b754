"""Intervals of ratios over runs, and of the largest of many pixels: how often they miss, with long tails."""

import numpy as np
import pytest
from scipy.stats import binom

from experiments.support.bootstrap import critical, ratios

RNG_CASES, RUNS = 800, 200


def runs(rng, factor, spread):
    return factor * np.exp(spread * rng.normal(size=(RNG_CASES, RUNS)))


@pytest.fixture(scope="module")
def found():
    """Of lognormal errors, the lower ones 0.8 times the higher."""
    rng = np.random.default_rng(0)
    return ratios(runs(rng, 0.8, 0.5), runs(rng, 1.0, 0.5), 0.1, draws=1000)


@pytest.mark.parametrize(("part", "most"), [("means", 0.1), ("deviations", 0.14)])
def test_an_interval_misses_the_ratio_about_as_often_as_it_says(found, part, most):
    """Asked for 10 %: at most 10 % of means and 14 % of standard deviations (fourth moments are slow), but for 1e-4."""
    _, low, high = getattr(found, part).T
    missed = int(((low > 0.8) | (high < 0.8)).sum())
    assert binom.ppf(1e-4, RNG_CASES, 0.06) <= missed <= binom.isf(1e-4, RNG_CASES, most)
    # A twin that must fail: a ratio that is not theirs.
    assert ((low > 1.0) | (high < 1.0)).mean() > 0.3


def test_the_middle_is_the_ratio_of_means_and_of_standard_deviations():
    above, below = np.random.default_rng(1).gamma(1.0, size=(2, 3, 50))
    means, deviations = ratios(above, below, 0.1, draws=100)
    assert np.allclose(means[:, 0], above.mean(1) / below.mean(1))
    assert np.allclose(deviations[:, 0], above.std(1) / below.std(1))
    assert np.all((means[:, 1] < means[:, 0]) & (means[:, 0] < means[:, 2]))


def test_the_largest_of_many_means_strays_farther_than_one():
    """As of a normal distribution at 5 %: 1.96 for a pixel, 3.01 for twenty; a dark pixel does not count."""
    values = np.random.default_rng(2).normal(size=(1000, 20))
    assert critical(values[:, :1], 0.05, draws=4000) == pytest.approx(1.96, abs=0.12)
    assert critical(values, 0.05, draws=4000) == pytest.approx(3.01, abs=0.15)
    dark = np.concatenate([values, np.zeros((1000, 1))], 1)
    assert critical(dark, 0.05, draws=4000) == pytest.approx(critical(values, 0.05, draws=4000))
