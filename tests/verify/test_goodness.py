"""The p-values of counts against exact masses: valid under the truth, powerful as stated."""

import numpy as np
import pytest

from mcmc1d.verify.goodness import cdf_gap, cells_p_value, dkw_p_value, p_value, smallest_gap, total_variation

MASSES = np.array([0.4, 0.02, 0.3, 0.001, 0.279])


def draws(masses, n, repeats, seed):
    return np.random.default_rng(seed).multinomial(n, masses, size=repeats)


@pytest.mark.parametrize("p", [dkw_p_value, cells_p_value, p_value])
@pytest.mark.parametrize("level", [0.3, 0.05, 0.01])
def test_false_alarms_are_no_more_than_the_level(p, level):
    """4000 right samples; a rate that exceeds the level by 5 binomial standard deviations has probability 3e-7."""
    alarms = sum(p(counts, MASSES) <= level for counts in draws(MASSES, 500, 4000, 1))
    assert alarms <= 4000 * level + 5 * np.sqrt(4000 * level * (1 - level))


def test_the_stated_gap_is_detected_with_the_stated_probability():
    """1000 wrong samples at the stated gap, power 0.99; under 0.97 has probability 1e-8 if the statement is true."""
    n, level = 4000, 1e-6
    gap = smallest_gap(n, level)
    wrong = MASSES + np.array([gap, 0, 0, 0, -gap])
    assert np.isclose(cdf_gap(wrong, MASSES), gap)
    caught = sum(p_value(counts, MASSES) < level for counts in draws(wrong, n, 1000, 2))
    assert caught >= 970


def test_a_hit_where_the_mass_is_zero_is_rejected_outright():
    assert p_value(np.array([999, 1]), np.array([1.0, 0.0])) == 0


def test_total_variation_of_disjoint_laws_is_one():
    assert total_variation(np.array([1.0, 0.0]), np.array([0.0, 1.0])) == 1


@pytest.mark.parametrize(
    ("counts", "masses", "message"),
    [([1, 2], [1.0], "2 counts"), ([0, 0], [1.0, 1.0], "must be positive"), ([-1, 2], [1.0, 1.0], "not be negative")],
)
def test_bad_input_is_named(counts, masses, message):
    with pytest.raises(ValueError, match=message):
        p_value(np.array(counts), np.array(masses))
