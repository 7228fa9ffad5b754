"""How many replicas a verification takes: what the gap needs, what the time affords, and what is then said of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from mcmc1d.verify import Discrete
from mcmc1d.verify.battery import OneSample
from mcmc1d.verify.ledger import Scheme
from mcmc1d.verify.power import Power
from mcmc1d.verify.sampler import Sampler
from mcmc1d.verify.trial import AIM, Trial

TEST = OneSample("x", Discrete(lambda x: x, np.full(100, 0.01), ordered=True))
POWER = Power(Scheme(), [TEST], 30, 0.99)
TWO_STAGES, AT_ONCE = (POWER.replicas(0.02, grow, known=False) for grow in (4, 1))


class Timed(Sampler):
    """One that does so many replicas a second, one at a time."""

    workers = 1

    def __init__(self, affordable: float):
        self.subject, self.affordable = SimpleNamespace(unit=1, least_unit=1), affordable

    def seconds_a_replica(self) -> float:
        return 1 / self.affordable


def sized(affordable: float, gap: float | None = 0.02, replicas: int | None = None) -> Trial:
    """A trial that has a second."""
    trial = Trial(Timed(affordable), Scheme(), 0.99, None)
    trial.power = POWER
    trial.size(gap, 1.0, replicas)
    return trial


@pytest.mark.parametrize("share", [0.3, 0.98, 1.0, 1.01, 1.2, 1.02 * AT_ONCE / TWO_STAGES, 3.8, 4.2])
def test_the_replicas_of_a_report_make_the_same_run_again(share):
    timed = sized(share * TWO_STAGES)
    again = sized(1.0, replicas=timed.n)
    assert (again.n, again.grow) == (timed.n, timed.grow)


def test_a_gap_takes_fewer_replicas_where_a_second_stage_decides():
    assert TWO_STAGES < 0.7 * AT_ONCE


@pytest.mark.parametrize(
    ("affordable", "replicas", "grow"),
    [
        (4.2 * TWO_STAGES, TWO_STAGES, 4),  # both stages fit the time
        (3.8 * TWO_STAGES, AT_ONCE, 1),  # the second does not: found at once
        (1.02 * AT_ONCE, AT_ONCE, 1),
        (0.98 * AT_ONCE, TWO_STAGES, 4),  # at once it can not be found; by two stages it can
        (1.01 * TWO_STAGES, TWO_STAGES, 4),
    ],
)
def test_the_gap_asked_for_is_bought_in_the_time(affordable, replicas, grow):
    trial = sized(affordable)
    assert trial.grow == grow
    assert replicas <= trial.n <= replicas + 16  # whole looks
    assert trial.power.gap(trial.n, trial.grow) <= 0.02


def test_what_is_too_slow_gets_its_time_and_claims_no_more_than_it_buys():
    trial = sized(0.5 * TWO_STAGES)
    assert trial.grow == 1
    assert 0.4 * TWO_STAGES < trial.n < 0.5 * TWO_STAGES + 16
    assert trial.power.gap(trial.n, trial.grow) > 1.4 * 0.02


def test_replicas_that_are_given_are_taken_whatever_the_time():
    assert sized(1.0, replicas=100).n == 100
    assert sized(1.0, replicas=100).grow == 1
    assert sized(1.0, replicas=TWO_STAGES).grow == 4
    with pytest.raises(ValueError, match="give 16 or more"):
        sized(1.0, replicas=15)


def test_without_a_gap_the_aim_is_bought():
    trial = sized(1e9, gap=None)
    assert trial.power.gap(trial.n, trial.grow) <= AIM < trial.power.gap(trial.n // 2, trial.grow)
