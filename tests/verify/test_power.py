"""What the sequential scheme is said to detect, simulated: the scheme's own decisions on counts of exact laws."""

import numpy as np
import pytest

from mcmc1d.verify import Discrete
from mcmc1d.verify.battery import OneSample, TwoSample
from mcmc1d.verify.ledger import Scheme
from mcmc1d.verify.power import detectable

MASSES = np.array([0.1, 0.2, 0.2, 0.15, 0.35])
TEST = OneSample("x", Discrete(lambda x: x, MASSES, ordered=True))
TESTS, REPLICAS, GROW, RUNS = 30, 20_000, 4, 1500


def failures(gap: float, scheme: Scheme, test: OneSample = TEST, runs: int = RUNS) -> float:
    """How often the scheme fails a law that is off by a CDF gap in the middle, where a count varies most.

    Or, of what has no order, by as much in the probability of the cell nearest to one half. The other tests, all right,
    are left out: they can only add failures.
    """
    rng, failed = np.random.default_rng(3), 0
    wrong = MASSES + gap * (np.array([0, 0.5, 0.5, -0.5, -0.5]) if test.ordered else np.array([0, -0.5, -0.5, 0, 1]))
    for _ in range(runs):
        decision, stage, n = "more", 0, REPLICAS
        while decision == "more":
            stage, n = stage + 1, n * GROW if stage == 1 else n
            counts = np.append(rng.multinomial(n, wrong), 0)
            decision = scheme.decide(stage, min(1.0, TESTS * test.p_value((counts,))))
        failed += decision == "fail"
    return failed / runs


def test_the_stated_gap_is_detected_with_the_stated_power():
    """Power 0.99; under 0.975 of 1500 has probability 1e-6 if the statement is true. Half of the gap must be missed."""
    scheme = Scheme()
    gap = detectable(TEST, scheme, TESTS, REPLICAS, GROW, 0.99)
    assert gap is not None
    assert failures(gap, scheme) >= 0.975
    assert failures(gap / 2, scheme) < 0.9


def test_the_second_stage_is_worth_a_quarter_of_the_gap():
    at_once = TEST.gap(REPLICAS, Scheme().first / TESTS, 0.01)
    assert at_once is not None
    assert detectable(TEST, Scheme(), TESTS, REPLICAS, GROW, 0.99) == pytest.approx(0.765 * at_once, rel=0.01)
    # One of the same size is worth nothing.
    assert detectable(TEST, Scheme(), TESTS, REPLICAS, 1, 0.99) == at_once


def test_of_what_has_no_order_the_gap_is_in_the_probability_of_a_cell():
    """Of fresh draws, whose cells' probabilities are not known, there is none."""
    test = OneSample("x", Discrete(lambda x: x, MASSES))
    gap = detectable(test, Scheme(), TESTS, REPLICAS, GROW, 0.99)
    assert gap is not None
    assert failures(gap, Scheme(), test, 300) >= 0.95
    assert failures(gap / 2, Scheme(), test, 300) < 0.9
    compared = TwoSample("x", None, np.arange(4) + 0.5, ordered=False)
    assert detectable(compared, Scheme(), TESTS, REPLICAS, GROW, 0.99) is None
