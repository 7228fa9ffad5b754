"""Kernels of this library under test."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.compiling import quickly, traced_once, wide_jit
from mcmc1d.metropolis import Cycle, Kernel, Metropolis, step_batch
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key
from mcmc1d.verify.law import multiplexed_law, positions
from mcmc1d.verify.statistic import Position
from mcmc1d.verify.subject import PICK, Look, Subject, drawn, key_of, pick


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
        self.most = 1.0

    def check(self, start: Position) -> None:
        self.kernel.check(self.target)
        deposited = self.kernel.deposited(self.target)
        if deposited is not None:
            self.total, self.most = deposited.total, deposited.most
            known = {} if deposited.target is None else multiplexed_law(deposited.target).statistics
            # Of x alone: what index a deposit has is the kernel's own business. (Nothing, where no value is known.)
            self.deposited = {name: statistic for name, statistic in known.items() if name.startswith("x")}

    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        kernel, target = cast(self.kernel, self.dtype), cast(self.target, self.dtype)
        key, most = key_of((*seed, first)), jnp.asarray(self.most, self.dtype)
        state = _evaluated(target, jnp.asarray(start["index"], jnp.int32), jnp.asarray(start["u"], self.dtype))
        lower, upper = (np.asarray(end, self.dtype) for end in self.target.target.domain)
        done, width, lit = 0, jnp.asarray(upper - lower), state.seen.log_c > -jnp.inf
        for time in times:
            span = jnp.asarray(done), jnp.asarray(time)
            # With all that a chain carries, as in a run: what it carries may be wrong.
            state, points, picked, stale = _advance_library(key, kernel, target, state, span, most, width)
            points = jax.tree.map(np.asarray, points)
            dark = np.asarray(lit).astype(np.int8) - (np.asarray(state.seen.log_c) > -np.inf)
            yield Look(points, drawn(picked), self._wrong(points["index"], np.asarray(stale)), dark)
            done = time

    def _wrong(self, index: np.ndarray, stale: np.ndarray) -> str:
        n = self.target.n_techniques
        lost = (index < 0) | (index >= n)
        if lost.any():
            return f"it goes to technique {index[lost][0]}, and there are 0 to {n - 1}, in {lost.sum()} of {len(lost)}"
        if stale.mean() > _STALE:
            return (
                f"in {stale.sum()} of {len(stale)} replicas the state's `eval` is not that of its index and u; where "
                "they have changed, leave it out of a proposal, and of a kernel return target.evaluate(State(index, u))"
            )
        return ""

    def kinds(self, seed: Sequence[int], first: int, start: Position) -> tuple[Position, np.ndarray]:
        """The positions after one step, and the kind of move that each step was."""
        kernel, target = cast(self.kernel, self.dtype), cast(self.target, self.dtype)
        state = State(jnp.asarray(start["index"], jnp.int32), jnp.asarray(start["u"], self.dtype))
        after, kind = _one_step(key_of((*seed, first)), kernel, target, state)
        return positions(target, after), np.asarray(kind)


_STALE = 0.05
"""The share of replicas whose `eval` rounding alone may have moved far: at a wall, or in a technique's thin tail, where
a jump keeps x and its u says no more what x is.
"""


@quickly
def _evaluated(target: Multiplexed, index: Array, u: Array) -> State:
    """Evaluated states, the last axis of each leaf counting them."""
    return jax.vmap(target.evaluate, out_axes=-1)(State(index, u))


def _stale(target: Multiplexed, states: State, width: Array) -> Array:
    """Of which states the `eval` is another's: x off by 5 % of the domain, or the density by a factor of two."""

    def one(state: State) -> Array:
        kept, fresh = state.seen, target.evaluate(State(state.index, state.u)).seen
        alike = (jnp.abs(kept.log_c - fresh.log_c) <= jnp.log(2.0)) | (kept.log_c == fresh.log_c)
        return jnp.any(~(jnp.abs(kept.x - fresh.x) <= 0.05 * width)) | ~alike

    return jax.vmap(one, in_axes=-1)(states)


@wide_jit
def _advance_library(
    key: Key,
    kernel: Kernel,
    target: Multiplexed,
    states: State,
    span: tuple[Array, Array],
    most: Array,
    width: Array,
) -> tuple[State, Any, Any, Array]:
    n, dtype, (first, last) = states.u.shape[-1], states.u.dtype, span

    def one(states: State, t: Array) -> tuple[State, Any]:
        step = step_batch(key, t, kernel, target, states)
        return step.state, step.deposits

    one, (_, shapes) = traced_once(one, states, first)
    none = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    # The deposits ride along, though only the last step's are looked at: so the step is compiled once.
    after, deposits = jax.lax.fori_loop(first, last, lambda t, carry: one(carry[0], t), (states, none))
    points = {"index": deposits.index, "x": deposits.x}
    uniform = uniforms(key, last + PICK, (1, n), dtype)[0]
    picked = jax.vmap(pick, in_axes=(-1, -1, 0, None))(points, deposits.weight, uniform, most)
    where = {"index": after.index, "x": jnp.moveaxis(after.seen.x, -1, 0), "u": after.u.T}
    return after, where, picked, _stale(target, after, width)


@quickly
def _one_step(key: Key, kernel: Kernel, target: Multiplexed, state: State) -> tuple[State, Array]:
    states = jax.vmap(target.evaluate, out_axes=-1)(state)
    step = step_batch(key, jnp.asarray(0), kernel, target, states)
    return State(step.state.index, step.state.u.T), step.info.kind[0]


def _describe(kernel: Kernel) -> str:
    if isinstance(kernel, Metropolis):
        return type(kernel.move).__name__ + (f"({', '.join(kernel.kinds)})" if len(kernel.kinds) > 1 else "")
    if isinstance(kernel, Cycle):
        return " then ".join(_describe(k) for k in kernel.kernels)
    return type(kernel).__name__
