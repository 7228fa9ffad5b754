"""Which tests a law is put to."""

import itertools
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from mcmc1d.checks import require
from mcmc1d.verify.battery import POOLED, OneSample, Test, TwoSample, coordinates, evaluate
from mcmc1d.verify.bins import Bins
from mcmc1d.verify.ends import cell_ends, inner_ends, varies
from mcmc1d.verify.energy import Energy
from mcmc1d.verify.exchangeability import Crossed, Exchangeable
from mcmc1d.verify.forgetting import Partition
from mcmc1d.verify.law import Law
from mcmc1d.verify.statistic import Continuous, Position, Statistic
from mcmc1d.verify.subject import Look

_CUTS = 64
_JOINT = {2: 10, 3: 5}  # cells a coordinate in a joint test, by the number of coordinates; of more, below and above
_ORTHANTS = 8  # coordinates at most that are looked at so: 256 cells
_TRIPLES = 5  # coordinates at most of which every three are looked at jointly
_MOST_PAIRS = 64  # of coordinates that are looked at jointly, where there are more than eight
_CROSSED = 4  # cells of each of two coordinates whose first and last values are compared
_DECILES = 10
_PAIRS = 12  # cells of a statistic whose first and last values are compared: 66 pairs


def design(
    law: Law,
    draws: Position,
    *,
    reversible: bool,
    deposits: Look | None,
    max_weight: float,
    deposited: Mapping[str, Statistic] | None = None,
    energy: Energy | None = None,
) -> list[Test]:
    """The tests for a law; `draws`, exact and used for nothing else, set the cells' ends.

    A coordinate is held to its exact law where that is known, otherwise to fresh draws; so are the density and joint
    cells: of every two coordinates (beyond eight coordinates, of neighbours and others, 64 pairs in all) and, of up to
    five, of every three; from four on, the orthants about the medians of up to eight neighbours at once. The density's,
    `energy`, is looked at unless the position is one number whose law is known without a gap.
    The law's auxiliary coordinates stay out of the joint cells. Deposits are held to the law of the positions, or to
    what is known of their own, `deposited`; `max_weight` is the largest total weight of a step over the expected one.
    Raises `ValueError` for a CDF that falls, and for a statistic that has a coordinate's name and is not its law.
    """
    columns = coordinates(draws)
    known = _known(law, draws, columns)
    scalar, main = len(columns) == 1, main_coordinates(law, draws)
    tests: list[Test] = []
    for name, statistic in known.items():
        ordered = isinstance(statistic, Continuous) or statistic.ordered
        layer = "marginal" if name in columns or (ordered and scalar) else "joint"
        tests.append(OneSample(name, statistic, layer, places=_places(statistic, draws)))
    for name, statistic in ({} if deposits is None else known if deposited is None else deposited).items():
        tests.append(OneSample(name, statistic, "deposits", True, max_weight, _places(statistic, draws)))
    points = coordinates(deposits.picked.points) if deposits is not None and deposits.picked is not None else {}
    for name, values in columns.items():
        column = _Column(name)
        vary = varies(values)
        if name not in known:
            ends = cell_ends(values, _CUTS)
            cells = {"ends": ends.inner, "widest": ends.widest}
            tests.append(TwoSample(name, column, **cells, ordered=vary, auxiliary=vary and name not in main))
            if deposited is None and name in points:
                weighed = {"layer": "deposits", "deposits": True, "max_weight": max_weight}
                tests.append(TwoSample(name, column, **cells, **weighed))
        if reversible and vary:
            ends = inner_ends(values, _PAIRS)
            tests.append(Exchangeable(name, column, ends, 1e-4 * float(np.ptp(np.quantile(values, [0.05, 0.95])))))
    if len(main) > 1:
        # What a user calls like a group need not be its cells.
        exact = known if law.auxiliary else {}
        for group in (group for group in _groups(main) if ", ".join(group) not in exact):
            inner = tuple((name, inner_ends(columns[name], _JOINT.get(len(group), 2))) for name in group)
            joint = _Joint(inner)
            ends = np.arange(1, joint.cells) - 0.5
            tests.append(TwoSample(", ".join(group), joint, ends, "joint", ordered=False))
    tests += [_crossed(a, b, columns) for a, b in _pairs(main) if reversible]
    if energy is not None and not (scalar and all(_gapless(known.get(name)) for name in columns)):
        ends = inner_ends(energy(draws), _CUTS)
        if len(ends):
            tests.append(TwoSample("log density", energy, ends, "density"))
    return tests


def _gapless(statistic: Statistic | None) -> bool:
    """Whether the law of a coordinate is known everywhere, and not in cells of many values only."""
    return isinstance(statistic, Continuous) or (statistic is not None and not statistic.cut)


def _crossed(a: str, b: str, columns: Mapping[str, np.ndarray]) -> Crossed:
    ends = inner_ends(columns[a], _CROSSED), inner_ends(columns[b], _CROSSED)
    return Crossed(f"{a} with {b}", (_Column(a), _Column(b)), ends)


