"""Running chains: exact starts, blocks of chains stepped under one compiled loop, and the normalisation b."""

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.estimators import Estimator
from mcmc1d.metropolis import Kernel, Metropolis, Step
from mcmc1d.moves import Move
from mcmc1d.numerics import cast, jit_with, require
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Int, Key

_DEPOSITS_PER_DRAIN = 2**22  # before a drain into float64; within it the sums are compensated
_STEPS_PER_DRAIN = 2**16  # so that a single chain, too, reports its progress


_CANDIDATES = 2**16  # for exact starts, at once: one size, so that one program serves every count

# The counter of the numbers that are no step's: whatever key a user starts and runs with, none is used twice.
_DRAWS = 2**31 - 1


class Normalisation(NamedTuple):
    """An estimate of b, the integral of f, and its standard error."""

    value: float
    standard_error: float


class Run(eqx.Module):
    """What a run leaves: the last states, and each estimator's sums, block by block."""

    state: State
    sums: dict[str, Any]
    """Per estimator, float64 arrays with a leading axis of blocks."""
    chains: int
    """All chains of all blocks."""
    steps: int
    kinds: tuple[str, ...]

    def mean(self, name: str) -> Any:
        """An estimator's sums per chain and step: for a histogram, the estimated bin masses of f / b."""
        return jax.tree.map(lambda s: s.sum(0) / (self.chains * self.steps), self.sums[name])

    def standard_error(self, name: str) -> Any:
        """The standard error of `mean`, from the spread of the independent blocks; two blocks at least."""

        def error(s: np.ndarray) -> np.ndarray:
            blocks = len(s)
            require(blocks >= 2, "a standard error needs two blocks of chains at least")
            return np.asarray(s.std(0, ddof=1) * np.sqrt(blocks) / (self.chains * self.steps))

        return jax.tree.map(error, self.sums[name])

    def acceptance(self, name: str = "acceptance") -> dict[str, float]:
        """The acceptance rate of each kind of move, from an `Acceptance` estimator's sums; NaN if never proposed."""
        accepted, proposed = (s.sum(0) for s in self.sums[name])
        rates = np.divide(accepted, proposed, out=np.full_like(accepted, np.nan), where=proposed > 0)
        return dict(zip(self.kinds, rates.tolist(), strict=True))


class Trace(eqx.Module):
    """Kept chains: x of shape (steps, chains, ...) and the technique's index, (steps, chains)."""

    x: np.ndarray
    index: np.ndarray


Progress = Callable[[int, int], None]
"""Called with the chain steps done and the chain steps in all."""


