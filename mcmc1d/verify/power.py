"""Which errors the sequential scheme finds, and with what probability."""

from mcmc1d.verify.battery import Test
from mcmc1d.verify.ledger import Scheme

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
