"""Whether a kernel forgets a bad start: the part of ergodicity that stationary starts can not show."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import jax
import numpy as np

from mcmc1d.verify.battery import OneSample, Replicas, Test, coordinates
from mcmc1d.verify.law import Position
from mcmc1d.verify.subject import Look, Subject

REPLICAS = 8192
_WITHIN = 0.06  # three times the DKW deviation of 8192 draws at probability 1e-3, which is 0.02
_STEPS = tuple(4**j for j in range(3, 8))
_PERIODIC_AFTER = 2**12  # a second eigenvalue of -0.9993 is forgotten by then
_SECONDS = 15.0  # after which four times the steps are not tried


@dataclass
class Forgetting:
    """What many chains from one bad point have shown."""

    steps: int | None = None
    """After so many their law was near the right one."""
    reasons: list[str] = field(default_factory=list)
    """Why the kernel is wrong."""
    doubts: list[str] = field(default_factory=list)
    """Why nothing can be said."""


def forgets(
    subject: Subject,
    tests: Sequence[Test],
    start: Position,
    fresh: Position,
    seed: Sequence[int],
    inspect: Callable[[Position, Look, int], list[str]],
) -> Forgetting:
    """Walk from `start`, all replicas at bad points, until the law is within 0.06 of the right one, in CDF.

    After powers of four of steps, and once more a step later: a chain that runs through several laws in turn is near
    the right one in the mean only. `fresh`: exact draws to compare with. `inspect` says what is wrong with states.
    """
    n, begin = len(jax.tree.leaves(start)[0]), time.perf_counter()
    within = max(_WITHIN, 3 * float(np.sqrt(np.log(2e3) / (2 * n))))
    walk = subject.walk(seed, start, [t + k for t in _STEPS for k in (0, 1)])
    history: list[str] = []
    first = coordinates(start)
    origin = point(first, 0)
    t, last, alike = 0, first, False
    for t in _STEPS:
        looks = [next(walk), next(walk)]
        for k, look in enumerate(looks):
            if wrong := inspect(start, look, t + k):
                return Forgetting(reasons=wrong)
        counts = [[test.count(Replicas(start, look, fresh, np.zeros(n))) for test in tests] for look in looks]
        both = [tuple(a + b for a, b in zip(*pair, strict=True)) for pair in zip(*counts, strict=True)]
        now, then = (_distance(tests, each, n) for each in counts)
        history.append(f"{now:.2f} after {t}")
        if now <= within:
            return Forgetting(t)
        if t >= _PERIODIC_AFTER and min(now, then) > 2 * within and _distance(tests, both, 2 * n) <= within:
            return Forgetting(
                reasons=[
                    f"it is periodic: from {origin} the laws after {t} and {t + 1} steps are {now:.2f} and {then:.2f} "
                    "from the right one, and their mean is not"
                ]
            )
        last = coordinates(looks[1].positions)
        alike = all(len(np.unique(values)) == 1 for values in last.values())
        if time.perf_counter() - begin > _SECONDS:
            break
    if alike and any(np.any(last[name] != first[name]) for name in first):
        return Forgetting(
            reasons=[f"it is deterministic: all {n} replicas from {origin} are at {point(last, 0)} after {t + 1} steps"]
        )
    return Forgetting(
        doubts=[
            f"it has not forgotten a bad start: from {origin} its distance in CDF from the law is "
            f"{', '.join(history)} steps; it is slow, or can not get everywhere (ergodic=False to leave this out)"
        ]
    )


def _distance(tests: Sequence[Test], counts: Sequence[tuple[np.ndarray, ...]], n: int) -> float:
    """How far the counted laws are from the right ones: the largest CDF gap, or difference of a cell."""
    return max((_difference(test, each, n) for test, each in zip(tests, counts, strict=True)), default=0.0)


def _difference(test: Test, counts: tuple[np.ndarray, ...], n: int) -> float:
    if isinstance(test, OneSample):
        if test.gap(n, 0.5, 0.5) is not None:
            return test.measured_gap(counts)
        return float(np.abs(counts[0][:-1] / n - test.masses).max())
    more, less = counts
    return float(np.abs(more - less).max() / n)


def point(columns: dict[str, np.ndarray], k: int) -> str:
    """Replica k's coordinates, in words."""
    return "(" + ", ".join(f"{name} = {values[k]:.6g}" for name, values in columns.items()) + ")"
