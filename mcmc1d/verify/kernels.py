"""The kernels under test, brought to one form: independent replicas, started at given positions and looked at later."""

import abc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.metropolis import Cycle, Kernel, Metropolis
from mcmc1d.moves import Move
from mcmc1d.numerics import cast, jit_with, require
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key
from mcmc1d.verify.law import Position, positions

_PICK = 2**30  # the counter from which on a replica's random numbers pick deposits, not steps


@dataclass(frozen=True)
class Picked:
    """One of each replica's deposits, drawn in proportion to its weight."""

    points: Position
    """Like positions; what a right estimator puts here has the target's law."""
    none: np.ndarray
    """(n,), where nothing was drawn: the weights' total is the probability, times `max_weight`, that something is."""
    least: float
    """The smallest weight met."""
    most: float
    """The largest total of one step's weights."""


@dataclass(frozen=True)
class Look:
    """What a subject looks like after some steps."""

    positions: Position
    picked: Picked | None = None


def joined(looks: Sequence[Look]) -> Look:
    """The looks at several slices of replicas as one."""
    positions = jax.tree.map(lambda *parts: np.concatenate(parts), *(look.positions for look in looks))
    picked = [look.picked for look in looks if look.picked is not None]
    if not picked:
        return Look(positions)
    points = jax.tree.map(lambda *parts: np.concatenate(parts), *(p.points for p in picked))
    none = np.concatenate([p.none for p in picked])
    return Look(positions, Picked(points, none, min(p.least for p in picked), max(p.most for p in picked)))


class Subject(abc.ABC):
    """A kernel under test."""

    name: str
    reversible: bool | None = None
    """Whether it is declared to satisfy detailed balance; None where nothing has been said."""
    unit: int = 2048
    """How many replicas one call advances."""
    least_unit: int = 256
    """To how few that may be lowered for a slow kernel."""
    threads: bool = False
    """Whether calls may run side by side."""

    @abc.abstractmethod
    def check(self, start: Position) -> None:
        """Raise `ValueError` where the kernel can not be run from such positions, with the words to mend it."""

    @abc.abstractmethod
    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        """The replicas `first`, `first` + 1, ... from `start`, after each of the rising numbers of steps.

        What comes out is a function of the arguments alone.
        """

    def walk(self, seed: Sequence[int], start: Position, times: Sequence[int]) -> Iterator[Look]:
        """All replicas after each of the times, watched `unit` at a time."""
        n = len(jax.tree.leaves(start)[0])
        parts = [
            self.watch(seed, a, jax.tree.map(lambda s, a=a: s[a : a + self.unit], start), times)
            for a in range(0, n, self.unit)
        ]
        return (joined(looks) for looks in zip(*parts, strict=True))

    def prepare(self, start: Position) -> Position:
        """Exact draws in the precision in which the kernel runs."""
        return start

    def crowd(self, bad: Position, unlikely: Position, n: int) -> Position:
        """`n` replicas at a bad start; `unlikely` are exact draws, the least likely first."""
        return jax.tree.map(lambda a: np.repeat(np.asarray(a)[None], n, 0), bad)


class JaxKernel(eqx.Module):
    """A kernel as JAX functions of one chain, with whatever state it carries from step to step.

    `step(key, state) -> state` or `(state, info)`. Unless the state is the position itself, `init(key, position)`
    makes it (its other parts drawn from their own stationary law: a fresh momentum, a clock at a random hour) and
    `position(state)` reads the position back. `deposits(state, info)` returns (points, weights) of shapes (D, ...)
    and (D,): the weighted points that an estimator would add up after this step.
    """

    step: Callable
    init: Callable | None = None
    position: Callable | None = None
    deposits: Callable | None = None
    reversible: bool | None = eqx.field(static=True, default=None)
    name: str = eqx.field(static=True, default="")

    def begin(self, key: Key, position: Any) -> Any:
        """The state at a position."""
        state = position if self.init is None else self.init(key, position)
        # A Python number in a state becomes an array at the first step; it had better be one from the start.
        return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, int | float) else leaf, state)

    def where(self, state: Any) -> Any:
        """The position of a state."""
        return state if self.position is None else self.position(state)


class HostKernel(eqx.Module):
    """A kernel as a NumPy function of many independent chains at once.

    `step(rng, states) -> states`, every array with a leading axis of chains; `init(rng, positions)` and
    `position(states)` where a chain carries more than its position.
    """

    step: Callable
    init: Callable | None = None
    position: Callable | None = None
    reversible: bool | None = eqx.field(static=True, default=None)
    name: str = eqx.field(static=True, default="")


