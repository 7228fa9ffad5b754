"""Exact enumeration of a kernel on finitely many states: the same kernel code, no sampling, right to 1e-12.

A ring of n states is a target that is constant on n equal cells, seen through the uniform technique; its states sit
at the middles of the cells, and `RingStep` goes from middle to middle.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.compiling import quickly
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Kernel, Step, as_kernel
from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.technique import log_ratio
from mcmc1d.numerics import cast, choose, entry, unchoose, width, wrap
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import Tabulated
from mcmc1d.techniques import Technique, Uniform
from mcmc1d.types import Array, Float, Real

_SAME = 1e-13
"""Two outcomes whose numbers all differ by less are one outcome."""
_BATCH = 2**13
"""One size for all calls, so that a kernel compiles once."""


class RingStep(Move):
    """u[0]' = wrap(u[0] + offset / n): one of several offsets, each with its probability, on a ring of n places.

    The number chooses the offset and keeps its place inside the offset's interval; w' is the same place in the
    interval of the opposite offset, so the log-determinant is log(p(-offset) / p(offset)). Of an offset whose opposite
    is not given the steps are never accepted.
    """

    n: int = eqx.field(static=True)
    offsets: tuple[int, ...] = eqx.field(static=True)
    ends: Float[Real, " k+1"]

    def __init__(self, n: int, probabilities: Mapping[int, float]):
        """`probabilities`: offset -> probability, which sum to one; the opposite of each is added if missing."""
        n = require_whole(n, "RingStep: n")
        chances = {offset % n: 0.0 for given in probabilities for offset in (given, -given)}
        for offset, probability in probabilities.items():
            chances[offset % n] += probability
        self.n, self.offsets = n, tuple(sorted(chances))
        p = np.array([chances[offset] for offset in self.offsets])
        require(
            bool(np.all(p >= 0)) and abs(p.sum() - 1) < 1e-12,
            f"RingStep: the offsets' probabilities must sum to one, none negative; {dict(probabilities)}",
        )
        self.ends = np.concatenate([[0.0], np.cumsum(p)]) / p.sum()

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        k, place = choose(self.ends, w[0])
        opposite = entry([jnp.asarray(self.offsets.index(-offset % self.n)) for offset in self.offsets], k)
        shift = entry([jnp.asarray(offset / self.n, state.u.dtype) for offset in self.offsets], k)
        log_det = log_ratio(width(self.ends, opposite), width(self.ends, k))
        u = state.u.at[0].set(wrap(state.u[0] + shift))
        return Proposal(State(state.index, u), unchoose(self.ends, opposite, place)[None], log_det.astype(w.dtype))


def ring(
    values: ArrayLike, techniques: Sequence[Technique] | Technique | None = None, **options: Any
) -> tuple[Multiplexed, State]:
    """(target, states): f takes `values` on equal cells of [0, 1]; one state per technique and cell, at its middle.

    The states' law is in proportion to `C_i(u)` there, as long as each technique maps cells onto cells; all are
    `Uniform` unless given. `options` are those of `Multiplexed`.
    """
    values = np.asarray(values, np.float64)
    target = Multiplexed(Tabulated(values), Uniform() if techniques is None else techniques, **options)
    n, m = values.size, target.dim_u
    index = np.repeat(np.arange(target.n_techniques), n)
    u = np.full((index.size, m), 0.5)
    u[:, 0] = np.tile((np.arange(n) + 0.5) / n, target.n_techniques)
    # NumPy's float64: the middles are exact whether or not x64 is on.
    states: Any = State(index, u)  # pyright: ignore[reportArgumentType]
    return target, states


class Enumeration(NamedTuple):
    """A kernel on n states, exactly: float64 arrays on the host."""

    matrix: Float[np.ndarray, "n n"]
    """P: from (row) to (column)."""
    deposits: Float[np.ndarray, "n n"]
    """D: the expected weight that a step from (row) deposits on (column)."""
    law: Float[np.ndarray, " n"]
    """pi: the states' densities C_i(u), of sum one."""

    @property
    def residual(self) -> float:
        """The total variation between pi P and pi."""
        return float(np.abs(self.law @ self.matrix - self.law).sum() / 2)

    @property
    def deposit_residual(self) -> float:
        """The total variation between pi D and pi: the bias of what is deposited."""
        return float(np.abs(self.law @ self.deposits - self.law).sum() / 2)


