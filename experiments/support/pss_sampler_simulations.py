"""The simulations of `pss_sampler`: streams that a camera path shifts, and a target with holes."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from mcmc1d import lazy
from mcmc1d.lazy import LazyChain, LazySampler, LazyState
from mcmc1d.types import Array, Key

KAPPA = 20.0


def paths(sampler: LazySampler, state: LazyState) -> tuple[Array, Array, LazyState]:
    """A camera path of one to three numbers beside the one that says how many, and a light path of two.

    The light's numbers are peaked; with one stream they stand after the camera's, wherever those end.
    """
    first, state = sampler.get(state)
    count = jnp.minimum((3 * first).astype(jnp.int32), 2) + 1
    log_f = jnp.zeros_like(first)
    for j in (1, 2, 3):
        u, state = sampler.get(state, count >= j)
        log_f = log_f + jnp.where(count >= j, jnp.log(0.5 + u), 0)
    if sampler.streams == 2:
        state = sampler.start_stream(state, 1)
    for centre in (0.3, 0.8):
        u, state = sampler.get(state)
        log_f = log_f + KAPPA * (jnp.cos(2 * jnp.pi * (u - centre)) - 1)
    return log_f, count, state


HOLES = np.array([0, 0, 3.0, 0, 0, 0, 1.0, 0, 0, 0])
"""A target on the line that is dark on eight tenths of it."""


def holes(sampler: LazySampler, state: LazyState) -> tuple[Array, Array, LazyState]:
    """One number, and a density with holes."""
    u, state = sampler.get(state)
    cell = jnp.minimum((len(HOLES) * u).astype(jnp.int32), len(HOLES) - 1)
    with np.errstate(divide="ignore"):
        return jnp.asarray(np.log(HOLES), u.dtype)[cell], cell, state


@eqx.filter_jit
def simulate(contribution: Callable, sampler: LazySampler, key: Key, chains: LazyChain, steps: int) -> Array:
    """Sums over the steps, by chain: small steps, their acceptance; those that change the sample, theirs; dark ones."""

    def one(key: Key, chain: LazyChain) -> tuple[LazyChain, Array]:
        after, info = lazy.step(sampler, contribution, chain, jax.random.uniform(key, (sampler.dim_w,)))
        small, other = ~info.large, chain.sample != info.sample
        gained = jnp.stack(
            [small, small * info.acceptance, small & other, (small & other) * info.acceptance, jnp.isneginf(info.log_f)]
        )
        return after, gained.astype(jnp.float32)

    def body(t: Array, carry: tuple[LazyChain, Array]) -> tuple[LazyChain, Array]:
        keys = jax.random.split(jax.random.fold_in(key, t), len(carry[1]))
        after, gained = jax.vmap(one)(keys, carry[0])
        return after, carry[1] + gained

    return jax.lax.fori_loop(0, steps, body, (chains, jnp.zeros((len(chains.log_f), 5))))[1]


def ratio(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """A ratio of sums over independent chains, and its standard error."""
    value = above.sum() / below.sum()
    return float(value), float(np.sqrt(np.square(above - value * below).sum()) / below.sum())


def dark_share(sigma: float, large_step: float) -> float:
    """The share of dark proposals of the stationary chain on `HOLES`, by Gauss-Legendre quadrature on lit cells."""
    n, (nodes, weights) = len(HOLES), np.polynomial.legendre.leggauss(40)
    pi, lit = HOLES / HOLES.sum(), np.flatnonzero(HOLES)
    reach = 0.0
    for k in lit:
        x = (k + (nodes + 1) / 2) / n
        for j in lit:
            ends = np.array([j, j + 1]) / n + np.arange(-3, 4)[:, None]
            inside = np.diff(ndtr((ends[None] - x[:, None, None]) / sigma), axis=2).sum((1, 2))
            reach += pi[k] * (weights / 2) @ inside
    return float((1 - large_step) * (1 - reach) + large_step * np.mean(HOLES == 0))
