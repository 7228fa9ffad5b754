"""Running chains: blocks of chains stepped under one compiled loop; `run` and `trace`."""

import os
from collections.abc import Callable, Mapping
from importlib.metadata import version
from numbers import Real
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d import parallel
from mcmc1d.checkpoint import Place, Saving, describe
from mcmc1d.checks import require, require_dtype, require_key, require_whole
from mcmc1d.compiling import wide_jit
from mcmc1d.estimators import Estimator, added, empty, require_estimators
from mcmc1d.metropolis import Kernel, as_kernel, step_batch
from mcmc1d.moves import Move
from mcmc1d.numerics import cast
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.random import Source, source
from mcmc1d.starts import begin, require_defined, require_multiplexed
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Int, Key

# Between two looks at the clock, for progress, checkpoints and Ctrl-C.
_CHAIN_STEPS_PER_LOOK = 2**22
_STEPS_PER_LOOK = 2**16
_MOST_STEPS = 2**31 - 1


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
        return jax.tree.map(lambda s: s.sum(0) / (self.chains * self.steps), self._sums(name))

    def standard_error(self, name: str) -> Any:
        """The standard error of `mean`, from the spread of the independent blocks; two blocks at least."""

        def error(s: np.ndarray) -> np.ndarray:
            blocks = len(s)
            require(
                blocks >= 2,
                "a standard error needs two blocks of chains at least: run with blocks=2, or more",
            )
            return np.asarray(s.std(0, ddof=1) * np.sqrt(blocks) / (self.chains * self.steps))

        return jax.tree.map(error, self._sums(name))

    def _sums(self, name: str) -> Any:
        require(
            name in self.sums, f"no estimator of this run is called {name!r}; it has {', '.join(self.sums) or 'none'}"
        )
        return self.sums[name]

    def acceptance(self, name: str = "acceptance") -> dict[str, float]:
        """The acceptance rate of each kind of move, from an `Acceptance` estimator's sums; NaN if never proposed."""
        accepted, proposed = (s.sum(0) for s in self._sums(name))
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
    blocks: int | None = None,
    estimators: Mapping[str, Estimator] | None = None,
    start: State | None = None,
    dtype: Any = None,
    random: str = "threefry",
    progress: Progress | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    every: float = 60.0,
    resume: bool = False,
) -> Run:
    """Run independent chains and accumulate what the estimators ask for.

    The chains are dealt into `blocks` of equal size (unless given: 8, or as many under 8 as divide them), each with
    accumulators and random numbers of its own: the unit of work, and of the standard error. Blocks run on all cores
    at hand, are dealt over JAX's devices, and over processes that work together by `jax.distributed`, each of which
    makes the same call and gets the whole result: it does not depend on how many there are of any, to the bit.

    Arguments: `kernel`, or a move that `Metropolis` then accepts; `start`, one state per chain (leading axis), drawn
    exactly from the target unless given, so that a right kernel needs no burn-in; `dtype`, JAX's default float
    unless given; `random`, the source of the steps' random numbers: "threefry" is the reference, "hash32" costs an
    eighth of it, see `mcmc1d.random`; `progress`, called as the work advances.

    A run that is long is saved in the file `checkpoint`, `every` so many seconds, at Ctrl-C and at its end: the same
    call with `resume=True` goes on from there, or begins where there is no such file, and the result is that of a run
    without a break, to the bit (but on a GPU, which adds in no fixed order, to float64's rounding of the sums). With
    several processes, each has a file of its own, `checkpoint` and its number. The file is yours to delete.

    Raises `ValueError` where the kernel or an estimator does not fit the target, where a chain met a NaN of it, and
    where the checkpoint is damaged, of another run (it says what differs), or open in one.
    """
    forget_what_has_changed(kernel, target, estimators)
    kernel, numbers = as_kernel(kernel, "run: the kernel"), source(random)
    require(isinstance(every, Real), f"run: every is a number of seconds, not {every!r}")
    require_multiplexed(target, "run")
    dtype = require_dtype(dtype, "run")
    require_key(key, "run")
    steps, chains = _counts(steps, chains, "run")
    if blocks is None:
        blocks = next(b for b in range(min(8, chains), 0, -1) if chains % b == 0)
    blocks = require_whole(blocks, "run: blocks")
    require(chains % blocks == 0, f"run: {chains} chains can not be dealt into {blocks} equal blocks")
    kernel.check(target)
    asked = require_estimators(estimators)
    start_key, step_key = jax.random.split(key)
    index, u = begin(start_key, target, start, chains, dtype, "run")
    target, kernel, asked = cast(target, dtype), cast(kernel, dtype), cast(asked, dtype)
    size = chains // blocks
    zeros = {name: empty(estimator, target, kernel, dtype) for name, estimator in asked.items()}
    nothing = jax.tree.map(np.asarray, zeros)
    per_look = max(1, min(_STEPS_PER_LOOK, _CHAIN_STEPS_PER_LOOK // size))
    fresh = [Place(0, State(index[b : b + size], u[b : b + size]), nothing) for b in range(0, chains, size)]

    def arguments(block: int, device: Any, place: Place, count: int) -> tuple[Any, ...]:
        constant = jax.random.fold_in(step_key, block), numbers, kernel, target, asked
        return parallel.put((*constant, place.state, zeros, jnp.asarray(place.step), jnp.asarray(count)), device)

    def advance(block: int, device: Any, place: Place, count: int) -> Place:
        state, sums, trapped = _advance(*arguments(block, device, place, count))
        require_defined(target, state, trapped)
        totals = jax.tree.map(lambda t, s: t + np.asarray(s), place.totals, sums)
        return Place(place.step + count, state, totals)

    def identity() -> dict[str, Any]:
        """All that the bits of the result depend on; what a user's functions do shows in the program."""
        sizes = {"steps": steps, "chains": chains, "blocks": blocks, "dtype": str(dtype), "random": random}
        parts = {"key": key, "start": (index, u), "kernel": kernel, "target": target, "estimators": asked}
        compiled: Any = _advance
        program = compiled.lower(*arguments(0, None, fresh[0], 0)).as_text()
        parts["program"] = f"{per_look} {jax.devices()[0].device_kind} {program}"
        versions = {name: version(name) for name in ("jax", "jaxlib")}
        return sizes | versions | {name: describe(part) for name, part in parts.items()}

    saving = Saving(checkpoint, every, resume)
    places = parallel.run_blocks(advance, fresh, steps, per_look, progress, identity, saving)
    return Run(
        state=jax.tree.map(lambda *s: jnp.asarray(np.concatenate(s)), *(place.state for place in places)),
        sums=jax.tree.map(lambda *s: np.stack(s), *(place.totals for place in places)),
        chains=chains,
        steps=steps,
        kinds=kernel.kinds,
    )


def trace(
    key: Key,
    kernel: Kernel | Move,
    target: Multiplexed,
    *,
    steps: int,
    chains: int,
    start: State | None = None,
    dtype: Any = None,
    random: str = "threefry",
) -> Trace:
    """Run chains and keep every state; for integrated autocorrelation times and pictures. Arguments as `run`.

    Raises `ValueError` where the kernel does not fit the target, and where a chain met a NaN of it.
    """
    forget_what_has_changed(kernel, target)
    kernel, numbers = as_kernel(kernel, "trace: the kernel"), source(random)
    require_multiplexed(target, "trace")
    dtype = require_dtype(dtype, "trace")
    require_key(key, "trace")
    steps, chains = _counts(steps, chains, "trace")
    kernel.check(target)
    start_key, step_key = jax.random.split(key)
    state = State(*begin(start_key, target, start, chains, dtype, "trace"))
    target = cast(target, dtype)
    x, index, last, trapped = _record(step_key, numbers, cast(kernel, dtype), target, state, steps)
    require_defined(target, last, trapped)
    return Trace(np.asarray(x), np.asarray(index))


def _counts(steps: int, chains: int, who: str) -> tuple[int, int]:
    """Both as Python's, or `ValueError` unless they are whole, and the steps can be counted."""
    steps, chains = require_whole(steps, f"{who}: steps"), require_whole(chains, f"{who}: chains")
    require(steps < _MOST_STEPS, f"{who}: steps are counted in 32 bits, and {steps} are too many; run more chains")
    return steps, chains


@wide_jit
def _advance(
    key: Key,
    numbers: Source,
    kernel: Kernel,
    target: Multiplexed,
    estimators: dict[str, Estimator],
    state: State,
    sums: dict[str, Any],
    first: Int[Array, ""],
    count: Int[Array, ""],
) -> tuple[State, dict[str, Any], Bool[Array, " n"]]:
    """`count` steps of every chain of a block from step `first` on, and what they add to `sums`, which are zero.

    Also which chains are trapped where the target is NaN or infinite.
    """

    def body(k: Array, carry: tuple[State, Any]) -> tuple[State, Any]:
        state, sums = carry
        steps = step_batch(key, first + k, kernel, target, state, numbers)
        return steps.state, {name: added(estimators[name], sums[name], steps) for name in estimators}

    evaluated = jax.vmap(target.evaluate, out_axes=-1)(state)
    state, sums = jax.lax.fori_loop(0, count, body, (evaluated, sums))
    # Without its eval: what nothing reads after the loop need not be carried through it. (A step reads log_c.)
    return State(state.index, state.u.T), sums, jnp.isposinf(state.seen.log_c)


@eqx.filter_jit
def _record(
    key: Key, numbers: Source, kernel: Kernel, target: Multiplexed, start: State, steps: int
) -> tuple[Array, Array, State, Bool[Array, " n"]]:
    """The x and the index of every chain after every step, the last states, and which are trapped."""

    def body(state: State, k: Array) -> tuple[State, Any]:
        state = step_batch(key, k, kernel, target, state, numbers).state
        return state, (jnp.moveaxis(state.seen.x, -1, 0), state.index)

    evaluated = jax.vmap(target.evaluate, out_axes=-1)(start)
    last, (x, index) = jax.lax.scan(body, evaluated, jnp.arange(steps))
    return x, index, State(last.index, last.u.T), jnp.isposinf(last.seen.log_c)


__all__ = ["Progress", "Run", "Trace", "run", "trace"]
