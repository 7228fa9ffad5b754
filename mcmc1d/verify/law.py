"""What a kernel is verified against: a probability law known exactly, by its sampler and its CDF or bin masses."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import jax
import numpy as np
from scipy.stats import rv_discrete

from mcmc1d.checks import require
from mcmc1d.compiling import quickly
from mcmc1d.starts import exact_start
from mcmc1d.state import Multiplexed, State
from mcmc1d.verify.bins import Bins, PlanarBins
from mcmc1d.verify.statistic import Continuous, Discrete, Position, Statistic

SampleFn: TypeAlias = Callable[[np.random.Generator, int], Position]


class LawError(ValueError):
    """The law contradicts itself: its sampler and its exact values disagree."""


@dataclass(frozen=True)
class Law:
    """A probability law of positions, known exactly.

    `sample(rng, n)` draws n independent positions, not by what is under test. `cdf(x)` is, for x of shape
    (n,), the CDF, and for (n, d) the d marginal CDFs, of the same shape; `bins = (edges, masses)` stands in for it on
    the line. Whatever else is known goes into `statistics`. Coordinates and joint cells whose exact probabilities are
    not given are compared with fresh exact draws, at the price of half the sample.
    """

    sample: SampleFn
    cdf: Callable[[np.ndarray], np.ndarray] | None = None
    bins: tuple[np.ndarray, np.ndarray] | None = None
    statistics: Mapping[str, Statistic] = field(default_factory=dict)
    log_density: Callable[[Any], Any] | None = None
    """Of one position, by JAX, up to a constant: its law is tested too, and adapters hand it to kernels."""
    support: tuple[Any, Any] | Callable[[Position], np.ndarray] | None = None
    """The corners of a closed box, or a function of n positions to n booleans.

    Many replicas outside of it are a failure, a few a doubt, a draw of `sample` outside an error.
    """
    bad_start: Position | None = None
    """One position (without the leading axis) that is hard to leave; the least likely of many draws unless given."""
    name: str = "law"
    auxiliary: tuple[str, ...] = ()
    """Coordinates that say nothing more than others do, such as a chain's primary sample: they stay out of joint cells.
    """

    def __post_init__(self):
        require(callable(self.sample), f"{self.name}: sample must be a function (rng, n) -> positions")
        for name, statistic in self.statistics.items():
            require(
                isinstance(statistic, Continuous | Discrete),
                f"{self.name}: statistic {name!r} must be a Continuous or a Discrete, not {type(statistic).__name__}",
            )
        require(
            self.cdf is None or self.bins is None,
            f"{self.name}: give cdf= or bins=, not both: only the one would be looked at",
        )
        if self.bins is not None:
            edges, masses = (np.asarray(part, np.float64) for part in self.bins)
            require(
                edges.ndim == 1 and masses.shape == (len(edges) - 1,) and bool(np.all(np.diff(edges) > 0)),
                f"{self.name}: bins must be (n + 1 rising edges, n masses), not {edges.shape} and {masses.shape}",
            )
            require(
                bool(np.all(masses >= 0)) and masses.sum() > 0,
                f"{self.name}: the masses must not be negative, nor all 0",
            )


def as_law(target: Any) -> Law:
    """A `Law` from what users have: a Law, a `Multiplexed` target, a frozen scipy distribution, or an object.

    An object needs `sample` and one of `cdf`, `bins`, `statistics`; the other fields are taken where it has them.
    Raises `ValueError` for anything else.
    """
    if isinstance(target, Law):
        return target
    if isinstance(target, Multiplexed):
        return multiplexed_law(target)
    if callable(getattr(target, "rvs", None)) and callable(getattr(target, "cdf", None)):
        require(
            hasattr(target, "dist") and hasattr(target, "support"),
            f"{type(target).__name__} is no frozen distribution on the line: freeze it with its parameters, "
            "scipy.stats.norm(0, 1), or give a verify.Law(sample=, cdf=) with the marginal CDFs",
        )
        return _scipy_law(target)
    names = ("cdf", "bins", "statistics", "log_density", "support", "bad_start", "name")
    given: dict[str, Any] = {"name": type(target).__name__}
    given |= {name: getattr(target, name) for name in names if getattr(target, name, None) is not None}
    require(
        callable(getattr(target, "sample", None)) and not isinstance(target, type),
        "a target to verify against must be a verify.Law (sample=, cdf=), a Multiplexed, a frozen scipy distribution "
        f"or an object with `sample` and `cdf`, not {target!r}",
    )
    return Law(sample=target.sample, **given)


def _scipy_law(distribution: Any) -> Law:
    """A frozen distribution of scipy.stats: continuous, or on integers."""
    name = getattr(getattr(distribution, "dist", distribution), "name", type(distribution).__name__)
    lower, upper = distribution.support()
    if hasattr(distribution, "pmf"):
        return Law(
            sample=lambda rng, n: distribution.rvs(n, random_state=rng),
            statistics={"x": _integers(distribution)},
            support=(lower, upper),
            name=name,
        )
    return Law(
        sample=lambda rng, n: distribution.rvs(n, random_state=rng),
        cdf=distribution.cdf,
        support=(lower, upper),
        name=name,
    )


_INTEGERS = 2**18  # cells on either side of the median of a law on integers: of Poisson (1e9), eight deviations
_REST = 1e-12  # of its mass, which each tail's end cell may hold at will


def _integers(distribution: Any) -> Discrete:
    """Cells of an integer each about the median, the tails in those at both ends: no rare value is one that can not be.

    A power law has its tail in a cell of many integers, beyond `_INTEGERS` of them; its quantiles need not fit memory.
    """
    lower, upper = distribution.support()
    median = _median(distribution, lower)
    first, last = int(max(lower, median - _INTEGERS)), int(min(upper, median + _INTEGERS))
    masses = distribution.pmf(np.arange(first, last + 1))
    below = distribution.cdf(first - 1) + np.cumsum(masses)
    # From the first integer up to which there is some mass to the first beyond which there is next to none.
    a, b = (int(k) for k in np.searchsorted(below, [_REST, 1 - _REST]))
    b = min(b, last - first)
    tails = below[a] - masses[a], 1 - below[b]
    masses = np.concatenate([below[a : a + 1], masses[a + 1 : b], 1 - below[b - 1 : b]]) if b > a else np.ones(1)
    first, last = first + a, first + b
    return Discrete(
        lambda x: np.clip(x - first, 0, last - first).astype(np.int64),
        masses,
        tuple(str(k) for k in range(first, last + 1)),
        ordered=True,
        cut=bool(max(tails) > _COARSE),
    )


_FAR = 2**22  # integers from the first on, among which a median is looked for that scipy finds by adding up masses


def _median(distribution: Any, lower: float | np.integer) -> float:
    """`ValueError` where scipy has none that a float or memory holds: in a far tail, or of a wide law."""
    # Its general search asks for the CDF far out, which may be the sum of all masses up to there.
    kind = type(getattr(distribution, "dist", distribution))
    summed = getattr(kind, "_ppf", None) is rv_discrete._ppf and np.isfinite(lower)
    near = not summed or distribution.pmf(lower + np.arange(_FAR)).sum() > 0.5
    median = distribution.ppf(0.5) if near else np.inf
    require(
        bool(np.isfinite(median)),
        f"{kind.__name__.removesuffix('_gen')}: scipy finds no median of it; give a verify.Law with statistics=, a "
        "verify.Discrete of the cells that matter",
    )
    return float(median)


_COARSE = 2**-14  # of a law's mass in one cell of many values: less is no more than what a continuous CDF leaves unseen
_BINS = 256
_JOINT_BINS = 32
_PLANAR_BINS = 128  # along each coordinate
_PLANAR_CELLS = 16, 8  # a side of the cells of x, and of (index, x)


def multiplexed_law(target: Multiplexed) -> Law:
    """The law of a chain's (index, x, u) under w_i f / p_i, drawn by rejection.

    A scalar x is held to `target.target.bin_masses` and (index, x) to `target.joint_masses`; a planar x to its marginal
    and joint masses, where they are known; u, and what else there is, to fresh exact draws.
    """
    lower, upper = target.target.domain

    def sample(rng: np.random.Generator, n: int) -> Position:
        return positions(target, exact_start(jax.random.key(int(rng.integers(2**32)), impl="threefry2x32"), target, n))

    statistics: dict[str, Statistic] = {}
    if np.ndim(lower) == 0:
        bins = np.linspace(lower, upper, _BINS + 1)
        statistics["x"] = Bins(bins, target.target.bin_masses(bins)).statistic()
        if target.n_techniques > 1:
            bins = np.linspace(lower, upper, _JOINT_BINS + 1)
            joint = target.joint_masses(bins)
            statistics["index, x"] = Bins(bins, joint).statistic()
            statistics["index"] = Discrete(lambda where: where["index"], joint.sum(1), ordered=True)
    elif np.shape(lower) == (2,):
        statistics |= _planar(target)
    return Law(sample=sample, statistics=statistics, name=type(target.target).__name__, auxiliary=("u",))


def _planar(target: Multiplexed) -> dict[str, Statistic]:
    """What is known exactly of a planar x: the law of each coordinate, of cells of x, and of (index, cell).

    Whatever can not be integrated to 1e-10 (a jump along a curve that no outline names) is left out, and so is
    compared with fresh exact draws.
    """
    corners = [np.asarray(corner, np.float64) for corner in target.target.domain]

    def edges(count: int) -> tuple[np.ndarray, np.ndarray]:
        x, y = (np.linspace(corners[0][k], corners[1][k], count + 1) for k in range(2))
        return x, y

    fine = edges(_PLANAR_BINS)
    try:
        masses = target.target.bin_masses(fine)
    except ValueError:
        return {}
    statistics: dict[str, Statistic] = {}
    for k in range(2):
        bins = Bins(fine[k], masses.sum(1 - k))
        statistics[f"x[{k}]"] = replace(
            bins.statistic(), cell=lambda where, bins=bins, k=k: bins.cell(np.asarray(where["x"])[:, k])
        )
    side, joint_side = _PLANAR_CELLS
    step = _PLANAR_BINS // side
    coarse = masses.reshape(side, step, side, step).sum((1, 3))
    statistics["x[0], x[1]"] = PlanarBins(*edges(side), coarse).statistic()
    if target.n_techniques > 1:
        try:
            joint = target.joint_masses(edges(joint_side))
        except ValueError:
            return statistics
        statistics["index, x[0], x[1]"] = PlanarBins(*edges(joint_side), joint).statistic()
        statistics["index"] = Discrete(lambda where: where["index"], joint.sum((1, 2)), ordered=True)
    return statistics


def positions(target: Multiplexed, state: State) -> Position:
    """What is tested of a batch of states: the technique's index, the sample x and the primary sample u."""
    evaluated = state if state.eval is not None else _evaluate(target, state)
    return {"index": np.asarray(evaluated.index), "x": np.asarray(evaluated.seen.x), "u": np.asarray(evaluated.u)}


@quickly
def _evaluate(target: Multiplexed, state: State) -> State:
    return jax.vmap(target.evaluate)(state)
