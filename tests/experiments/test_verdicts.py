"""What a claim says where what was looked at is true, false, or not decided."""

import numpy as np
import pytest
from scipy.stats import binom

from experiments.support.intervals import over, ratio, under
from experiments.support.verdict import among, fails, passes, verdict


@pytest.mark.parametrize(
    ("said", "passed", "failed"),
    [
        (["PASS", "PASS"], True, False),
        (["FAIL", "FAIL"], False, True),
        (["PASS", "FAIL", "INCONCLUSIVE"], False, False),
        (["PASS", "INCONCLUSIVE"], None, False),
        (["FAIL", "INCONCLUSIVE"], False, None),
    ],
)
def test_an_inconclusive_verification_decides_nothing(said, passed, failed):
    assert passes(said) is passed
    assert fails(said) is failed


@pytest.mark.parametrize(
    ("conditions", "word"),
    [((True, np.True_), "holds"), ((True, None), "open"), ((None, False), "fails"), ((np.False_, True), "fails")],
)
def test_what_is_false_fails_and_what_is_not_decided_is_open(conditions, word):
    assert verdict(*conditions) == word


def test_scenes_that_differ_are_named_and_one_that_is_refuted_is_not_hidden_by_one_that_is_open():
    assert among({"box": True, "door": False}) == "holds if the scene is box"
    assert among({"box": True, "door": None}) == "open"
    assert among({"box": False, "door": None}) == "fails"
    assert among({"box": True, "lab": False, "door": None}) == "holds if the scene is box"


def test_what_was_looked_at_nowhere_is_open():
    assert among({}) == "open"


def test_an_interval_decides_only_what_it_leaves_out():
    assert under(1, (0.8, 0.7, 0.9)) is True
    assert under(1, (0.8, 0.7, 0.9), (1.2, 1.1, 1.3)) is False
    assert under(1, (0.9, 0.7, 1.1)) is None
    assert over(0.9, (1.2, 1.0, 1.4)) is True
    assert over(0.9, (0.9, 0.8, 1.0)) is None


def test_a_ratios_interval_misses_it_as_often_as_it_says():
    """2000 pairs of 16 lognormal seeds, misses of 10 %: 150 to 254 of them but for a probability of 1e-4."""
    rng = np.random.default_rng(0)
    missed = 0
    for _ in range(2000):
        _, low, high = ratio(np.exp(0.7 * rng.normal(size=16)), 2 * np.exp(0.3 * rng.normal(size=16)), 0.1)
        missed += not low <= 0.5 <= high
    low, high = binom.interval(1 - 1e-4, 2000, 0.1)
    assert low <= missed <= high
