"""The lazy primary-sample sampler: only the numbers that are read are moved, the others when they are next read.

Pharr, Jakob, Humphreys, section 16.4.4, as a pytree and pure functions of one chain; callers `vmap` and `jit`. As
published it does not keep the law: see `replay` and `LazySampler.init`.
"""

import itertools
from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_key, require_positive, require_whole
from mcmc1d.metropolis import acceptance
from mcmc1d.moves import Proposal
from mcmc1d.numerics import is_concrete, parameter, wrap
from mcmc1d.special import normal_quantile
from mcmc1d.starts import StartError
from mcmc1d.state import Eval, State
from mcmc1d.types import Array, Bool, Float, Index, Int, Key, Scalar

NEVER = -1
"""The time stamp of a number that has not been read: it precedes iteration 0, which is a large step."""


class LazyState(eqx.Module):
    """The primary samples of one chain: for each number its value, the iteration it is up to date with, and backups."""

    value: Float[Array, " m"]
    stamp: Int[Array, " m"]
    value_backup: Float[Array, " m"]
    stamp_backup: Int[Array, " m"]
    iteration: Int[Array, ""]
    """Counts the accepted proposals, and the one under way."""
    last_large: Int[Array, ""]
    """The iteration of the last accepted large step."""
    large: Bool[Array, ""]
    """Whether the proposal under way is a large step."""
    stream: Int[Array, ""]
    place: Int[Array, ""]
    """How many numbers have been read from the stream."""
    w: Float[Array, "m 4"]
    """The uniform numbers of the iteration under way: four for each component, used if it is read."""


Contribution: TypeAlias = Callable[["LazySampler", LazyState], tuple[Scalar, Any, LazyState]]
"""`(sampler, state) -> (log_f, sample, state)`: reads as many numbers as it needs, by `sampler.get`."""


