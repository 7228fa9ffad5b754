"""Which errors the sequential scheme finds, and with what probability."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mcmc1d.verify.battery import OneSample, Test
from mcmc1d.verify.ledger import Scheme

LEAST = 16
"""The fewest replicas of a first stage."""

_SIZES = [LEAST]
while _SIZES[-1] < 2**27:
    _SIZES.append(int(_SIZES[-1] * 1.02) + 1)
"""What is tried, two per cent apart."""

_LATER = 0.01  # the share of the probability of a miss that is left to the second stage, which has draws to spare


def detectable(test: Test, scheme: Scheme, tests: int, n: int, grow: int, power: float) -> float | None:
    """The smallest CDF gap that one of so many tests makes the scheme fail with probability `power`; None if none is.

    `n`: the first stage's replicas; the second has `grow` times as many. There are two ways to fail, and the one that
    shows the smaller gap counts: at the first stage; or not to pass there, which takes a p-value of gamma + beta_1
    only, and to fail at the second. A kernel that is off by the gap is missed by the second way if it passes at the
    first stage or does not fail at the second: the probabilities of both are bounded, and add up to 1 - `power`.
    """
    miss = 1 - power
    at_once = test.gap(n, scheme.first / tests, miss)
    if at_once is None or scheme.stages == 1:
        return at_once
    goes_on = test.gap(n, (scheme.gamma + scheme.first) / tests, (1 - _LATER) * miss)
    then_fails = test.gap(grow * n, scheme.beta(2) / tests, _LATER * miss)
    return at_once if goes_on is None or then_fails is None else min(at_once, max(goes_on, then_fails))


@dataclass(frozen=True)
class Power:
    """What so many replicas show, of all tests of a verification."""

    scheme: Scheme
    tests: Sequence[Test]
    looks: int
    """p-values in a stage: of every test after each number of steps."""
    power: float
    """The probability with which a gap is to be detected."""

    def detectable(self, test: Test, n: int, grow: int) -> float | None:
        """The smallest gap that a test shows, of n replicas in the first stage; None if none is meant."""
        return detectable(test, self.scheme, self.looks, n, grow, self.power)

    def gap(self, n: int, grow: int, *, known: bool = False) -> float:
        """The smallest gap that n replicas detect in every coordinate, or in those alone whose CDF is `known`.

        Of a coordinate without an order, the gap is in the probability of a cell. Infinite where no coordinate varies.
        """
        tests = self.headline
        if known:
            tests = [test for test in tests if isinstance(test, OneSample)] or tests
        gaps = [self.detectable(test, n, grow) for test in tests]
        return max((g for g in gaps if g is not None), default=np.inf)

    @property
    def gap_in(self) -> tuple[str, ...]:
        """In what the gap of the coordinates' laws is one: "CDF", or where values have no order "cell"."""
        ordered = {not isinstance(test, OneSample) or test.ordered for test in self.headline}
        return tuple(what for what, order in (("CDF", True), ("cell", False)) if order in ordered)

    def replicas(self, gap: float, grow: int, *, known: bool) -> int:
        """How many show the gap, to 2 %; the more, the smaller the gap."""
        k = bisect.bisect_left(_SIZES, -gap, key=lambda n: -self.gap(n, grow, known=known))
        return _SIZES[min(k, len(_SIZES) - 1)]

    @property
    def headline(self) -> list[Test]:
        """The tests of the coordinates' own laws, the auxiliary ones left out."""
        return [test for test in self.tests if test.headline]