def run(
    key: Key,
    kernel: Kernel | Move,
    target: Multiplexed,
    *,
    steps: int,
    chains: int = 8192,
    blocks: int = 8,
    estimators: Mapping[str, Estimator] | None = None,
    start: State | None = None,
    dtype: Any = None,
    progress: Progress | None = None,
) -> Run:
    """Run independent chains and accumulate what the estimators ask for.

    The chains are dealt into `blocks` of equal size, each with accumulators and random numbers of its own: the unit
    of work, and of the standard error. Blocks run on all cores at hand; the result does not depend on how many.

    Arguments: `kernel`, or a move that `Metropolis` then accepts; `start`, one state per chain (leading axis), drawn
    exactly from the target unless given, so that a right kernel needs no burn-in; `dtype`, JAX's default float
    unless given; `progress`, called as the work advances.

    Raises `ValueError` where the kernel or an estimator does not fit the target.
    """
    kernel = _as_kernel(kernel)
    dtype = jnp.zeros(()).dtype if dtype is None else jnp.dtype(dtype)
    require(
        dtype == jnp.float32 or (dtype == jnp.float64 and jnp.zeros(()).dtype == jnp.float64),
        f"run: dtype must be float32, or float64 with JAX's x64 on, not {dtype}",
    )
    require(steps >= 1, f"run: steps must be at least 1, not {steps}")
    require(
        blocks >= 1 and chains >= blocks and chains % blocks == 0,
        f"run: {chains} chains can not be dealt into {blocks} equal blocks",
    )
    kernel.check(target)
    asked = {} if estimators is None else dict(estimators)
    start_key, step_key = jax.random.split(key)
    if start is None:
        start = exact_start(start_key, target, chains, dtype)
    require(
        start.u.shape == (chains, target.dim_u), f"run: start.u must be {(chains, target.dim_u)}, not {start.u.shape}"
    )
    target, kernel, asked = cast(target, dtype), cast(kernel, dtype), cast(asked, dtype)
    index, u = jnp.asarray(start.index, jnp.int32), jnp.asarray(start.u, dtype)
    size = chains // blocks
    zeros = {name: estimator.init(target, kernel, dtype) for name, estimator in asked.items()}
    per_drain = max(1, min(_STEPS_PER_DRAIN, _DEPOSITS_PER_DRAIN // size))
    done = 0

    wide = jnp.zeros(()).dtype == jnp.float64

    def run_block(block: int) -> tuple[State, Any]:
        # A worker thread does not inherit a context such as `with jax.enable_x64(True)`.
        with jax.enable_x64(wide):
            return advance_block(block)

    def advance_block(block: int) -> tuple[State, Any]:
        nonlocal done
        own = slice(block * size, (block + 1) * size)
        state = State(index[own], u[own])
        block_key = jax.random.fold_in(step_key, block)
        totals = jax.tree.map(lambda z: np.zeros(z.shape), zeros)
        for first in range(0, steps, per_drain):
            count = min(per_drain, steps - first)
            state, sums = _advance(
                block_key, kernel, target, asked, state, zeros, jnp.asarray(first), jnp.asarray(count)
            )
            totals = jax.tree.map(lambda t, s: t + np.asarray(s, np.float64), totals, sums)
            done += size * count
            if progress is not None:
                progress(done, chains * steps)
        return state, totals

    workers = min(blocks, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    with ThreadPoolExecutor(workers) as pool:
        # The first block compiles; the rest then find it done.
        results = [run_block(0), *pool.map(run_block, range(1, blocks))]
    states, sums = zip(*results, strict=True)
    return Run(
        state=jax.tree.map(lambda *s: jnp.concatenate(s), *states),
        sums=jax.tree.map(lambda *s: np.stack(s), *sums),
        chains=chains,
        steps=steps,
        kinds=kernel.kinds,
    )


def trace(
    key: Key, kernel: Kernel | Move, target: Multiplexed, *, steps: int, chains: int, start: State | None = None
) -> Trace:
    """Run chains and keep every state; for integrated autocorrelation times and pictures. Arguments as `run`."""
    kernel = _as_kernel(kernel)
    kernel.check(target)
    dtype = jnp.zeros(()).dtype
    start_key, step_key = jax.random.split(key)
    if start is None:
        start = exact_start(start_key, target, chains, dtype)
    x, index = _record(step_key, cast(kernel, dtype), cast(target, dtype), start, steps)
    return Trace(np.asarray(x), np.asarray(index))


def normalisation(key: Key, target: Multiplexed, samples: int = 2**20) -> Normalisation:
    """B by independent samples: the number of techniques times the mean of C_i(u) at uniform i and u.

    Hachisuka et al. 2014, section 4: the factor is the number of techniques of the chain, all of them.
    """
    batch = min(samples, 2**18)
    total = square = 0.0
    batches = -(-samples // batch)
    for k in range(batches):
        c = np.asarray(_draw(jax.random.fold_in(key, k), target, batch, jnp.zeros(()).dtype)[1], np.float64)
        total, square = total + c.sum(), square + (c * c).sum()
    n = batches * batch
    mean = total / n
    deviation = np.sqrt(max(square / n - mean * mean, 0) / (n - 1))
    return Normalisation(target.n_techniques * mean, target.n_techniques * float(deviation))


def exact_start(key: Key, target: Multiplexed, count: int, dtype: Any = None) -> State:
    """`count` independent evaluated states, drawn exactly from the target by rejection: no burn-in, no inverse trusted.

    The bound is the largest density among 2**16 probes, with a quarter to spare; should a candidate exceed it, it is
    raised and everything is drawn again. A peak that all of the probes and candidates miss is missed. Raises
    `ValueError` where the density is zero at every probe, is not finite, or is too narrow for rejection.
    """
    dtype = jnp.zeros(()).dtype if dtype is None else jnp.dtype(dtype)
    target = cast(target, dtype)
    probe_key, key = jax.random.split(key)
    bound = 1.25 * float(np.max(_draw(probe_key, target, _CANDIDATES, dtype)[1]))
    require(
        bound > 0, f"{type(target.target).__name__}: the density is zero at all of 65536 probes; nothing to start from"
    )
    kept: list[State] = []
    found, attempt = 0, 0
    while found < count:
        state, density, uniform = _draw(jax.random.fold_in(key, attempt), target, _CANDIDATES, dtype)
        attempt += 1
        density = np.asarray(density, np.float64)
        if not np.isfinite(density).all():
            worst = np.asarray(state.u)[np.argmax(~np.isfinite(density))]
            raise ValueError(f"{type(target.target).__name__}: the density is not finite at u = {worst}")
        require(
            attempt <= 10_000,
            f"exact_start: {found} of {count} states after {attempt * _CANDIDATES} candidates; give start=",
        )
        if density.max() > bound:
            bound, kept, found = 1.25 * float(density.max()), [], 0
            continue
        chosen = np.flatnonzero(np.asarray(uniform) * bound < density)
        kept.append(jax.tree.map(lambda leaf, chosen=chosen: np.asarray(leaf)[chosen], state))
        found += chosen.size
    return jax.tree.map(lambda *parts: jnp.asarray(np.concatenate(parts)[:count]), *kept)


def _as_kernel(kernel: Kernel | Move) -> Kernel:
    return Metropolis(kernel) if isinstance(kernel, Move) else kernel


@eqx.filter_jit
def _draw(
    key: Key, target: Multiplexed, count: int, dtype: Any
) -> tuple[State, Float[Array, " count"], Float[Array, " count"]]:
    """States uniform on (i, u), their densities, and a uniform number for each."""
    numbers = uniforms(key, _DRAWS, (target.dim_u + 2, count), dtype)
    index = jnp.minimum((numbers[0] * target.n_techniques).astype(jnp.int32), target.n_techniques - 1)
    state = jax.vmap(target.evaluate)(State(index, numbers[2:].T))
    return state, jnp.exp(state.seen.log_c), numbers[1]


# XLA's default is half the width of a CPU's vectors where it has AVX-512; without it, and on a GPU, this is ignored.
@jit_with(xla_cpu_prefer_vector_width=512)
def _advance(
    key: Key,
    kernel: Kernel,
    target: Multiplexed,
    estimators: dict[str, Estimator],
    state: State,
    sums: dict[str, Any],
    first: Int[Array, ""],
    count: Int[Array, ""],
) -> tuple[State, dict[str, Any]]:
    """`count` steps of every chain of a block from step `first` on, and what they add to `sums`, which are zero."""

    def body(k: Array, carry: tuple[State, Any, Any]) -> tuple[State, Any, Any]:
        state, total, lost = carry
        steps = _step(key, kernel, target, first + k, state)
        gained = {name: estimators[name].update(sums[name], steps) for name in estimators}
        # Kahan's summation: what a float32 total is too large to take in is kept for the next step.
        gained = jax.tree.map(jnp.subtract, gained, lost)
        after = jax.tree.map(jnp.add, total, gained)
        lost = jax.tree.map(lambda new, old, more: (new - old) - more, after, total, gained)
        return steps.state, after, lost

    evaluated = jax.vmap(target.evaluate, out_axes=-1)(state)
    state, sums, _ = jax.lax.fori_loop(0, count, body, (evaluated, sums, sums))
    # Without its eval: what nothing reads after the loop need not be carried through it.
    return State(state.index, state.u.T), sums


@eqx.filter_jit
def _record(key: Key, kernel: Kernel, target: Multiplexed, start: State, steps: int) -> tuple[Array, Array]:
    """X and the index of every chain after every step."""

    def body(state: State, k: Array) -> tuple[State, Any]:
        state = _step(key, kernel, target, k, state).state
        return state, (state.seen.x, state.index)

    evaluated = jax.vmap(target.evaluate, out_axes=-1)(start)
    return jax.lax.scan(body, evaluated, jnp.arange(steps))[1]


def _step(key: Key, kernel: Kernel, target: Multiplexed, step: Int[Array, ""], state: State) -> Step:
    """One step of a batch of chains: one key per step, not one per chain, for numbers that are drawn all at once."""
    w = uniforms(key, step, (kernel.dim_w(target), state.u.shape[-1]), state.u.dtype)
    return jax.vmap(partial(kernel.step, target), in_axes=-1, out_axes=-1)(state, w)
