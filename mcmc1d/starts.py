"""Where chains start: exact draws from the target, or a given state once it is known to be one; the normalisation b."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_dtype, require_instance, require_key, require_whole
from mcmc1d.compiling import quickly
from mcmc1d.numerics import below_one, cast, stratum
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Int, Key

_LARGEST_LOG = 300.0  # of a density, whose square float64 must hold
_DARK = "nothing to start from, or log f is so low that f is 0 in float64: add a constant to it"
_CANDIDATES = 2**16  # for exact starts, at once: one size, so that one program serves every count
_PATIENCE = 2**22  # candidates of a row, after which it may be told that they will not do
MOST_CANDIDATES = 10_000 * 2**16  # of a row

# The counter of the numbers that are no step's: whatever key a user starts and runs with, none is used twice.
_DRAWS = 2**31 - 1


class StartError(ValueError):
    """No exact starts are to be had: the density is zero at all probes, or rejection would take too many candidates."""


class Normalisation(NamedTuple):
    """An estimate of b, the integral of f, and its standard error."""

    value: float
    standard_error: float


def normalisation(key: Key, target: Multiplexed, samples: int = 2**20) -> Normalisation:
    """The integral b by independent samples: the number of techniques times the mean of C_i(u) at uniform i and u.

    Hachisuka et al. 2014, section 4: the factor is the number of techniques of the chain, all of them. `samples`: above
    2**18 rounded up to a multiple of it. Raises `ValueError` where the density is NaN, infinite, or over e^300 at a
    sample, and where it is zero at all of them.
    """
    require_multiplexed(target, "normalisation")
    forget_what_has_changed(target)
    require_key(key, "normalisation")
    require_whole(samples, "normalisation: samples", 2)
    batch = min(samples, 2**18)
    total = square = 0.0
    batches = -(-samples // batch)
    for k in range(batches):
        state = _draw(jax.random.fold_in(key, k), target, batch, jnp.zeros(()).dtype)[0]
        # In float64, whatever a chain has: f may have any scale.
        log_c = np.asarray(state.seen.log_c, np.float64)
        bad = np.isposinf(log_c) | (log_c > _LARGEST_LOG)
        if bad.any():
            raise ValueError(f"normalisation: {target.complaint(_first(state, bad))}")
        c = np.exp(log_c)
        total, square = total + c.sum(), square + (c * c).sum()
    n = batches * batch
    require(total > 0, f"normalisation: {type(target.target).__name__}: no density in {n} samples: {_DARK}")
    mean = total / n
    deviation = np.sqrt(max(square / n - mean * mean, 0) / (n - 1))
    return Normalisation(target.n_techniques * mean, target.n_techniques * float(deviation))


def exact_start(key: Key, target: Multiplexed, count: int, dtype: Any = None, index: int | None = None) -> State:
    """`count` independent evaluated states, drawn exactly from the target by rejection: no burn-in, no inverse trusted.

    The bound is the largest density among 2**16 probes, with a quarter to spare; should a candidate exceed it, it is
    raised and everything is drawn again. A peak that all of the probes and candidates miss is missed. With an `index`,
    from the target given that technique. `dtype`: float32, or float64 with JAX's x64 on. Raises `StartError`, a
    `ValueError`, where the density is zero at every probe or too narrow for rejection; `ValueError` where it is not
    finite.
    """
    require_multiplexed(target, "exact_start")
    forget_what_has_changed(target)
    require_key(key, "exact_start")
    require_whole(count, "exact_start: count")
    n = target.n_techniques
    require(index is None or 0 <= index < n, f"exact_start: the index must lie in 0..{n - 1}, not {index}")
    dtype = require_dtype(dtype, "exact_start")
    target = cast(target, dtype)
    probe_key, key = jax.random.split(key)
    looked, probes, _ = _draw(probe_key, target, _CANDIDATES, dtype, index)
    probes, log_c = np.asarray(probes, np.float64), np.asarray(looked.seen.log_c)
    bound = 1.25 * float(np.max(probes, where=np.isfinite(probes), initial=0))  # what is not finite is told below
    top = float(np.max(log_c, where=np.isfinite(log_c), initial=-np.inf))
    require(
        top <= np.log(np.finfo(dtype).max),
        f"{type(target.target).__name__}: the density's logarithm reaches {top:.4g}, and it is infinite in {dtype}: "
        "subtract a constant from log f, no law depends on it",
    )
    why = "nothing to start from"
    if top > -np.inf:
        why = f"its logarithm reaches {top:.4g}: add a constant to log f, no law depends on it"
    if bound == 0 and not np.isposinf(probes).any():
        kind = StartError if top == -np.inf else ValueError
        raise kind(f"{type(target.target).__name__}: the density is zero at all of {_CANDIDATES} probes; {why}")

    def candidates(batch: int) -> tuple[State, np.ndarray, np.ndarray]:
        state, density, uniform = _draw(jax.random.fold_in(key, batch), target, _CANDIDATES, dtype, index)
        density = np.asarray(density, np.float64)
        if not np.isfinite(density).all():
            raise ValueError(
                f"exact_start: {target.complaint(_first(state, ~np.isfinite(density)))}; rejection needs a finite "
                "density: mend it, or for a pole give a technique that has it, or start="
            )
        return state, density, np.asarray(uniform)

    one = np.zeros(_CANDIDATES, int)
    return accepted("exact_start", candidates, one, np.array([bound]), count, "a technique that follows it, or start=")


def accepted(
    who: str,
    candidates: Callable[[int], tuple[State, np.ndarray, np.ndarray]],
    owner: Int[np.ndarray, " m"],
    bound: Float[np.ndarray, " rows"],
    count: int,
    fix: str,
    most: int = MOST_CANDIDATES,
) -> State:
    """`count` exact draws from each of several densities by rejection, (rows count) states.

    Arguments: `candidates`, of a batch's number, m of them: states, the first axis counting them, the density of each,
    which is of the row that `owner` names, and a uniform number for each, finer than the least density over the bound
    that matters (see `independent_states`); `bound`, that the rows' densities are thought not to exceed: where a
    candidate does, it is raised, and the row's are drawn again. `StartError` with the `fix` to give, where they are
    too narrow: a row would take more than `most` candidates, of all its batches.
    """
    rows, bound = len(bound), bound.copy()
    share = np.bincount(owner, minlength=rows)
    require(bool(share.all()), f"{who}: {rows} densities, and a batch of {len(owner)} has no candidates for some")
    kept: list[list[State]] = [[] for _ in bound]
    found, since = np.zeros(rows, int), np.zeros(rows, int)
    batch = 0
    while (found < count).any():
        state, density, uniform = candidates(batch)
        state = jax.tree.map(np.asarray, state)
        batch += 1
        highest = np.zeros(rows)
        np.maximum.at(highest, owner, density)
        for r in np.flatnonzero(highest > bound):
            bound[r], kept[r], found[r], since[r] = 1.25 * highest[r], [], 0, batch
        chosen = (uniform * bound[owner] < density) & (since < batch)[owner] & (found < count)[owner]
        for r in np.unique(owner[chosen]):
            mine = np.flatnonzero(chosen & (owner == r))
            kept[r].append(jax.tree.map(lambda leaf, mine=mine: leaf[mine], state))
            found[r] += mine.size
        # Long before the last candidate it can be told that they will not do.
        r = int(np.argmin(found))
        tried = int((batch - since[r]) * share[r])
        hopeless = tried >= _PATIENCE and found[r] * most < count * tried
        if found[r] < count and (hopeless or batch * int(share[r]) >= most):
            raise StartError(
                f"{who}: {found[r]} of {count} states after {tried} candidates, {most} being allowed, because the "
                f"density reaches {bound[r] / 1.25:.2g} in a narrow peak or a pole; give {fix}"
            )
    each = [jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *row) for row in kept]
    return jax.tree.map(lambda *parts: jnp.asarray(np.concatenate(parts)), *each)


def begin(
    key: Key, target: Multiplexed, start: State | None, chains: int, dtype: Any, who: str
) -> tuple[Int[Array, " chains"], Float[Array, "chains m"]]:
    """The index and u of every chain: of the start that was given, once it is known to be one, or exact draws."""
    if start is None:
        start = exact_start(key, target, chains, dtype)
    require_instance(start, State, f"{who}: start")
    index, u, shape = np.asarray(start.index), np.asarray(start.u), (chains, target.dim_u)
    require(u.shape == shape, f"{who}: start.u must be of shape {shape}, not {u.shape}")
    require(index.shape == (chains,), f"{who}: start.index must be of shape {(chains,)}, not {index.shape}")
    require(np.issubdtype(index.dtype, np.integer), f"{who}: start.index must be whole numbers, not {index.dtype}")
    lost = (index < 0) | (index >= target.n_techniques) | ~((u >= 0) & (u < 1)).all(1)
    k = int(np.argmax(lost))
    require(
        not lost.any(),
        f"{who}: start.index must lie in 0..{target.n_techniques - 1} and start.u in [0, 1); chain {k} has {index[k]} "
        f"and {u[k]}",
    )
    return jnp.asarray(index, jnp.int32), below_one(jnp.asarray(u, dtype))  # a float64 under 1 may round to it


def require_multiplexed(target: Multiplexed, who: str) -> None:
    """Raise `ValueError` unless the target is one that a chain can sample."""
    fix = "; wrap it: Multiplexed(target, techniques)"
    require_instance(target, Multiplexed, f"{who}: the target", fix)


def require_defined(target: Multiplexed, state: State, trapped: Bool[Array, " chains"]) -> None:
    """Raise `ValueError` where a chain is trapped at a NaN of the target, and say where that is."""
    bad = np.flatnonzero(np.asarray(trapped))
    if bad.size == 0:
        return
    found = target.evaluate(State(jnp.asarray(state.index)[bad[0]], jnp.asarray(state.u)[bad[0]]))
    raise ValueError(
        f"{target.complaint(found)}; {bad.size} of {len(trapped)} chains came upon such a place between "
        "the probes of Multiplexed, and no law is defined by it: let it be 0 there, or define it"
    )


def _first(states: State, which: np.ndarray) -> State:
    """The first of many states that is one of `which`."""
    k = int(np.argmax(which))
    return jax.tree.map(lambda leaf: leaf[k], states)


def uniform_states(
    target: Multiplexed, number: Float[Array, " n"], u: Float[Array, "m n"], only: int | None = None
) -> State:
    """Evaluated states at independent uniform numbers, the last axis counting them.

    `number` chooses the technique of each, unless `only` does: then the states are uniform on u alone.
    """
    index = stratum(number, target.n_techniques)
    index = index if only is None else jnp.full_like(index, only)
    return jax.vmap(target.evaluate, in_axes=-1, out_axes=-1)(State(index, u))


def independent_states(
    key: Key, step: Int[Array, ""] | int, target: Multiplexed, count: int, dtype: Any, only: int | None = None
) -> tuple[State, Float[Array, " count"]]:
    """`uniform_states` of the numbers of `step`, and a uniform number for each, by which it is accepted or rejected.

    That one is made of two. One alone is a multiple of 2^-23 in float32: whatever is under one, a density of 1e-12 of
    the bound too, would be accepted with that probability. Of two, a probability of more than 2^-46 is met to a
    relative 2^-24.
    """
    numbers = uniforms(key, step, (target.dim_u + 2, count), dtype)
    inside = uniforms(key, ~step, (1, count), dtype)[0]  # of a counter that no step has: it would be negative
    uniform = numbers[1] + jnp.finfo(dtype).eps.astype(dtype) * inside
    return uniform_states(target, numbers[0], numbers[2:], only), uniform


@quickly
def _draw(
    key: Key, target: Multiplexed, count: int, dtype: Any, only: int | None = None
) -> tuple[State, Float[Array, " count"], Float[Array, " count"]]:
    """`independent_states`, the first axis counting them, with their densities before the uniform numbers."""
    state, uniform = independent_states(key, _DRAWS, target, count, dtype, only)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), state), jnp.exp(state.seen.log_c), uniform