def partitions(law: Law, draws: Position) -> list[Partition]:
    """Coarse cells that show a law that is far off: deciles of coordinates, quadrants of pairs, octants of three."""
    columns, names = coordinates(draws), main_coordinates(law, draws)
    groups = [(name,) for name in names] + _pairs(names) + [group for group in [tuple(names)] if len(group) == 3]
    cells = [
        _Joint(tuple((name, inner_ends(columns[name], _DECILES if len(group) == 1 else 2)) for name in group))
        for group in groups
    ]
    return [Partition(cell, cell.cells) for cell in cells]


def _pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """All pairs of up to eight coordinates; of more, neighbours, and others drawn once and for all, 64 in all."""
    every = list(itertools.combinations(names, 2))
    if len(names) <= _ORTHANTS:
        return every
    near = list(itertools.pairwise(names))
    others = [pair for pair in every if pair not in set(near)]
    chosen = np.random.default_rng(len(names)).permutation(len(others))[: max(0, _MOST_PAIRS - len(near))]
    return near + [others[k] for k in np.sort(chosen)]


def main_coordinates(law: Law, draws: Position) -> list[str]:
    """The coordinates that vary, but for the law's auxiliary ones."""
    return [
        name
        for name, values in coordinates(draws).items()
        if varies(values) and name.partition("[")[0] not in law.auxiliary
    ]


@dataclass(frozen=True)
class _Column:
    """One coordinate."""

    name: str

    def __call__(self, where: Position) -> np.ndarray:
        return coordinates(where)[self.name]


@dataclass(frozen=True)
class _Joint:
    """The joint cell of several coordinates."""

    inner: tuple[tuple[str, np.ndarray], ...]

    @property
    def cells(self) -> int:
        """How many there are."""
        return int(np.prod([len(ends) + 1 for _, ends in self.inner]))

    def __call__(self, where: Position) -> np.ndarray:
        columns = coordinates(where)
        cell = np.zeros(len(next(iter(columns.values()))), np.int64)
        for name, ends in self.inner:
            cell = cell * (len(ends) + 1) + np.searchsorted(ends, columns[name], side="right")
        return cell


def _known(law: Law, draws: Position, columns: Mapping[str, np.ndarray]) -> dict[str, Statistic]:
    """All of which exact values are known, by name."""
    known = dict(law.statistics)
    if law.cdf is not None:
        known |= _marginals(law, draws, columns)
    elif law.bins is not None:
        known |= {"x": Bins(*(np.asarray(part, np.float64) for part in law.bins)).statistic()}
    for name, statistic in known.items():
        _require_rising(law, name, statistic, draws)
        if name in columns:
            known[name] = _own(law, name, statistic, draws, columns[name])
    return known


def _marginals(law: Law, draws: Position, columns: Mapping[str, np.ndarray]) -> dict[str, Continuous]:
    cdf = law.cdf
    assert cdf is not None
    if len(columns) == 1 and np.ndim(jax.tree.leaves(draws)[0]) == 1:
        (name,) = columns
        return {name: Continuous(_Column(name), cdf)}
    require(
        jax.tree.structure(draws) == jax.tree.structure(0),
        f"{law.name}: cdf is for positions that are one array, (n,) or (n, d); what is known of a tree are statistics",
    )
    table = _Table(law)
    return {name: _Marginal(_Column(name), cdf, table, k) for k, name in enumerate(columns)}


class _Table:
    """All marginal CDFs of a batch of positions; the last batch of each thread is kept, for the next coordinate."""

    def __init__(self, law: Law):
        self.law, self.last = law, threading.local()

    def __call__(self, where: Position) -> np.ndarray:
        if getattr(self.last, "where", None) is not where:
            points = np.asarray(where, np.float64)
            out = np.asarray(self.law.cdf(points), np.float64)  # pyright: ignore[reportOptionalCall]
            require(
                out.shape == points.shape or out.size == points.size == len(points),
                f"{self.law.name}: cdf must return all marginal CDFs, shape {points.shape}, not {out.shape}",
            )
            self.last.where, self.last.table = where, out.reshape(len(points), -1)
        return self.last.table


@dataclass(frozen=True)
class _Marginal(Continuous):
    """One column of the table."""

    table: _Table
    column: int

    def probability(self, where: Position) -> np.ndarray:
        return self.table(where)[:, self.column]


def _require_rising(law: Law, name: str, statistic: Statistic, draws: Position) -> None:
    """Raise `ValueError` for a CDF that falls: 1 - CDF would pass where the law is symmetric."""
    if not isinstance(statistic, Continuous):
        return
    value, probability = np.asarray(statistic.value(draws), np.float64), statistic.probability(draws)
    bad = ~((probability >= -1e-9) & (probability <= 1 + 1e-9))
    if probability.shape == value.shape and bad.any():
        raise ValueError(f"the cdf of {name} is {probability[bad][:1]} at {value[bad][:1]}; it must lie in [0, 1]")
    if probability.shape == value.shape:  # what is not, is told when it is counted
        order = np.argsort(value)
        falls = np.diff(probability[order]) < -1e-6
        k = int(np.argmax(falls))
        require(
            not falls.any(),
            f"{law.name}: the cdf of {name} falls from {probability[order][k : k + 1]} at {value[order][k : k + 1]} to "
            f"{probability[order][k + 1 : k + 2]} at {value[order][k + 1 : k + 2]}; a CDF is the probability of a "
            "value at most this",
        )