def enumerate_kernel(
    kernel: Kernel | Move,
    target: Multiplexed,
    states: State,
    numbers: Sequence[int | None] | None = None,
    *,
    probes: int = 17,
    inner: int = 32,
) -> Enumeration:
    """Run `kernel.step` from each state for every outcome of its uniform numbers w, and sum up.

    `numbers` says for each coordinate of w how its outcomes are told apart: an integer q, by one point in each of
    q equal intervals, on which the outcome must be constant; None (all of them, unless given), by bisection. Then the
    coordinate is probed at `probes` points, the later ones standing at `inner` fixed places; where two neighbours
    differ in any leaf of the `Step` the break between them is bisected to 2^-52. The earlier coordinates are held
    inside each of their intervals: the break of an accept or of a selector may depend on them. An interval
    between probes whose ends agree is missed: raise `probes` for probabilities under 1 / `probes`.

    Done twice, with other probes, other inner places, and at other places of each interval: the two must agree to 1e-9.

    Raises `ValueError` where they do not, where a step leaves the states, and where the outcome is not piecewise
    constant.
    """
    forget_what_has_changed(kernel, target)
    kernel = as_kernel(kernel, "enumerate_kernel: the kernel")
    require_instance(target, Multiplexed, "enumerate_kernel: the target")
    kernel.check(target)
    require_whole(probes, "enumerate_kernel: probes", 2)
    require_whole(inner, "enumerate_kernel: inner")
    with jax.enable_x64(True):
        wide = cast(kernel, jnp.float64)
        target = cast(target, jnp.float64)
        run = _Runner(wide, target, State(jnp.asarray(states.index, jnp.int32), jnp.asarray(states.u, jnp.float64)))
        r = wide.dim_w(target)
        plan: list[int | None] = [None] * r if numbers is None else list(numbers)
        require(len(plan) == r, f"enumerate_kernel: the kernel has {r} numbers; `numbers` names {len(plan)}")
        for q in plan:
            if q is not None:
                require_whole(q, "enumerate_kernel: an integer of `numbers`")
        found = [_enumerate(run, plan, probes + k, inner, k) for k in range(2)]
        for name in ("matrix", "deposits"):
            apart = np.abs(getattr(found[0], name) - getattr(found[1], name)).max()
            require(
                bool(apart < 1e-9),
                f"enumerate_kernel: two ways to look for breaks differ by {apart:.1e} in the {name}: a break was "
                "missed, or depends on two numbers at once; raise `probes` or `inner`",
            )
        return found[0]


def _enumerate(run: "_Runner", plan: list[int | None], probes: int, inner: int, seed: int) -> Enumeration:
    """All outcomes, the breaks looked for between so many probes."""
    later = np.random.default_rng(seed).random((inner, len(plan)))
    where = (0.5, 0.381966)[seed]  # inside of an interval: on what is constant there, it does not matter
    who, w, weight = np.arange(run.count), np.zeros((run.count, 0)), np.ones(run.count)
    for j, q in enumerate(plan):
        if q is None:
            row, lower, upper = _intervals(run, who, w, later[:, j + 1 :], probes)
        else:
            row, lower = np.repeat(np.arange(len(who)), q), np.tile(np.arange(q) / q, len(who))
            upper = lower + 1 / q
            _require_constant(run, who[row], w[row], (lower, upper), later[:, j + 1 :])
        who, weight = who[row], weight[row] * (upper - lower)
        w = np.concatenate([w[row], (lower + where * (upper - lower))[:, None]], axis=1)
    return run.total(who, w, weight)


