"""Kernels as JAX functions of one chain, or as NumPy functions of many, under test."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import UNTRACEABLE, require
from mcmc1d.compiling import quickly, traced_once, wide_jit
from mcmc1d.types import Array, Key
from mcmc1d.verify.statistic import Position
from mcmc1d.verify.subject import PICK, Look, Subject, drawn, key_of, pick

_FEW = 16  # positions on which init is tried


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
        return _arrays(position if self.init is None else self.init(key, position))

    def move(self, key: Key, state: Any) -> Any:
        """What the step returns."""
        return _arrays(self.step(key, state))

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
        key = key_of((0,))
        try:
            state = eqx.filter_eval_shape(self.kernel.begin, key, one)
            out = eqx.filter_eval_shape(self.kernel.move, key, state)
        except (*UNTRACEABLE, TypeError, AttributeError, IndexError) as error:
            raise ValueError(
                f"{self.name} can not be traced by JAX as step(key, position) of one chain, whose position is "
                f"{_shapes(one)} ({type(error).__name__}: {str(error).splitlines()[0]}); write it with jax.numpy and "
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
        if self.kernel.init is not None:
            few = jax.tree.map(lambda a: jnp.asarray(a[:_FEW]), start)
            state = _begin(self.kernel, key, jnp.arange(len(jax.tree.leaves(few)[0])), few)
            _require_kept(self.name, few, jax.vmap(self.kernel.where)(state))
        if self.kernel.deposits is not None:
            self._check_deposits(self.kernel.deposits, after, out[1] if self.returns_info else None, here)

    def _check_deposits(self, deposits: Callable, state: Any, info: Any, position: Any) -> None:
        wanted = f"{self.name}: deposits(state, info) must return (points, weights) of shapes (D, ...) and (D,)"
        try:
            points, weights = eqx.filter_eval_shape(deposits, state, info)
            count = weights.shape
            leading = {leaf.shape[:1] for leaf in jax.tree.leaves(points)}
        except (TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{wanted}; it failed: {str(error).splitlines()[0]}") from error
        require(len(count) == 1 and leading == {count}, f"{wanted}, not {_shapes(points)} and {_shapes(weights)}")
        require(
            jax.tree.map(lambda p: p.shape[1:], points) == jax.tree.map(lambda p: p.shape, position)
            and not any(jnp.issubdtype(p.dtype, jnp.complexfloating) for p in jax.tree.leaves(points)),
            f"{wanted}, of D points like the position, {_shapes(position)}; the points are {_shapes(points)}",
        )

    def prepare(self, start: Position) -> Position:
        return jax.tree.map(lambda leaf: _to_default(leaf, self.name), start)

    def drawn(self, start: Position) -> bool:
        if self.kernel.init is None:
            return False
        one = jax.tree.map(lambda a: jnp.asarray(a[0]), start)
        parts = [jax.tree.leaves(quickly(self.kernel.begin)(key_of((k,)), one)) for k in (0, 1)]
        pairs = [pair for pair in zip(*parts, strict=True) if not jnp.issubdtype(pair[0].dtype, jax.dtypes.extended)]
        return any(bool(np.any(np.asarray(a) != np.asarray(b))) for a, b in pairs)

    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        key = key_of(seed)
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
            yield Look(jax.tree.map(np.asarray, where), None if picked is None else drawn(picked))
            done = time


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
        try:
            after = self.kernel.step(np.random.default_rng(0), state)
        except TypeError as error:
            require("PRNG key" not in str(error), f"{self.name} takes a JAX key: give it without HostKernel")
            raise
        except ValueError as error:
            require(
                "truth value" not in str(error),
                f"{self.name} is of one chain: a HostKernel's step(rng, positions) moves many at once, the first axis "
                "counting them; write it with np.where, or, as JAX, give step(key, position) of one without HostKernel",
            )
            raise
        require(
            jax.tree.map(np.shape, after) == before,
            f"{self.name} must return arrays of the shapes it was given, {before}; it returned "
            f"{jax.tree.map(np.shape, after)}",
        )
        _require_kept(self.name, few, self._where(self._begin(np.random.default_rng(0), few)))
        where = self._where(after)
        require(
            _shapes(where) == _shapes(few),
            f"{self.name}: the positions it returns are {_shapes(where)}, and those it was given {_shapes(few)}",
        )

    def alike(self, start: Position) -> bool:
        for row in range(_PLACES):
            place = jax.tree.map(lambda a, row=row: np.repeat(a[row : row + 1], _CHAINS, 0), start)
            before, ends = _rows(place), []
            for seed in (0, 1):
                rng = np.random.default_rng(seed)
                after = _rows(self._where(self.kernel.step(rng, self._begin(rng, jax.tree.map(np.array, place)))))
                moved = (after != before).any(1)
                alike = moved.sum() * 4 > _CHAINS and len(np.unique(after[moved], axis=0)) == 1
                ends.append(after[moved][0] if alike else None)
            if ends[0] is not None and ends[1] is not None and not np.array_equal(*ends):
                return True
        return False

    def drawn(self, start: Position) -> bool:
        if self.kernel.init is None:
            return False
        few = jax.tree.map(lambda a: np.array(a[:_FEW]), start)
        one, two = (jax.tree.leaves(self._begin(np.random.default_rng(seed), few)) for seed in (0, 1))
        return any(not np.array_equal(a, b) for a, b in zip(one, two, strict=True))

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


_CHAINS, _PLACES = 64, 4
"""Of chains that start at one place, and places: two of their ways differ, unless they share their numbers."""


def _rows(where: Position) -> np.ndarray:
    """Positions as rows of numbers, (chains, numbers)."""
    return np.concatenate([np.asarray(a).reshape(len(a), -1) for a in jax.tree.leaves(where)], 1)


def _require_kept(name: str, start: Position, where: Position) -> None:
    """Raise `ValueError` unless the state that `init` made of each position is at that position."""
    leaves = (map(np.asarray, jax.tree.leaves(tree)) for tree in (start, where))
    for before, after in zip(*leaves, strict=True):
        about = 1e-6 * min(1.0, float(np.max(np.abs(before), initial=0)))
        if before.shape == after.shape and not np.allclose(before, after, rtol=1e-4, atol=about, equal_nan=True):
            k = int(np.argmax(np.abs(before - after).reshape(len(before), -1).max(1)))
            raise ValueError(
                f"{name}: init must keep the position, which is then read back: given {before[k]}, it is {after[k]}"
            )


@quickly
def _begin(kernel: JaxKernel, key: Key, ids: Array, start: Any) -> Any:
    def one(identity: Array, position: Any) -> Any:
        return kernel.begin(jax.random.fold_in(jax.random.fold_in(key, identity), 0), position)

    return jax.vmap(one)(ids, start)


@wide_jit
def _advance(
    kernel: JaxKernel, returns_info: bool, key: Key, ids: Array, states: Any, first: Array, last: Array, limit: Array
) -> tuple[Any, Any, Any]:
    """The states after steps `first` + 1 ... `last`, their positions, and a deposit of the last step."""
    keys = jax.vmap(lambda i: jax.random.fold_in(key, i))(ids)

    def one(key: Key, state: Any, t: Array) -> tuple[Any, Any]:
        out = kernel.move(jax.random.fold_in(key, t + 1), state)
        state, info = out if returns_info else (out, None)
        if kernel.deposits is None:
            return state, None
        points, weights = kernel.deposits(state, info)
        return state, pick(points, weights, jax.random.uniform(jax.random.fold_in(key, t + 1 + PICK)), limit)

    def batch(states: Any, t: Array) -> tuple[Any, Any]:
        return jax.vmap(one, in_axes=(0, 0, None))(keys, states, t)

    batch, (_, shapes) = traced_once(batch, states, first)
    empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    states, picked = jax.lax.fori_loop(first, last, lambda t, carry: batch(carry[0], t), (states, empty))
    return states, jax.vmap(kernel.where)(states), picked


def _arrays(tree: Any) -> Any:
    """With Python's numbers as arrays: which of the two a state holds must not change from step to step."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, int | float) else leaf, tree)