class JaxSubject(Subject):
    """A `JaxKernel`; every replica has a key of its own, so that nothing depends on how they are dealt out."""

    threads = True

    def __init__(self, kernel: JaxKernel, max_weight: float):
        self.kernel, self.max_weight = kernel, max_weight
        self.name = kernel.name or _name(kernel.step)
        self.reversible = kernel.reversible
        self.returns_info = False

    def check(self, start: Position) -> None:
        one = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), start)
        key = jax.random.key(0)
        try:
            state = eqx.filter_eval_shape(self.kernel.begin, key, one)
            out = eqx.filter_eval_shape(self.kernel.step, key, state)
        except _UNTRACEABLE as error:
            raise ValueError(
                f"{self.name} can not be traced by JAX ({type(error).__name__}); write it with jax.numpy and "
                "jnp.where, or, if it is NumPy, hand it over as verify.HostKernel(step), step(rng, positions)"
            ) from error
        self.returns_info = not _alike(out, state)
        after = out[0] if self.returns_info and isinstance(out, tuple) and len(out) == 2 else out
        require(
            _alike(after, state),
            f"{self.name} must return what it was given, {_shapes(state)}, or that and an info; it returned "
            f"{_shapes(after)}",
        )
        here = eqx.filter_eval_shape(self.kernel.where, after)
        require(
            _alike(here, one),
            f"{self.name}: the position read back is {_shapes(here)}, and the law's positions are {_shapes(one)}",
        )

    def prepare(self, start: Position) -> Position:
        return jax.tree.map(_to_default, start)

    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        key = _key(seed)
        n = len(jax.tree.leaves(start)[0])
        ids = jnp.arange(first, first + n, dtype=jnp.uint32)
        states = _begin(self.kernel, key, ids, start)
        done = 0
        for time in times:
            states, where, picked = _advance(
                self.kernel,
                self.returns_info,
                key,
                ids,
                states,
                jnp.asarray(done),
                jnp.asarray(time),
                jnp.asarray(self.max_weight, float),
            )
            yield Look(jax.tree.map(np.asarray, where), None if picked is None else _picked(picked))
            done = time


class LibrarySubject(Subject):
    """A kernel of this library on a `Multiplexed` target, run as `chain.run` runs it."""

    threads = True
    unit = least_unit = 4096  # a slice has one key, so its size is part of what a seed means

    def __init__(self, kernel: Kernel, target: Multiplexed, reversible: bool | None):
        self.kernel, self.target = kernel, target
        self.dtype = jnp.zeros(()).dtype
        self.name = _describe(kernel)
        # An involution that is accepted by the Metropolis-Hastings-Green rule satisfies detailed balance.
        self.reversible = isinstance(kernel, Metropolis) if reversible is None else reversible

    def check(self, start: Position) -> None:
        self.kernel.check(self.target)

    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        kernel, target = cast(self.kernel, self.dtype), cast(self.target, self.dtype)
        key = _key((*seed, first))
        state = State(jnp.asarray(start["index"], jnp.int32), jnp.asarray(start["u"], self.dtype))
        done = 0
        for time in times:
            state, points, picked = _advance_library(key, kernel, target, state, jnp.asarray(done), jnp.asarray(time))
            yield Look(jax.tree.map(np.asarray, points), _picked(picked))
            done = time

    def kinds(self, seed: Sequence[int], first: int, start: Position) -> tuple[Position, np.ndarray]:
        """The positions after one step, and the kind of move that each step was."""
        kernel, target = cast(self.kernel, self.dtype), cast(self.target, self.dtype)
        state = State(jnp.asarray(start["index"], jnp.int32), jnp.asarray(start["u"], self.dtype))
        after, kind = _one_step(_key((*seed, first)), kernel, target, state)
        return positions(target, after), np.asarray(kind)