class LazySampler(eqx.Module):
    """Mutates primary samples when they are read, replaying what they have missed.

    A number that was last read n accepted small steps ago takes them as one normal step of sigma sqrt(n), around the
    ends (eq. 16.23); one not read since the last large step is redrawn. An iteration is `start_iteration`, reads by
    `get`, and `accept` or `reject`; `step` does all three.

    `replay="apart"` takes the missed steps, backs the number up, and takes the step that is proposed; a rejection
    undoes only that. `"merged"` is as published: one normal number for all of them, and the backup before it, so that
    a rejection also undoes steps that had been accepted. They are drawn anew for the next proposal, until one is
    accepted: numbers that lead into dark regions are forgotten, and the law is wrong.

    Number `place` of stream `stream` is component `stream + streams * place` of the vector, so that what is read from
    one stream never shifts the numbers of another.
    """

    dims: int = eqx.field(static=True)
    streams: int = eqx.field(static=True)
    sigma: Scalar = eqx.field(converter=parameter)
    large_step: Scalar = eqx.field(converter=parameter)
    replay: str = eqx.field(static=True)

    def __init__(
        self,
        dims: int,
        *,
        sigma: float = 0.01,
        large_step: float = 0.3,
        streams: int = 1,
        replay: str = "apart",
    ):
        """`dims`: the most numbers that are read from one stream; `large_step`: the probability of a large step."""
        self.dims = require_whole(dims, "LazySampler: dims")
        self.streams = require_whole(streams, "LazySampler: streams")
        require(replay in ("apart", "merged"), f'LazySampler: replay must be "apart" or "merged", not {replay!r}')
        require(
            not is_concrete(large_step) or 0 <= large_step <= 1,
            f"LazySampler: large_step is a probability, not {large_step}",
        )
        self.replay, self.sigma, self.large_step = replay, parameter(sigma), parameter(large_step)
        require_positive(self, sigma=self.sigma)

    @property
    def size(self) -> int:
        """m, the length of the vector of primary samples."""
        return self.dims * self.streams

    @property
    def dim_w(self) -> int:
        """How many uniform numbers `step` consumes: four for each component, and two."""
        return 4 * self.size + 2

    def init(self, w: Float[Array, " r"]) -> LazyState:
        """The state before the first evaluation: a large step under way in iteration 0, nothing read yet.

        `w`: four uniform numbers for each component.
        The book fills gaps with zeros of time stamp 0. Then a number first read in a later iteration does not precede
        the large step of iteration 0, and takes its steps from 0 instead of from a uniform number; `NEVER` precedes.
        """
        values = jnp.zeros(self.size, w.dtype)
        stamps, zero = jnp.full(values.shape, NEVER, jnp.int32), jnp.zeros((), jnp.int32)
        large = jnp.ones((), bool)
        return LazyState(values, stamps, values, stamps, zero, zero, large, zero, zero, w.reshape(-1, 4))

    def start_iteration(self, state: LazyState, w: Float[Array, " r"]) -> LazyState:
        """Begin a proposal, large or small, reading from the first stream; `w`: four numbers a component, and one."""
        zero = jnp.zeros_like(state.place)
        return eqx.tree_at(
            lambda s: (s.iteration, s.large, s.stream, s.place, s.w),
            state,
            (state.iteration + 1, w[-1] < self.large_step, zero, zero, w[:-1].reshape(-1, 4)),
        )

    def start_stream(self, state: LazyState, stream: Index) -> LazyState:
        """Read on from the first number of a stream."""
        if isinstance(stream, int):
            require(0 <= stream < self.streams, f"LazySampler: there are {self.streams} streams, no stream {stream}")
        return eqx.tree_at(
            lambda s: (s.stream, s.place), state, (jnp.asarray(stream, jnp.int32), jnp.zeros_like(state.place))
        )

    def get(self, state: LazyState, wanted: Bool[Array, ""] | bool = True) -> tuple[Scalar, LazyState]:
        """The next number of the stream, moved; where not `wanted` nothing is read, and the number means nothing.

        A number that this iteration has read already is not moved again. A read beyond `dims` is an error at run time.
        """
        wanted = jnp.asarray(wanted)
        over = wanted & (state.place >= self.dims)
        place = eqx.error_if(state.place, over, f"LazySampler: more than dims={self.dims} numbers were read; raise it")
        k = jnp.minimum(state.stream + self.streams * place, self.size - 1)
        old, was, w = state.value[k], state.stamp[k], state.w[k]
        # Half a unit above their bits the numbers are symmetric about 1/2, and their quantiles finite.
        missed, now = (normal_quantile(u) for u in w[2:] + jnp.finfo(w.dtype).eps / 2)
        reset = was < state.last_large
        value, stamp = jnp.where(reset, w[0], old), jnp.where(reset, state.last_large, was)
        steps, sigma = (state.iteration - stamp).astype(w.dtype), jnp.asarray(self.sigma, w.dtype)
        if self.replay == "apart":
            value = jnp.where(steps > 1, wrap(value + sigma * jnp.sqrt((steps - 1).clip(0)) * missed), value)
            stamp, steps = jnp.where(steps > 1, state.iteration - 1, stamp), steps.clip(0, 1)
        small = wrap(value + sigma * jnp.sqrt(steps) * now)
        moved = jnp.where(state.large, w[1], small)
        again = was == state.iteration
        moved, fresh = jnp.where(again, old, moved), wanted & ~again

        def put(array: Array, new: Array) -> Array:
            return array.at[k].set(jnp.where(fresh, new, array[k]))

        after = eqx.tree_at(
            lambda s: (s.value, s.stamp, s.value_backup, s.stamp_backup, s.place),
            state,
            (
                put(state.value, moved),
                put(state.stamp, state.iteration),
                put(state.value_backup, value),
                put(state.stamp_backup, stamp),
                place + wanted,
            ),
        )
        return moved, after

    def accept(self, state: LazyState) -> LazyState:
        """Keep the proposal."""
        last = jnp.where(state.large, state.iteration, state.last_large)
        return eqx.tree_at(lambda s: s.last_large, state, last)

    def reject(self, state: LazyState) -> LazyState:
        """Restore what this iteration has read, values and time stamps, and turn the clock back."""
        read = state.stamp == state.iteration
        return eqx.tree_at(
            lambda s: (s.value, s.stamp, s.iteration),
            state,
            (
                jnp.where(read, state.value_backup, state.value),
                jnp.where(read, state.stamp_backup, state.stamp),
                state.iteration - 1,
            ),
        )


class LazyChain(eqx.Module):
    """A chain on a lazy sampler: its primary samples, and what the last evaluation found."""

    samples: LazyState
    log_f: Scalar
    sample: Any


class LazyInfo(eqx.Module):
    """What happened in a step: also the proposal's sample and log f, for deposits on both."""

    acceptance: Scalar
    accepted: Bool[Array, ""]
    large: Bool[Array, ""]
    log_f: Scalar
    sample: Any