def _require_constant(
    run: "_Runner", who: np.ndarray, w: np.ndarray, ends: tuple[np.ndarray, np.ndarray], later: np.ndarray
) -> None:
    """Raise `ValueError` where the outcome is not the same at both ends of an interval as in its middle."""
    inner = later if later.shape[1] else later[:1]

    def outcomes(share: float) -> np.ndarray:
        value = ends[0] + share * (ends[1] - ends[0])
        points = np.repeat(np.concatenate([w, value[:, None]], axis=1), len(inner), axis=0)
        points = np.concatenate([points, np.tile(inner, (len(who), 1))], axis=1)
        return run.leaves(np.repeat(who, len(inner)), points).reshape(len(who), -1)

    middle = outcomes(0.5)
    for share in (1e-6, 0.25, 0.75, 1 - 1e-6):
        differ = _differ(outcomes(share), middle)
        k = int(np.argmax(differ))
        require(
            not differ.any(),
            f"enumerate_kernel: the outcome changes inside of [{ends[0][k]:.4g}, {ends[1][k]:.4g}] of number "
            f"{w.shape[1]}: give more equal intervals, or None to bisect",
        )


def _intervals(
    run: "_Runner", who: np.ndarray, w: np.ndarray, later: np.ndarray, probes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The intervals of the next number on which the outcome is constant: the row of (who, w), both ends."""
    inner = later if later.shape[1] else later[:1]

    def outcomes(rows: np.ndarray, value: np.ndarray) -> np.ndarray:
        n, k = len(rows), len(inner)
        prefix = np.concatenate([w[rows], value[:, None]], axis=1)
        points = np.concatenate([np.repeat(prefix, k, axis=0), np.tile(inner, (n, 1))], axis=1)
        return run.leaves(np.repeat(who[rows], k), points).reshape(n, -1)

    first = np.concatenate([[0.0], (np.arange(probes) + 0.5) / probes, [1 - 2**-53]])
    everyone = np.arange(len(who))
    seen = outcomes(np.repeat(everyone, len(first)), np.tile(first, len(who))).reshape(len(who), len(first), -1)
    row = np.repeat(everyone, len(first) - 1)
    low, high = (np.tile(side, len(who)) for side in (first[:-1], first[1:]))
    at_low, at_high = (side.reshape(len(row), -1) for side in (seen[:, :-1], seen[:, 1:]))
    broken_row, broken_at = [], []
    for _ in range(200):
        differ = _differ(at_low, at_high)
        row, low, high, at_low, at_high = (a[differ] for a in (row, low, high, at_low, at_high))
        done = high - low <= 2.0**-52
        broken_row.append(row[done])
        broken_at.append(high[done])
        row, low, high, at_low, at_high = (a[~done] for a in (row, low, high, at_low, at_high))
        if not len(row):
            break
        require(
            len(row) <= 64 * len(who) * len(first),
            f"enumerate_kernel: the outcome is not piecewise constant in number {w.shape[1]}",
        )
        middle = (low + high) / 2
        at_middle = outcomes(row, middle)
        # Both halves are kept; one whose ends agree goes at the next turn.
        row = np.concatenate([row, row])
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        at_low, at_high = np.concatenate([at_low, at_middle]), np.concatenate([at_middle, at_high])
    rows, cuts = np.concatenate(broken_row), np.concatenate(broken_at)
    # Every row begins at 0 and ends at 1.
    starts_row, starts = np.concatenate([everyone, rows]), np.concatenate([np.zeros(len(who)), cuts])
    ends_row, ends = np.concatenate([everyone, rows]), np.concatenate([np.ones(len(who)), cuts])
    a, b = np.lexsort((starts, starts_row)), np.lexsort((ends, ends_row))
    return starts_row[a], starts[a], ends[b]


def _differ(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether two outcomes differ in any leaf; not-a-number equals itself."""
    with np.errstate(invalid="ignore"):  # -inf - -inf
        near = np.abs(a - b) <= _SAME
    return ~np.all(near | (a == b) | (np.isnan(a) & np.isnan(b)), axis=1)


class _Runner:
    """Steps from (number of a state, w), many at once and in batches of one size, compiled once."""

    def __init__(self, kernel: Kernel, target: Multiplexed, states: State):
        self.states = jax.vmap(target.evaluate)(states)
        self.count = states.u.shape[0]
        self.index, self.u = np.asarray(states.index), np.asarray(states.u)
        self.x = np.asarray(self.states.seen.x).reshape(self.count, -1)
        law = np.exp(np.asarray(self.states.seen.log_c))
        require(bool(law.sum() > 0), "enumerate_kernel: the density is zero at every state")
        self.law = law / law.sum()
        # What is no sample of the chain's own target has an index of another family: it is known by its x alone.
        self.own = kernel.sampled(target) is target

        def one(who: Array, w: Array) -> Step:
            return kernel.step(target, jax.tree.map(lambda leaf: leaf[who], self.states), w)

        self._step = quickly(jax.vmap(one))

    def steps(self, who: np.ndarray, w: np.ndarray) -> Step:
        """The outcomes, as NumPy arrays with a leading axis."""
        parts = []
        for first in range(0, len(who), _BATCH):
            some, numbers = who[first : first + _BATCH], w[first : first + _BATCH]
            count = len(some)
            pad = _BATCH - count
            out = self._step(jnp.asarray(np.pad(some, (0, pad))), jnp.asarray(np.pad(numbers, ((0, pad), (0, 0)))))
            parts.append(jax.tree.map(lambda leaf, n=count: np.asarray(leaf)[:n], out))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def leaves(self, who: np.ndarray, w: np.ndarray) -> np.ndarray:
        """All numbers of each outcome in a row."""
        flat = [np.asarray(leaf, np.float64).reshape(len(who), -1) for leaf in jax.tree.leaves(self.steps(who, w))]
        return np.concatenate(flat, axis=1)

    def total(self, who: np.ndarray, w: np.ndarray, weight: np.ndarray) -> Enumeration:
        """The sum of all outcomes, each with its probability `weight`."""
        step = self.steps(who, w)
        matrix, deposits = np.zeros((self.count, self.count)), np.zeros((self.count, self.count))
        where = np.concatenate([self.index[:, None], self.u], axis=1)
        index, u = np.asarray(step.state.index), np.asarray(step.state.u)
        there = np.concatenate([index[:, None], u], axis=1)
        np.add.at(matrix, (who, _nearest(there, where, "the state after a step")), weight)
        own = np.asarray(self.own, float)
        where = np.concatenate([own * self.index[:, None], self.x], axis=1)
        for k in range(step.deposits.weight.shape[1]):
            amount = step.deposits.weight[:, k]
            given = amount != 0
            x = step.deposits.x[:, k].reshape(len(who), -1)
            there = np.concatenate([own * step.deposits.index[:, k, None], x], axis=1)[given]
            to = _nearest(there, where, "a deposit")
            np.add.at(deposits, (who[given], to), (weight * amount)[given])
        return Enumeration(matrix, deposits, self.law)


def _nearest(points: np.ndarray, states: np.ndarray, what: str) -> np.ndarray:
    """The number of the state at each point; `ValueError` where there is none."""
    place = np.zeros(len(points), int)
    for first in range(0, len(points), 4096):
        gap = np.abs(points[first : first + 4096, None] - states[None]).max(2)
        place[first : first + 4096] = gap.argmin(1)
        far = gap.min(1) > 1e-9
        if far.any():
            raise ValueError(
                f"enumerate_kernel: {what} is at (index, u or x) = {points[first + far.argmax()]}, no state"
            )
    return place


EXAMPLES = Examples(lambda: {"ring_step": RingStep(5, {1: 0.5, -1: 0.2, 2: 0.3})})
