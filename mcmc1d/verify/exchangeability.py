"""Tests of detailed balance: (first, last) must have the law of (last, first)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from mcmc1d.verify.battery import Replicas, Test
from mcmc1d.verify.goodness import sign_p_value
from mcmc1d.verify.statistic import Position


@dataclass(frozen=True)
class Exchangeable(Test):
    """(first, last) against (last, first), of one statistic: from a to b as often as from b to a, and up as down."""

    name: str
    value: Any
    ends: np.ndarray
    still: float
    """A change that is no larger is none: a jump that comes back to where it was does so but for rounding."""
    layer: str = "exchangeability"

    def count(self, replicas: Replicas) -> tuple[np.ndarray, ...]:
        first, last = (np.asarray(self.value(p), np.float64) for p in (replicas.first, replicas.look.positions))
        a = replicas.keep(self, lambda: np.searchsorted(self.ends, first, side="right"))
        b = np.searchsorted(self.ends, last, side="right")
        cells = len(self.ends) + 1
        table = np.bincount(a * cells + b, minlength=cells * cells).reshape(cells, cells)
        return table, np.array([(last - first > self.still).sum(), (first - last > self.still).sum()])

    def p_value(self, counts: tuple[np.ndarray, ...]) -> float:
        table, direction = counts
        upper = np.triu_indices(len(table), 1)
        return min(1.0, 2 * min(sign_p_value(table[upper], table.T[upper]), sign_p_value(direction[:1], direction[1:])))

    def worst(self, counts: tuple[np.ndarray, ...], most: int) -> list[str]:
        table, direction = counts
        z = (table - table.T) / np.sqrt(np.maximum(table + table.T, 1))
        ends = np.concatenate([[-np.inf], self.ends, [np.inf]])
        said = [f"{self.name} rose {direction[0]} times and fell {direction[1]} times"]
        for k in np.argsort(-(np.triu(z, 1).ravel() ** 2))[:most]:
            a, b = divmod(int(k), len(table))
            said.append(
                f"{self.name} from [{ends[a]:.3g}, {ends[a + 1]:.3g}] to [{ends[b]:.3g}, {ends[b + 1]:.3g}]: "
                f"{table[a, b]} times, and back {table[b, a]}"
            )
        return said


@dataclass(frozen=True)
class Crossed(Test):
    """The same of two statistics: from a of one to b of the other as often as that way back in time.

    A rotation exchanges either coordinate with itself, and not the two.
    """

    name: str
    values: tuple[Any, Any]
    ends: tuple[np.ndarray, np.ndarray]
    layer: str = "exchangeability"

    def count(self, replicas: Replicas) -> tuple[np.ndarray, ...]:
        def cells(which: int, where: Position) -> np.ndarray:
            return np.searchsorted(self.ends[which], np.asarray(self.values[which](where), np.float64), side="right")

        last, size = replicas.look.positions, len(self.ends[1]) + 1
        forth = cells(0, replicas.first) * size + cells(1, last)
        back = cells(0, last) * size + cells(1, replicas.first)
        # A replica of both kinds, or of neither, says nothing.
        counts = [np.bincount(one[forth != back], minlength=size * (len(self.ends[0]) + 1)) for one in (forth, back)]
        return counts[0], counts[1]

    def p_value(self, counts: tuple[np.ndarray, ...]) -> float:
        return sign_p_value(*counts)

    def worst(self, counts: tuple[np.ndarray, ...], most: int) -> list[str]:
        forth, back = counts
        z = (forth - back) / np.sqrt(np.maximum(forth + back, 1))
        return [
            f"{self.name}, first and last, cell {k}: {forth[k]} times, and with time turned round {back[k]}"
            for k in np.argsort(-np.abs(z))[:most]
        ]
