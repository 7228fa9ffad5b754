"""Images without one long chain: independent samples, and energy redistribution (ERPT, Cline, Talbot, Egbert 2005)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_key, require_whole
from mcmc1d.estimators import added, empty
from mcmc1d.image import Film, Image, film_row
from mcmc1d.metropolis import Kernel, as_kernel, step_batch
from mcmc1d.moves import Move
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.rendering import Rendered, Scene
from mcmc1d.starts import uniform_states
from mcmc1d.state import State
from mcmc1d.types import Array, Float, Key

_SAMPLES_AT_ONCE = 2**14


def independent(key: Key, scene: Scene, samples: int, replicas: int) -> Rendered:
    """`samples` independent draws of each replica, f / p of each in its pixel: the path tracing of Table 1.

    A uniform choice among the techniques and the balance heuristic of the scene; not stratified over the pixels.
    Raises `ValueError` unless `key` is one, and both numbers are whole.
    """
    require_key(key, "independent")
    require_whole(samples, "independent: samples")
    require_whole(replicas, "independent: replicas")
    sums = np.zeros((replicas, scene.pixels.count, 5))
    for first in range(0, samples, _SAMPLES_AT_ONCE):
        count = min(_SAMPLES_AT_ONCE, samples - first)
        keys = jax.random.split(jax.random.fold_in(key, first), replicas)
        sums += np.asarray(_scatter(keys, scene, _SAMPLES_AT_ONCE, jnp.asarray(count, jnp.int32)), np.float64)
    return Rendered(Film.of(sums, np.ones(replicas), samples), float(samples), np.full(replicas, np.nan))


def chains_of(energy: np.ndarray, quantum: float, xi: np.ndarray) -> np.ndarray:
    """How many chains each sample starts: floor(e / quantum + xi), with xi uniform e / quantum in expectation."""
    return np.floor(np.asarray(energy, np.float64) / quantum + xi).astype(int)


def energy_redistribution(
    key: Key,
    scene: Scene,
    kernel: Kernel | Move,
    samples: int,
    replicas: int,
    *,
    length: int = 100,
    mutations: float = 1.0,
    energy: float | None = None,
) -> Rendered:
    """Energy redistribution: chains of `length` from independent draws, each with the same energy, all deposited.

    A draw of energy e = f / p starts floor(xi + e / quantum) chains, each of which deposits its quantum evenly over
    its steps. The quantum is such that a sample brings `mutations` steps on average. Unbiased for any quantum, at
    any length, because in expectation the starts follow f, which the chains keep. The paper under test has length
    100 and one mutation for each sample; no filter removes noise. `energy`: the mean of e; the exact one unless
    given. The steps and the samples are at most `samples` together, on average.

    Raises `ValueError` where no chain was started, and unless the numbers are whole and positive.
    """
    kernel = as_kernel(kernel, "energy_redistribution: the kernel")
    require_key(key, "energy_redistribution")
    require_whole(samples, "energy_redistribution: samples")
    require_whole(replicas, "energy_redistribution: replicas")
    require_whole(length, "energy_redistribution: length")
    require(mutations > 0, f"energy_redistribution: mutations must be positive, not {mutations}")
    require(energy is None or energy > 0, f"energy_redistribution: energy must be positive, not {energy}")
    mean = float(scene.region_masses(1).sum()) if energy is None else energy
    starts = max(1, round(samples / (1 + mutations)))
    quantum = mean * length / mutations
    expected = starts * mutations / length
    states, counts = [], np.zeros((replicas, 0), int)
    for first in range(0, starts, _SAMPLES_AT_ONCE):
        count = min(_SAMPLES_AT_ONCE, starts - first)
        keys = jax.random.split(jax.random.fold_in(key, first), replicas)
        drawn = _draws(keys, scene, _SAMPLES_AT_ONCE)
        state, e, xi = jax.tree.map(lambda leaf, n=count: np.asarray(leaf)[:, :n], drawn)
        states.append(state)
        counts = np.concatenate([counts, chains_of(e, quantum, xi)], 1)
    begun = jax.tree.map(lambda *parts: np.concatenate(parts, 1), *states)
    most = int(counts.sum(1).max())
    require(most > 0, f"energy_redistribution: no chain was started ({expected:.2g} expected); give more samples")
    # All replicas run as many chains as the one that has most; those in excess weigh nothing.
    size = -(-most // 64) * 64
    rows = [np.repeat(np.arange(counts.shape[1]), c)[:size] for c in counts]
    picked = np.stack([np.pad(row, (0, size - len(row))) for row in rows])
    weight = np.stack([np.arange(size) < len(row) for row in rows]).astype(np.float32)
    index, u = (np.stack([a[p] for a, p in zip(leaf, picked, strict=True)]) for leaf in (begun.index, begun.u))
    keys = jax.random.split(jax.random.fold_in(key, starts), replicas)
    estimator, state = Image(scene.f, scene.f, scene.pixels), State(jnp.asarray(index), jnp.asarray(u))
    sums, accepted = _walk(keys, scene, estimator, kernel, state, jnp.asarray(weight), length)
    # With I = f each deposit counts z = 1: the quantum's share of a step, over the samples.
    chains = counts.sum(1)
    work = starts + float(chains.mean()) * length
    rate = np.asarray(accepted, np.float64) / np.maximum(chains * length, 1)
    return Rendered(Film.of(sums, np.full(replicas, quantum / length), starts), work, rate)


@eqx.filter_jit
def _draws(keys: Array, scene: Scene, count: int) -> tuple[State, Float[Array, "r n"], Float[Array, "r n"]]:
    """Independent states, the energy of each, n times C_i(u) for n techniques, and a uniform number for each."""
    dtype = jnp.zeros(()).dtype
    target = cast(scene.target, dtype)

    def one(key: Key) -> tuple[State, Array, Array]:
        w = uniforms(key, 0, (target.dim_u + 2, count), dtype)
        state = uniform_states(target, w[0], w[2:])
        return State(state.index, state.u.T), target.n_techniques * jnp.exp(state.seen.log_c), w[1]

    return jax.vmap(one)(keys)


@eqx.filter_jit
def _scatter(keys: Array, scene: Scene, count: int, used: Array) -> Float[Array, "r n 5"]:
    """The film's sums of independent samples, of which the first `used` count."""
    dtype = jnp.zeros(()).dtype
    scene = cast(scene, dtype)
    target = scene.target

    def one(key: Key) -> Array:
        w = uniforms(key, 0, (target.dim_u + 1, count), dtype)
        seen = uniform_states(target, w[0], w[1:]).seen
        lit = seen.log_c > -jnp.inf
        z = target.n_techniques * jnp.exp(seen.log_c)
        per = target.n_techniques * jnp.exp(jnp.where(lit, seen.log_c - seen.log_f, -jnp.inf))  # 1 / p, where f is lit
        rows = jnp.where((jnp.arange(count) < used)[:, None], film_row(z, jnp.exp(seen.log_f), per), 0)
        cells = jax.vmap(scene.pixels.cell, in_axes=-1)(seen.x)
        return jnp.zeros((scene.pixels.count, 5), dtype).at[cells].add(rows)

    return jax.vmap(one)(keys)