def _to_default(a: np.ndarray, name: str) -> np.ndarray:
    """In JAX's default precision, floats rounded towards zero: nothing is rounded onto a wall such as 1.

    Raises `ValueError` for numbers that its default does not hold.
    """
    a = np.asarray(a)
    if a.dtype.kind == "f":
        with np.errstate(over="ignore"):
            narrow = a.astype(jnp.zeros(()).dtype)
        lost = np.isinf(narrow) & np.isfinite(a)
        require(
            not lost.any(),
            f"{name}: {lost.sum()} of {a.size} of the law's draws, such as {a[lost].flat[0] if lost.any() else 0:.3g}, "
            f"do not fit {narrow.dtype}, JAX's own; verify it with jax.enable_x64(True)",
        )
        return np.where(np.abs(narrow) > np.abs(a), np.nextafter(narrow, np.zeros_like(narrow)), narrow)
    if a.dtype.kind not in "iu":
        return a
    narrow = a.astype(jnp.arange(1).dtype)
    require(
        bool(np.all((narrow == a) & ((narrow < 0) == (a < 0)))),
        f"{name}: the law's draws, from {a.min()} to {a.max()}, do not fit {narrow.dtype}, JAX's own; verify it "
        "with jax.enable_x64(True), or draw words of 32 bits as int32",
    )
    return narrow


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
