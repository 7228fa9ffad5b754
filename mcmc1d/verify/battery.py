"""The tests of one batch of replicas: what is counted, and the p-value of the counts.

Every test only counts, so batches add up in any order; and every p-value is valid at every level and every sample
size: the DKW bound, exact binomials under a union bound, exact signs of pairs.
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from mcmc1d.checks import require
from mcmc1d.verify.ends import interval
from mcmc1d.verify.goodness import (
    cells_p_value,
    dkw_p_value,
    sign_p_value,
    smallest_cell_gap,
    smallest_gap,
    smallest_two_sample_gap,
)
from mcmc1d.verify.statistic import Continuous, Discrete, Position
from mcmc1d.verify.subject import Look

# The CDF of a continuous statistic is looked up at so many equal steps of probability: what lies between them and is
# missed is a gap of 6e-5 at most, which is added to the smallest detectable one.
FINE = 2**14
ASTRAY = 0.01  # the share of a one-sample test's level at which too many replicas lie in no cell of the law
POOLED = 64  # cells of a one-sample binomial test: narrow enough for a bump, few enough for the union bound


@dataclass(frozen=True)
class Replicas:
    """What a test may look at: where replicas started, where they are, and fresh exact draws."""

    first: Position
    look: Look
    fresh: Position
    uniform: np.ndarray
    """(n,), fresh uniform numbers, for choices that a test makes at random."""
    kept: dict[int, np.ndarray] = field(default_factory=dict)
    """What tests have worked out of `first` and `fresh`, by test: the same at every look."""

    def keep(self, test: "Test", make: Callable[[], np.ndarray]) -> np.ndarray:
        """What `make` returned when the test first asked."""
        if id(test) not in self.kept:
            self.kept[id(test)] = make()
        return self.kept[id(test)]

    def at(self, look: Look) -> "Replicas":
        """The same replicas at another look."""
        return replace(self, look=look)


class Test(abc.ABC):
    """One statistical test; its counts over independent replicas add up."""

    layer: str
    """"marginal", "joint", "density", "exchangeability" or "deposits"."""
    name: str

    @abc.abstractmethod
    def count(self, replicas: Replicas) -> tuple[np.ndarray, ...]:
        """Integer arrays of fixed shapes."""

    @property
    def headline(self) -> bool:
        """Whether it is of a coordinate's own law, whose gap a report states."""
        return self.layer == "marginal"

    @property
    def resolution(self) -> float:
        """The largest probability between two points at which a CDF is looked at: what happens within is not seen."""
        return 0.0

    @abc.abstractmethod
    def p_value(self, counts: tuple[np.ndarray, ...]) -> float:
        """Valid at every level."""

    def gap(self, n: int, level: float, miss: float) -> float | None:
        """The smallest CDF gap that n replicas show at a level with probability 1 - `miss`; None if none is meant.

        Of values without an order, that in the probability of one of their cells.
        """
        return None

    def worst(self, counts: tuple[np.ndarray, ...], most: int) -> list[str]:
        """Where the counts differ most from what they should be, in words."""
        return []

    def curve(self, counts: tuple[np.ndarray, ...]) -> np.ndarray | None:
        """The ECDF minus the CDF at equal steps of the CDF (or of the cells), for a picture; None if none is meant."""
        return None


