"""Whether a kernel forgets bad starts: the part of ergodicity that stationary starts can not show."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import jax
import numpy as np

from mcmc1d.verify.battery import OneSample, Replicas, Test, TwoSample, coordinates
from mcmc1d.verify.statistic import Position
from mcmc1d.verify.subject import Look, Subject

REPLICAS = 8192
"""All told; each start has its share."""
_STEPS = tuple(4**j for j in range(3, 8))
_PERIODIC_AFTER = 2**12  # steps; a kernel that leaves its period once in 1000 has forgotten it by then
_STEADY = 2**22
"""Steps of all replicas from a start, after which a period or a fixed way that none has ever left is a failure.

Of a kernel that leaves it once in 100,000 steps none has with a probability of e^-42, far under any level.
"""
_SECONDS = 15.0  # of the processor's time, not of a loaded machine's, after which four times the steps are not tried


@dataclass
class Forgetting:
    """What many chains from each of a few bad points have shown."""

    steps: int | None = None
    """After so many their laws were all near the right one..."""
    within: float = 0.0
    """...by this CDF gap, and this total variation on a few cells, or less."""
    reasons: list[str] = field(default_factory=list)
    """Why the kernel is wrong."""
    doubts: list[str] = field(default_factory=list)
    """Why nothing can be said."""


@dataclass(frozen=True)
class Partition:
    """A few cells, whose shares are compared with those of fresh draws: no test, but a distance."""

    cell: Callable[[Position], np.ndarray]
    size: int

    def count(self, replicas: Replicas) -> tuple[np.ndarray, ...]:
        mine, fresh = (self.cell(where) for where in (replicas.look.positions, replicas.fresh))
        return np.bincount(mine, minlength=self.size), np.bincount(fresh, minlength=self.size)

    def distance(self, counts: tuple[np.ndarray, ...], n: int) -> float:
        """The total variation of the two."""
        return float(np.abs(counts[0] - counts[1]).sum() / 2 / n)


def forgets(
    subject: Subject,
    tests: Sequence[Test | Partition],
    starts: Sequence[Position],
    fresh: Position,
    seed: Sequence[int],
    inspect: Callable[[Position, Look, int], list[str]],
    outside: Callable[[Position, Look, int], tuple[int, str]],
) -> Forgetting:
    """Walk from each of `starts`, n replicas at each, until every law is near the right one, in CDF and on a few cells.

    Near is three times the DKW deviation of n draws at probability 1e-3. After powers of four of steps, and once more a
    step later: a chain that runs through several laws in turn is near the right one in the mean only. It is periodic
    where no replica ever leaves its turn, which its places tell; else, or where too few steps were made to know, it is
    a doubt. `fresh`: n exact draws to compare with. `inspect` says what is wrong with states, `outside` how many are
    not in the support.
    """
    begin = time.process_time()
    n, groups = len(jax.tree.leaves(fresh)[0]), len(starts)
    within = 3 * float(np.sqrt(np.log(2e3) / (2 * n)))
    start = jax.tree.map(lambda *parts: np.concatenate(parts), *starts)
    walk = subject.walk(seed, start, [t + k for t in _STEPS for k in (0, 1)])
    first = coordinates(start)
    history: dict[int, list[str]] = {g: [] for g in range(groups)}
    swings: dict[int, str] = {}
    t, last, worst = 0, first, 0
    for t in _STEPS:
        looks = [next(walk), next(walk)]
        for k, look in enumerate(looks):
            if wrong := inspect(start, look, t + k):
                return Forgetting(reasons=wrong)
            count, example = outside(start, look, t + k)
            if count:
                return Forgetting(
                    doubts=[f"of {groups * n} replicas from bad starts {count} leave the support, {example}"]
                )
        before, last = (coordinates(look.positions) for look in looks)
        gaps = []
        for g in range(groups):
            own = slice(g * n, (g + 1) * n)
            counts = [[test.count(_slice(start, look, fresh, own)) for test in tests] for look in looks]
            both = [tuple(a + b for a, b in zip(*pair, strict=True)) for pair in zip(*counts, strict=True)]
            now, then = (_distance(tests, each, n) for each in counts)
            gaps.append(now)
            history[g].append(f"{now:.2f} after {t}")
            if t >= _PERIODIC_AFTER and min(now, then) > 2 * within and _distance(tests, both, 2 * n) <= within:
                swings[g] = (
                    f"from {point(first, g * n)} the laws after {t} and {t + 1} steps are {now:.2f} and {then:.2f} "
                    "from the right one, and only their mean is near it (ergodic=False asks no more than that the law "
                    "is kept)"
                )
                if n * t >= _STEADY and any(_apart(before[name][own], last[name][own]) for name in last):
                    return Forgetting(reasons=[f"it is periodic: {swings[g]}"])
        worst = int(np.argmax(gaps))
        if gaps[worst] <= within:
            return Forgetting(t, within)
        if time.process_time() - begin > _SECONDS:
            break
    own = slice(worst * n, (worst + 1) * n)
    doubt = (
        f"it is periodic, or leaves its period too seldom: {swings[worst]}"
        if worst in swings
        else f"it has not forgotten a bad start: from {point(first, own.start)} its distance from the law is "
        f"{', '.join(history[worst])} steps; it is slow, or can not get everywhere, or keeps another "
        "law, which more steps= or reversible=True may show (ergodic=False leaves this out)"
    )
    return _stuck(first, last, own, t) or Forgetting(doubts=[doubt])


def _stuck(first: dict[str, np.ndarray], last: dict[str, np.ndarray], own: slice, t: int) -> Forgetting | None:
    """What it is that all replicas from one place are at one other, t + 1 steps later; None where they are not."""
    alike = all(len(np.unique(values[own])) == 1 for values in last.values())
    if not alike or all(np.all(last[name][own] == first[name][own]) for name in first):
        return None
    n = own.stop - own.start
    same = f"all {n} replicas from {point(first, own.start)} are at {point(last, own.start)} after {t + 1} steps"
    if n * t >= _STEADY:
        return Forgetting(reasons=[f"it is deterministic: {same}"])
    return Forgetting(doubts=[f"it is deterministic, or has not yet met a chance: {same}"])


def _apart(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether values of one kind and of another never mix: on either side of a number, or of few values, on others."""
    if a.max() < b.min() or b.max() < a.min():
        return True
    one, other = np.unique(a), np.unique(b)
    return len(one) + len(other) <= len(a) // 16 and len(np.intersect1d(one, other)) == 0


def _slice(start: Position, look: Look, fresh: Position, own: slice) -> Replicas:
    first, positions = (jax.tree.map(lambda a: a[own], part) for part in (start, look.positions))
    return Replicas(first, Look(positions), fresh, np.zeros(own.stop - own.start))


def _distance(tests: Sequence[Test | Partition], counts: Sequence[tuple[np.ndarray, ...]], n: int) -> float:
    """How far the counted laws are from the right ones: the largest CDF gap, or total variation on cells."""
    gaps = [0.0]
    for test, each in zip(tests, counts, strict=True):
        if isinstance(test, OneSample):
            gaps.append(test.measured_gap(each))
        elif isinstance(test, TwoSample):
            gaps.append(test.measured_gap(each, n))
        elif isinstance(test, Partition):
            gaps.append(test.distance(each, n))
    return max(gaps)


def point(columns: dict[str, np.ndarray], k: int) -> str:
    """Replica k's coordinates, in words."""
    return "(" + ", ".join(f"{name} = {values[k]:.6g}" for name, values in columns.items()) + ")"