def _own(law: Law, name: str, statistic: Statistic, draws: Position, values: np.ndarray) -> Statistic:
    """A statistic that has a coordinate's name, once it is known to be a law of that coordinate, or `ValueError`.

    Cells that hold many values each are intervals, whose inside is not seen: `cut`.
    """
    if isinstance(statistic, Continuous):
        same = np.allclose(np.asarray(statistic.value(draws), np.float64), np.asarray(values, np.float64), rtol=1e-5)
    else:
        cell = evaluate(name, statistic, draws)
        values, cell = values[cell >= 0], cell[cell >= 0]
        different = len(np.unique(values))
        pairs = len(np.unique(np.stack([values, cell]), axis=1).T)
        rising = bool(np.all(np.diff(cell[np.argsort(values)]) >= 0))
        same = rising if statistic.ordered else pairs == different == len(np.unique(cell))
        if same and statistic.ordered and not statistic.cut:
            statistic = replace(statistic, cut=different > 4 * len(statistic.masses))
    require(
        same,
        f"{law.name}: the statistic {name!r} is called like a coordinate of the positions, and is another function of "
        "them: the coordinate's own law would not be tested; give it another name",
    )
    return statistic


def _places(statistic: Statistic, draws: Position) -> np.ndarray | None:
    """A continuous statistic's values at the ends of the pooled cells, as near as the draws tell."""
    if not isinstance(statistic, Continuous):
        return None
    return np.quantile(np.asarray(statistic.value(draws), np.float64), np.linspace(0, 1, POOLED + 1))


def _groups(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Which coordinates are looked at jointly: pairs, every three of a few, and blocks of eight."""
    blocks = [tuple(names[k : k + _ORTHANTS]) for k in range(0, len(names), _ORTHANTS)]
    triples = itertools.combinations(names, 3) if len(names) <= _TRIPLES else []
    return list(dict.fromkeys([*_pairs(names), *triples, *(block for block in blocks if len(block) > 2)]))


def unseen(law: Law, draws: Position, tests: Sequence[Test]) -> list[str]:
    """What no test looks at, in words: what a PASS says nothing of."""
    names, unheld = main_coordinates(law, draws), []
    if "u" in law.auxiliary and not any(name.startswith("x") for name in law.statistics):
        unheld = [
            "whether log_prob is the density of what the techniques make: of x no exact value is known, and the law's "
            "own draws believe it too; check_technique tells"
        ]
    finer = _blurred(draws, tests) + _within_cells(law, names, coordinates(draws), tests)
    if len(names) <= 3:
        return unheld + finer
    least = "four" if len(names) <= _TRIPLES else "three"
    at_once = "all" if len(names) <= _ORTHANTS else f"{_ORTHANTS} neighbours"
    left = len(names) * (len(names) - 1) // 2 - len(_pairs(names))
    pairs = f", and {left} pairs" if left else ""
    return [
        *unheld,
        f"what {least} coordinates show together, but for {at_once} at once below or above their medians{pairs}",
        *finer,
    ]


def _blurred(draws: Position, tests: Sequence[Test]) -> list[str]:
    """Coordinates of which two values may have been taken for one that is rounded in two ways."""
    said = []
    for name, values in coordinates(draws).items():
        if any(isinstance(test, TwoSample) and test.name == name for test in tests):
            noise = cell_ends(values, _CUTS).blurred
            said += [f"values of {name} less than {noise:.2g} apart: they are taken for roundings of one"] * (noise > 0)
    return said


def _within_cells(
    law: Law, names: Sequence[str], columns: Mapping[str, np.ndarray], tests: Sequence[Test]
) -> list[str]:
    """How fine joint laws are looked at, unless the density or another exact value shows what is finer."""
    finer = any(isinstance(s, Continuous) and name not in columns for name, s in law.statistics.items())
    if law.log_density is not None or finer or len(names) < 2:
        return []
    for test in tests:
        if isinstance(test, TwoSample) and isinstance(test.value, _Joint) and len(test.value.inner) == 2:
            # Where each value has a cell of its own there is nothing finer.
            counts = [(len(ends) + 1, len(np.unique(columns[name]))) for name, ends in test.value.inner]
            if any(cells < values for cells, values in counts):
                cells = " x ".join(str(cells) for cells, _ in counts)
                return [f"the joint law of {test.name} within {cells} cells; a log_density in the law shows much of it"]
        if isinstance(test, OneSample) and test.layer == "joint" and len(test.name.split(", ")) > 1:
            return [f"the joint law of {test.name} within the {len(test.masses)} cells of known probability"]
    return []
