"""Whether two kernels of one law mix alike: for mistakes that leave the law right and change the variance only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcmc1d.checks import require_whole
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.verify.adapters import as_subject
from mcmc1d.verify.battery import coordinates
from mcmc1d.verify.goodness import sign_p_value
from mcmc1d.verify.law import as_law
from mcmc1d.verify.sampler import Sampler, entropy

_FAR = (0.02, 0.1, 0.3)  # of a coordinate's probability: short, middling and long moves


@dataclass(frozen=True)
class Efficiency:
    """How far two kernels have moved from the same exact starts, coordinate by coordinate."""

    names: tuple[str, str]
    p_value: float
    """That two kernels which move alike differ so much; exact, over all that was compared."""
    level: float
    moved: dict[str, tuple[float, float]]
    """By "coordinate by more than q after k": the shares of replicas of either kernel that did."""

    @property
    def alike(self) -> bool:
        """Whether no difference was found at the level."""
        return self.p_value > self.level

    @property
    def worst(self) -> tuple[str, tuple[float, float]]:
        """The comparison that differs most."""
        return max(self.moved.items(), key=lambda item: abs(item[1][0] - item[1][1]))

    def __str__(self) -> str:
        what, (mine, other) = self.worst
        head = f"{self.names[0]} and {self.names[1]} move {'alike' if self.alike else 'differently'}"
        return f"{head}: p = {self.p_value:.1e} at level {self.level:.0e}; {what}: {mine:.4f} and {other:.4f}"


def efficiency(
    kernel: Any,
    reference: Any,
    target: Any,
    *,
    seed: int = 0,
    level: float = 1e-6,
    replicas: int = 2**16,
    steps: Sequence[int] = (1, 4, 16, 64),
) -> Efficiency:
    """Compare how far two kernels take stationary chains, in units of each coordinate's own probability.

    Replica by replica from the same start, independent numbers: one has moved further than q and the other has not, or
    the reverse, as often if they mix alike. Detects a difference of about 8 sqrt(1 / (2 replicas)) in any share. Of an
    ensemble's walkers one counts.

    Arguments as `verify`'s; `reference` is a kernel that is known to be as good as it should be.
    """
    require_whole(replicas, "efficiency: replicas, for a comparison,", 256)
    forget_what_has_changed(kernel, reference, target)
    law, runs = as_law(target), []
    for k, each in enumerate((kernel, reference)):
        subject = as_subject(each, target, law, reversible=None, deposits=None, max_weight=1.0)
        runs.append(Sampler(law, subject, entropy(seed, f"efficiency {k}")))
        subject.check(runs[k].draw("design", 0, 0, subject.unit))
    # Of what moves by each other, one: the ways of the others are not independent of its.
    stride = math.lcm(*(run.subject.together for run in runs))
    draws = coordinates(runs[0].draw("design", 0, 0, 2**14))
    sorts = {name: np.sort(values) for name, values in draws.items()}
    start = runs[0].draw("start", 1, 0, replicas)
    before = _ranks(sorts, coordinates(start), stride)
    more: list[int] = []
    less: list[int] = []
    moved = {}
    walks = [run.subject.walk(run.words("steps", 1), start, steps) for run in runs]
    for t, *looks in zip(steps, *walks, strict=True):
        after = [_ranks(sorts, coordinates(look.positions), stride) for look in looks]
        for name in before:
            for q in _FAR:
                mine, other = (np.abs(ranks[name] - before[name]) > q for ranks in after)
                more.append(int((mine & ~other).sum()))
                less.append(int((other & ~mine).sum()))
                moved[f"{name} by more than {q} after {t}"] = (float(mine.mean()), float(other.mean()))
    names = (runs[0].subject.name, runs[1].subject.name)
    return Efficiency(names, sign_p_value(np.array(more), np.array(less)), level, moved)


def _ranks(sorts: dict[str, np.ndarray], columns: dict[str, np.ndarray], stride: int) -> dict[str, np.ndarray]:
    """Each coordinate of every `stride`-th replica as its place among exact draws, in [0, 1]."""

    def rank(among: np.ndarray, values: np.ndarray) -> np.ndarray:
        return (np.searchsorted(among, values, "left") + np.searchsorted(among, values, "right")) / (2 * len(among))

    return {name: rank(sorts[name], values[::stride]) for name, values in columns.items()}
