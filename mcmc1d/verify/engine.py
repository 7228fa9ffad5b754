"""`verify`: a verdict with an error rate, for any kernel whose stationary law is known exactly."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mcmc1d.checks import require
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.verify.adapters import as_subject
from mcmc1d.verify.law import as_law
from mcmc1d.verify.ledger import Ledger, Scheme
from mcmc1d.verify.report import Report
from mcmc1d.verify.sampler import Sampler, entropy
from mcmc1d.verify.statistic import Statistic
from mcmc1d.verify.trial import Trial
from mcmc1d.verify.verdict import concluded


def verify(
    kernel: Any,
    target: Any,
    *,
    seed: int = 0,
    level: float | None = None,
    gap: float | None = None,
    power: float = 0.99,
    seconds: float = 40.0,
    replicas: int | None = None,
    steps: Sequence[int] = (1, 4, 16, 64),
    reversible: bool | None = None,
    ergodic: bool = True,
    deposits: Callable | None = None,
    max_weight: float = 1.0,
    statistics: Mapping[str, Statistic] | None = None,
    name: str = "",
    ledger: Ledger | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Report:
    """Whether a kernel leaves a law invariant, moves, and gets there; with the error rate of saying so.

    Independent replicas start exactly from the law and are tested after each of `steps` steps: no burn-in, no
    autocorrelation, p-values that hold far in the tail. Sequential after Gandy and Scott (see `Scheme`); never
    repeated on failure. The same seed and `replicas` give the same report, unless the walk from bad starts is cut
    short, by time: then INCONCLUSIVE may be PASS on a faster machine.

    Args:
        kernel: a move or kernel of this library (`target` a `Multiplexed`); a JAX function `step(key, position)` that
            returns the position, or (position, info); a `JaxKernel`, a `HostKernel`; a BlackJAX algorithm, a NumPyro
            kernel, an emcee move.
        target: a `Law`, a `Multiplexed`, a frozen scipy distribution, or an object with `sample` and `cdf`.
        seed: of all random numbers, with `name`.
        level: the probability that a right kernel fails; 1e-5, or the ledger's share.
        gap: the CDF gap to detect, or be INCONCLUSIVE. Without it 0.005 is aimed at, and whatever up to 0.05 the time
            affords is reported. Of values without an order, the gap in the probability of one of them.
        power: the probability with which the gap is detected.
        seconds: what a first stage may take, in stepping and counting; compiling comes on top, and so do further
            stages, which a right kernel needs with a probability of 0.04: as large, or four times as large where that
            takes less than `seconds` too. One that needs less takes less.
        replicas: how many in the first stage, whatever that takes; INCONCLUSIVE where they do not show the `gap`, 0.05
            unless given.
        steps: after how many steps the law is tested.
        reversible: declare detailed balance, so that (first, last) must be exchangeable. Declared for moves of this
            library, and for nothing else.
        ergodic: False for a kernel that is only invariant, such as one half of a Gibbs sweep: then it need not move
            every coordinate nor forget a bad start.
        deposits: `(state, info) -> (points, weights)` of a JAX kernel: what an estimator adds up after each step. Its
            expectation must be the law's.
        max_weight: a bound on the deposits' total weight in a step.
        statistics: what else is known exactly of the law's positions, by name; see `Law.statistics`.
        name: of the test; the random numbers derive from it and from the seed.
        ledger: deals out the level.
        progress: called with the replicas done and the replicas of the stage.

    Raises `ValueError` for a kernel or a law that can not be run, `LawError` for a law whose sampler and exact values
    disagree.

    """
    began = time.perf_counter()
    forget_what_has_changed(kernel, target, statistics, deposits)
    law = as_law(target)
    law = replace(law, statistics={**law.statistics, **(statistics or {})})
    subject = as_subject(kernel, target, law, reversible=reversible, deposits=deposits, max_weight=max_weight)
    require(
        isinstance(steps, Sequence)
        and not isinstance(steps, str)
        and list(steps) == sorted(set(steps))
        and len(steps) > 0
        and steps[0] >= 1,
        f"steps are whole numbers that rise from 1 on, such as (1, 4, 16, 64), not {steps}",
    )
    require(level is None or ledger is None, "give level= or ledger=, not both: the ledger deals out the level")
    require(gap is None or 0 < gap < 1, f"gap is a difference of two CDFs, between 0 and 1, not {gap}")
    require(seconds > 0, f"seconds is a time and positive, not {seconds}")
    for what, value in (("seed", seed), ("replicas", replicas), *(("steps", k) for k in steps)):
        require(value is None or isinstance(value, int | np.integer), f"{what} must be a whole number, not {value!r}")
    require(0.5 <= power < 1, f"power is a probability from 0.5 to 1, not {power}")
    require(max_weight >= 1, f"max_weight is the largest total weight of a step, 1 or more, not {max_weight}")
    require(name is None or isinstance(name, str), f"name is a text, not {name!r}")
    name = name or f"{subject.name} on {law.name}"
    if level is None:
        level = 1e-5 if ledger is None else ledger.share(name)
    sampler = Sampler(law, subject, entropy(seed, name), tuple(steps), max_weight)
    trial = Trial(sampler, Scheme(level), power, progress)
    trial.prepare()
    trial.size(gap, seconds, replicas)
    trial.decide(ergodic)
    return concluded(trial, name, seed, gap, time.perf_counter() - began)