class HostSubject(Subject):
    """A `HostKernel`."""

    def __init__(self, kernel: HostKernel):
        self.kernel = kernel
        self.name = kernel.name or _name(kernel.step)
        self.reversible = kernel.reversible

    def check(self, start: Position) -> None:
        few = jax.tree.map(lambda a: a[:16].copy(), start)
        state = self._begin(np.random.default_rng(0), few)
        before = jax.tree.map(np.shape, state)
        after = self.kernel.step(np.random.default_rng(0), state)
        require(
            jax.tree.map(np.shape, after) == before,
            f"{self.name} must return arrays of the shapes it was given, {before}; it returned "
            f"{jax.tree.map(np.shape, after)}",
        )
        where = self._where(after)
        require(
            _shapes(where) == _shapes(few),
            f"{self.name}: the positions it returns are {_shapes(where)}, and those it was given {_shapes(few)}",
        )

    def _begin(self, rng: np.random.Generator, start: Position) -> Any:
        return start if self.kernel.init is None else self.kernel.init(rng, start)

    def _where(self, state: Any) -> Position:
        return state if self.kernel.position is None else self.kernel.position(state)

    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        rng = np.random.default_rng([*seed, first])
        # A copy, and copies of what is looked at: a step may work in place.
        state = self._begin(rng, jax.tree.map(np.array, start))
        done = 0
        for time in times:
            for _ in range(done, time):
                state = self.kernel.step(rng, state)
            yield Look(jax.tree.map(np.array, self._where(state)))
            done = time


def as_subject(
    kernel: Any, target: Any, law: Any, *, reversible: bool | None, deposits: Any, max_weight: float
) -> Subject:
    """The subject for whatever kernel a user has; raises `ValueError` for what is none."""
    from mcmc1d.verify import adapters

    require(
        not isinstance(kernel, type), f"give an instance, not the class: {getattr(kernel, '__name__', kernel)}(...)"
    )
    if isinstance(kernel, Kernel | Move):
        require(
            isinstance(target, Multiplexed),
            f"a move of this library is verified on a mcmc1d.Multiplexed target, not on {type(target).__name__}",
        )
        return LibrarySubject(Metropolis(kernel) if isinstance(kernel, Move) else kernel, target, reversible)
    if not isinstance(kernel, Subject | JaxKernel | HostKernel):
        kernel = adapters.adapt(kernel, law)
    if isinstance(kernel, JaxKernel):
        changes: dict[str, Any] = {}
        if deposits is not None:
            changes["deposits"] = deposits
        if reversible is not None:
            changes["reversible"] = reversible
        subject: Subject = JaxSubject(_replace(kernel, changes), max_weight)
    elif isinstance(kernel, HostKernel):
        require(deposits is None, "deposits are tested of JAX kernels only; a HostKernel has none")
        subject = HostSubject(kernel)
    else:
        subject = kernel
    if reversible is not None:
        subject.reversible = reversible
    return subject


_UNTRACEABLE = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.ConcretizationTypeError,
    jax.errors.NonConcreteBooleanIndexError,
)


@eqx.filter_jit
def _begin(kernel: JaxKernel, key: Key, ids: Array, start: Any) -> Any:
    def one(identity: Array, position: Any) -> Any:
        return kernel.begin(jax.random.fold_in(jax.random.fold_in(key, identity), 0), position)

    return jax.vmap(one)(ids, start)


@jit_with(xla_cpu_prefer_vector_width=512)
def _advance(
    kernel: JaxKernel, returns_info: bool, key: Key, ids: Array, states: Any, first: Array, last: Array, limit: Array
) -> tuple[Any, Any, Any]:
    """The states after steps `first` + 1 ... `last`, their positions, and a deposit of the last step."""
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(ids)

    def one(key: Key, state: Any, t: Array) -> tuple[Any, Any]:
        out = kernel.step(jax.random.fold_in(key, t + 1), state)
        state, info = out if returns_info else (out, None)
        if kernel.deposits is None:
            return state, None
        points, weights = kernel.deposits(state, info)
        return state, _pick(points, weights, jax.random.uniform(jax.random.fold_in(key, t + 1 + _PICK)), limit)

    def batch(states: Any, t: Array) -> tuple[Any, Any]:
        return jax.vmap(one, in_axes=(0, 0, None))(keys, states, t)

    empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), jax.eval_shape(batch, states, first)[1])
    states, picked = jax.lax.fori_loop(first, last, lambda t, carry: batch(carry[0], t), (states, empty))
    return states, jax.vmap(kernel.where)(states), picked