def start(sampler: LazySampler, contribution: Contribution, w: Float[Array, " r"]) -> LazyChain:
    """A chain at independent uniform numbers, four a component: iteration 0, a large step; a bootstrap sample."""
    log_f, sample, samples = contribution(sampler, sampler.init(w))
    return LazyChain(sampler.accept(samples), log_f, sample)


def step(
    sampler: LazySampler, contribution: Contribution, chain: LazyChain, w: Float[Array, " r"]
) -> tuple[LazyChain, LazyInfo]:
    """One Metropolis iteration of `dim_w` numbers; both kinds of step are symmetric, so the ratio is that of f."""
    log_f, sample, proposed = contribution(sampler, sampler.start_iteration(chain.samples, w[:-1]))
    log_f = jnp.where(jnp.isnan(log_f), jnp.inf, log_f)  # no law is defined: the chain stays there, to be found
    proposal = Proposal(_state(proposed, log_f), proposed.value, jnp.zeros_like(log_f))
    a = acceptance(_state(chain.samples, chain.log_f), proposal)
    accepted = w[-1] < a

    def choose(yes: Any, no: Any) -> Any:
        return jax.tree.map(lambda one, other: jnp.where(accepted, one, other), yes, no)

    samples = choose(sampler.accept(proposed), sampler.reject(proposed))
    after = LazyChain(samples, choose(log_f, chain.log_f), choose(sample, chain.sample))
    return after, LazyInfo(a, accepted, proposed.large, log_f, sample)


def bootstrap(
    key: Key, sampler: LazySampler, contribution: Contribution, *, chains: int, candidates: int
) -> tuple[LazyChain, float]:
    """(chains, b): starts drawn among independent candidates in proportion to f, and the candidates' mean of f.

    What the chains deposit times *this* b is unbiased after any number of steps, for any number of candidates (section
    16.4.5; Veach and Guibas 1997); times another estimate of b, or the true one, it is biased by O(1 / candidates).
    Raises `ValueError` where f is zero at every candidate, or not a number at one.
    """
    require_key(key, "bootstrap")
    require_whole(chains, "bootstrap: chains")
    require_whole(candidates, "bootstrap: candidates")
    first, second = jax.random.split(key)
    w = jax.random.uniform(first, (candidates, 4 * sampler.size))
    starts = eqx.filter_jit(jax.vmap(lambda numbers: start(sampler, contribution, numbers)))(w)
    f = np.exp(np.asarray(starts.log_f, np.float64))
    k = int(np.argmin(np.isfinite(f)))
    require(
        bool(np.isfinite(f[k])),
        f"bootstrap: f is {f[k]} at candidate {k}, of the sample {jax.tree.map(lambda leaf: leaf[k], starts.sample)}: "
        "let the contribution be 0 there, or define it",
    )
    if not f.any():
        raise StartError(
            f"bootstrap: the contribution is zero at all of {candidates} candidates, there is nothing to start from; "
            "raise candidates"
        )
    ends = np.cumsum(f) / f.sum()
    chosen = np.searchsorted(ends, np.asarray(jax.random.uniform(second, (chains,)), np.float64), side="right")
    return jax.tree.map(lambda leaf: leaf[np.minimum(chosen, np.flatnonzero(f)[-1])], starts), float(f.mean())


def chain_lengths(total: int, chains: int) -> list[int]:
    """How many steps each of so many chains makes, `total` in all, none more than one longer than another.

    Chain i stands for the steps from floor(i total / chains) on: the sum telescopes (section 16.4.5).
    """
    total, chains = require_whole(total, "chain_lengths: total", 0), require_whole(chains, "chain_lengths: chains")
    ends = [i * total // chains for i in range(chains + 1)]
    return [b - a for a, b in itertools.pairwise(ends)]


def _state(samples: LazyState, log_f: Scalar) -> State:
    """As the one function that accepts looks at it: the density is f."""
    none = jnp.zeros((0,), samples.value.dtype)
    zero = jnp.zeros_like(log_f)
    return State(0, samples.value, Eval(samples.value, none, zero, log_f, (zero,), log_f))


__all__ = [
    "Contribution",
    "LazyChain",
    "LazyInfo",
    "LazySampler",
    "LazyState",
    "bootstrap",
    "chain_lengths",
    "start",
    "step",
]