@eqx.filter_jit
def _walk(
    keys: Array, scene: Scene, estimator: Image, kernel: Kernel, starts: State, weight: Float[Array, "r c"], length: int
) -> tuple[Float[Array, "r n 5"], Float[Array, " r"]]:
    """`length` steps from every start: the film's sums and the acceptances, each chain weighed."""
    dtype = jnp.zeros(()).dtype
    scene, estimator, kernel, weight = cast((scene, estimator, kernel, weight), dtype)
    target = scene.target

    def one(key: Key, state: State, weight: Array) -> tuple[Array, Array]:
        def body(k: Array, carry: tuple[State, Array, Array]) -> tuple[State, Array, Array]:
            state, sums, accepted = carry
            step = step_batch(key, k, kernel, target, state)
            step = eqx.tree_at(lambda s: s.deposits.weight, step, step.deposits.weight * weight[None])
            return step.state, added(estimator, sums, step), accepted + (step.info.acceptance.mean(0) * weight).sum()

        begun = jax.vmap(target.evaluate, out_axes=-1)(state)
        zero = empty(estimator, target, kernel, dtype)
        _, sums, accepted = jax.lax.fori_loop(0, length, body, (begun, zero, jnp.zeros((), dtype)))
        return sums, accepted

    return jax.vmap(one)(keys, starts, weight)