def _pick(points: Any, weights: Array, uniform: Array, limit: Array) -> tuple[Any, Array, Array, Array]:
    """One of the points, with probability weight / limit; whether none was; the least weight and the total."""
    ends = jnp.cumsum(weights)
    total = ends[-1]
    # A total that falls short of the limit by rounding alone is the limit.
    scale = jnp.where(jnp.abs(total - limit) <= 1e-5 * limit, total, limit)
    chosen = jnp.sum(uniform * scale >= ends)
    none = chosen >= weights.shape[0]
    index = jnp.minimum(chosen, weights.shape[0] - 1)
    return jax.tree.map(lambda p: p[index], points), none, jnp.min(weights), total


@jit_with(xla_cpu_prefer_vector_width=512)
def _advance_library(
    key: Key, kernel: Kernel, target: Multiplexed, state: State, first: Array, last: Array
) -> tuple[State, Any, Any]:
    n, dtype = state.u.shape[0], state.u.dtype

    def body(t: Array, carry: tuple[State, Any]) -> tuple[State, Any]:
        step = _library_step(key, kernel, target, carry[0], t)
        return step.state, step.deposits

    states = jax.vmap(target.evaluate, out_axes=-1)(state)
    shapes = jax.eval_shape(lambda s: body(first, (s, None))[1], states)
    none = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    # The deposits ride along, though only the last step's are looked at: so the step is compiled once.
    after, deposits = jax.lax.fori_loop(first, last, body, (states, none))
    points = {"index": deposits.index, "x": deposits.x}
    uniform = uniforms(key, last + _PICK, (1, n), dtype)[0]
    picked = jax.vmap(_pick, in_axes=(-1, -1, 0, None))(points, deposits.weight, uniform, jnp.ones((), dtype))
    where = {"index": after.index, "x": jnp.moveaxis(after.seen.x, -1, 0), "u": after.u.T}
    return State(after.index, after.u.T), where, picked


@eqx.filter_jit
def _one_step(key: Key, kernel: Kernel, target: Multiplexed, state: State) -> tuple[State, Array]:
    states = jax.vmap(target.evaluate, out_axes=-1)(state)
    step = _library_step(key, kernel, target, states, jnp.asarray(0))
    return State(step.state.index, step.state.u.T), step.info.kind[0]


def _library_step(key: Key, kernel: Kernel, target: Multiplexed, state: State, t: Array) -> Any:
    w = uniforms(key, t, (kernel.dim_w(target), state.u.shape[-1]), state.u.dtype)
    return jax.vmap(lambda s, w: kernel.step(target, s, w), in_axes=-1, out_axes=-1)(state, w)


def _picked(raw: Any) -> Picked:
    points, none, least, total = jax.tree.map(np.asarray, raw)
    return Picked(points, none, float(least.min()), float(total.max()))


def _key(seed: Sequence[int]) -> Key:
    """A key from any integers, by NumPy's mixing of seeds."""
    word = np.random.SeedSequence(list(seed)).generate_state(2, np.uint32)
    return jax.random.wrap_key_data(jnp.asarray(word))


def _to_default(a: np.ndarray) -> np.ndarray:
    """In JAX's default precision, floats rounded towards zero: nothing is rounded onto a wall such as 1."""
    a = np.asarray(a)
    if a.dtype.kind == "f":
        narrow = a.astype(jnp.zeros(()).dtype)
        return np.where(np.abs(narrow) > np.abs(a), np.nextafter(narrow, np.zeros_like(narrow)), narrow)
    return a.astype(jnp.arange(1).dtype) if a.dtype.kind in "iu" else a


def _alike(a: Any, b: Any) -> bool:
    return _shapes(a) == _shapes(b)


def _shapes(tree: Any) -> str:
    """Structure, shapes and dtypes, in words."""
    return str(
        jax.tree.map(
            lambda a: (
                f"{np.dtype(a.dtype).name}{list(a.shape)}"
                if hasattr(a, "dtype") and not jnp.issubdtype(a.dtype, jax.dtypes.extended)
                else str(type(a).__name__)
            ),
            tree,
        )
    ).replace("'", "")


def _name(function: Any) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _describe(kernel: Kernel) -> str:
    if isinstance(kernel, Metropolis):
        return type(kernel.move).__name__ + (f"({', '.join(kernel.kinds)})" if len(kernel.kinds) > 1 else "")
    if isinstance(kernel, Cycle):
        return " then ".join(_describe(k) for k in kernel.kernels)
    return type(kernel).__name__


def _replace(kernel: JaxKernel, changes: dict[str, Any]) -> JaxKernel:
    fields = {name: getattr(kernel, name) for name in ("step", "init", "position", "deposits", "reversible", "name")}
    return JaxKernel(**(fields | changes))