@dataclass(frozen=True)
class OneSample(Test):
    """A statistic whose exact law is known, at a position or at a deposit."""

    name: str
    statistic: Continuous | Discrete
    layer: str = "marginal"
    deposits: bool = False
    max_weight: float = 1.0
    places: np.ndarray | None = None
    """Values at the pooled cells' ends, to say where a continuous statistic went wrong."""

    @property
    def masses(self) -> np.ndarray:
        """Exact probabilities of the cells, one for "nothing was deposited" last where there may be such."""
        own = (
            np.full(FINE, 1 / FINE)
            if isinstance(self.statistic, Continuous)
            else np.asarray(self.statistic.masses, np.float64) / np.sum(self.statistic.masses)
        )
        return np.append(own / self.max_weight, 1 - 1 / self.max_weight) if self.deposits else own

    def count(self, replicas: Replicas) -> tuple[np.ndarray, ...]:
        cells = len(self.masses) - self.deposits
        picked = replicas.look.picked
        if self.deposits and picked is not None:
            cell = np.where(picked.none, cells, evaluate(self.name, self.statistic, picked.points))
        else:
            cell = evaluate(self.name, self.statistic, replicas.look.positions)
        # What lies in no cell is counted after them all.
        size = len(self.masses) + 1
        return (np.bincount(np.where(cell < 0, size - 1, cell), minlength=size),)

    def p_value(self, counts: tuple[np.ndarray, ...]) -> float:
        inside, astray = counts[0][:-1], counts[0][-1:]
        # The law's own draws are all in cells, or it is refused: of either, none would be astray as often as the other.
        return min(1.0, self._p_value_inside(inside) / (1 - ASTRAY), sign_p_value(astray, 0 * astray) / ASTRAY)

    def _p_value_inside(self, inside: np.ndarray) -> float:
        if not inside.any():
            return 1.0
        if not self.ordered:
            return p_value_of_cells(inside, self.masses)
        pooled = [pool(part, POOLED, self.deposits) for part in (inside, self.masses)]
        return min(1.0, 2 * min(dkw_p_value(inside, self.masses), p_value_of_cells(*pooled)))

    @property
    def ordered(self) -> bool:
        """Whether its values follow each other on the line."""
        return isinstance(self.statistic, Continuous) or self.statistic.ordered

    @property
    def resolution(self) -> float:
        if isinstance(self.statistic, Continuous):
            return 1 / FINE
        return float(self.masses.max()) if self.statistic.cut else 0.0

    def gap(self, n: int, level: float, miss: float) -> float | None:
        if not self.ordered:
            return self.max_weight * smallest_cell_gap(n, level * (1 - ASTRAY), int(np.sum(self.masses > 0)), miss)
        own = 1 / FINE if isinstance(self.statistic, Continuous) else 0
        return self.max_weight * smallest_gap(n, level * (1 - ASTRAY), miss) + own

    def measured_gap(self, counts: tuple[np.ndarray, ...]) -> float:
        """The gap of the two CDFs, what lies in no cell above them all; of unordered cells, the largest difference."""
        difference = counts[0][:-1] / counts[0].sum() - self.masses
        return float(np.abs(np.cumsum(difference) if self.ordered else difference).max())

    def worst(self, counts: tuple[np.ndarray, ...], most: int) -> list[str]:
        outside, n = int(counts[0][-1]), counts[0].sum()
        found, expected = self._shown(counts)
        said = [f"{outside} of {n} in no cell of the law"] if outside else []
        deviation = np.sqrt(np.maximum(n * expected * (1 - expected), 1e-300))
        z = np.where(found == n * expected, 0.0, (found - n * expected) / deviation)
        for k in np.argsort(-np.abs(z))[:most]:
            said.append(
                f"{self._label(int(k), len(found))}: {found[k] / n:.4g}, exact {expected[k]:.4g}"
                + (f" ({z[k]:+.0f} s.d.)" if abs(z[k]) < 1e6 else "")
            )
        return said

    def _label(self, k: int, cells: int) -> str:
        if self.deposits and k == cells - 1:
            return "nothing deposited"
        if self.places is not None:
            ends = self.places
            return f"{self.name} in {interval(ends[k], ends[k + 1])}"
        labels = self.statistic.labels if isinstance(self.statistic, Discrete) else ()
        if not labels:
            return f"{self.name}, cell {k}"
        first = k * max(1, len(labels) // POOLED) if self.ordered else k
        last = min(first + max(1, len(labels) // POOLED) if self.ordered else first + 1, len(labels)) - 1
        return labels[first] if first == last else f"{labels[first]} to {labels[last]}"

    def _shown(self, counts: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Counts and masses of the cells that are told apart in reports: neighbours pooled, where there are any."""
        inside = counts[0][:-1]
        if not self.ordered:
            return inside, self.masses
        return pool(inside, POOLED, self.deposits), pool(self.masses, POOLED, self.deposits)

    def residuals(self, counts: tuple[np.ndarray, ...]) -> np.ndarray:
        """(observed - expected) / standard deviation by pooled cell."""
        (found, expected), n = self._shown(counts), counts[0].sum()
        return (found - n * expected) / np.sqrt(np.maximum(n * expected * (1 - expected), 1e-12))

    def curve(self, counts: tuple[np.ndarray, ...]) -> np.ndarray | None:
        if not self.ordered:
            return None
        inside = counts[0][: len(self.masses) - self.deposits]
        difference = np.cumsum(inside / counts[0].sum() - self.masses[: len(inside)])
        return difference[:: max(1, len(difference) // 256)]


@dataclass(frozen=True)
class TwoSample(Test):
    """A statistic whose exact law is not written down, against fresh exact draws, pair by pair.

    In cell a where the fresh draw is not, or the reverse: under the hypothesis either is as likely.
    """

    name: str
    value: Any
    """Position -> (n,) numbers."""
    ends: np.ndarray
    """Rising inner ends of the cells."""
    layer: str = "marginal"
    ordered: bool = True
    deposits: bool = False
    max_weight: float = 1.0
    widest: float = 0.0
    """The largest share of the law in a cell of several values."""
    auxiliary: bool = False
    """Whether it is of a coordinate that says nothing more than others do."""

    @property
    def headline(self) -> bool:
        return self.layer == "marginal" and not self.auxiliary

    def count(self, replicas: Replicas) -> tuple[np.ndarray, ...]:
        cells = len(self.ends) + 1
        fresh = replicas.keep(self, lambda: self._cell(replicas.fresh))
        if self.deposits and replicas.look.picked is not None:
            mine = np.where(replicas.look.picked.none, cells, self._cell(replicas.look.picked.points))
            fresh = np.where(replicas.uniform * self.max_weight < 1, fresh, cells)
        else:
            mine = self._cell(replicas.look.positions)
        size = cells + self.deposits
        both = np.bincount(mine[mine == fresh], minlength=size)
        more, less = np.bincount(mine, minlength=size) - both, np.bincount(fresh, minlength=size) - both
        if self.ordered:
            # Below a cut are those whose cell is; both are where the larger of the two is.
            joined = np.cumsum(np.bincount(np.maximum(mine, fresh), minlength=size))[:-1]
            more = np.concatenate([more, np.cumsum(np.bincount(mine, minlength=size))[:-1] - joined])
            less = np.concatenate([less, np.cumsum(np.bincount(fresh, minlength=size))[:-1] - joined])
        return more, less

    def _cell(self, where: Position) -> np.ndarray:
        return np.searchsorted(self.ends, np.asarray(self.value(where), np.float64), side="right")

    @property
    def resolution(self) -> float:
        return self.widest if self.ordered else 0.0

    def measured_gap(self, counts: tuple[np.ndarray, ...], n: int) -> float:
        """The largest difference at a cut or in a cell."""
        more, less = counts
        return float(np.abs(more - less).max() / n)

    def p_value(self, counts: tuple[np.ndarray, ...]) -> float:
        return sign_p_value(*counts)

    def gap(self, n: int, level: float, miss: float) -> float | None:
        if not self.ordered:
            return None
        cuts = 2 * (len(self.ends) + self.deposits) + 1
        return self.max_weight * smallest_two_sample_gap(n, level, cuts, miss)

    def worst(self, counts: tuple[np.ndarray, ...], most: int) -> list[str]:
        more, less = (part[: len(self.ends) + 1] for part in counts)
        z = (more - less) / np.sqrt(np.maximum(more + less, 1))
        ends = np.concatenate([[-np.inf], self.ends, [np.inf]])
        order = np.argsort(-np.abs(z))[:most]
        if not self.ordered:
            return [f"{self.name}, cell {k}: {z[k]:+.0f} s.d." for k in order]
        return [f"{self.name} in {interval(float(ends[k]), float(ends[k + 1]))}: {z[k]:+.0f} s.d." for k in order]


def coordinates(positions: Position) -> dict[str, np.ndarray]:
    """Each coordinate of n positions by name, as (n,): "x" or "x[0]", and a tree's own keys."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(positions)
    result = {}
    for path, leaf in leaves:
        name = ".".join(str(getattr(key, "key", getattr(key, "idx", getattr(key, "name", key)))) for key in path) or "x"
        array = np.asarray(leaf)
        columns = (array.astype(np.int8) if array.dtype == bool else array).reshape(len(leaf), -1)
        own = [name] if np.ndim(leaf) == 1 else [f"{name}[{k}]" for k in range(columns.shape[1])]
        twice = [each for each in own if each in result]
        require(not twice, f"two coordinates of a position would be called {twice[:1]}; name them otherwise")
        result |= dict(zip(own, columns.T, strict=True))
    return result


def evaluate(name: str, statistic: Continuous | Discrete, where: Position) -> np.ndarray:
    """The cell of each position: (n,) integers, -1 in none. Raises `ValueError` for what has no such shape."""
    if isinstance(statistic, Continuous):
        u = statistic.probability(where)
        n = len(jax.tree.leaves(where)[0])
        require(u.shape == (n,), f"the cdf of {name} must return shape {(n,)}, not {u.shape}")
        bad = ~((u >= -1e-9) & (u <= 1 + 1e-9))  # where no draw of the law is, or it is refused
        return np.where(bad, -1, np.clip((np.where(bad, 0, u) * FINE).astype(np.int64), 0, FINE - 1))
    cell, n = np.asarray(statistic.cell(where)), len(jax.tree.leaves(where)[0])
    require(
        cell.dtype.kind in "iu" and cell.shape == (n,),
        f"statistic {name}: cell must return one integer a position, shape {(n,)}, not {cell.dtype} of shape "
        f"{cell.shape}",
    )
    return np.where((cell >= 0) & (cell < len(statistic.masses)), cell, -1)


def pool(values: np.ndarray, cells: int, keep_last: bool) -> np.ndarray:
    """Sums over about so many groups of neighbours; the last entry may be one by itself."""
    own, rest = (values[:-1], values[-1:]) if keep_last else (values, values[:0])
    step = max(1, len(own) // cells)
    return np.concatenate([np.add.reduceat(own, np.arange(0, len(own), step)), rest])


def p_value_of_cells(counts: np.ndarray, masses: np.ndarray) -> float:
    """`goodness.cells_p_value`, cells of probability zero and no hits left out of the union."""
    if np.any((masses <= 0) & (counts > 0)):
        return 0.0
    lit = masses > 0
    return cells_p_value(counts[lit], masses[lit]) if lit.any() else 1.0
