"""The lazy sampler of `pss_sampler` on a law whose number of dimensions is part of it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d import lazy, verify
from mcmc1d.lazy import LazyChain, LazySampler, LazyState
from mcmc1d.types import Array, Key

G = np.array([0.05, 0.2, 2.5, 1.25])
"""The density of every number but the first, on quarters of the unit interval."""
SHARES = np.array([0.3, 0.3, 0.4])
"""Of the states that read 0, 1 and 2 further numbers."""
UNREAD = -1.0
_CELLS = 16


def on_quarters(u: Array) -> Array:
    """Log g(u)."""
    return jnp.asarray(np.log(G), u.dtype)[jnp.minimum((4 * u).astype(jnp.int32), 3)]


def product(sampler: LazySampler, state: LazyState) -> tuple[Array, Array, LazyState]:
    """The first number says how many further ones are read; f is the product of their densities."""
    first, state = sampler.get(state)
    further = jnp.minimum((3 * first).astype(jnp.int32), 2)
    log_f, sample = jnp.asarray(np.log(3 * SHARES), first.dtype)[further], [first]
    for j in (1, 2):
        u, state = sampler.get(state, further >= j)
        log_f = log_f + jnp.where(further >= j, on_quarters(u), 0)
        sample.append(jnp.where(further >= j, u, UNREAD))
    return log_f, jnp.stack(sample), state


def product_law() -> verify.Law:
    """The law of the numbers that are read, exactly."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        further = rng.choice(3, size=n, p=SHARES)
        rest = (rng.choice(4, size=(n, 2), p=G / 4) + rng.random((n, 2))) / 4
        rest = np.where(further[:, None] >= (1, 2), rest, UNREAD)
        return np.concatenate([((further + rng.random(n)) / 3)[:, None], rest], axis=1)

    def cell(j: int) -> Callable[[np.ndarray], np.ndarray]:
        def of(x: np.ndarray) -> np.ndarray:
            further = np.minimum((3 * np.asarray(x[:, 0], np.float64)).astype(int), 2)
            place = np.clip((_CELLS * x[:, j]).astype(int), 0, _CELLS - 1)
            return np.where(further < j, 0, 1 + (further - j) * _CELLS + place)

        return of

    masses = np.repeat(G / 4, _CELLS // 4) / (_CELLS // 4)
    statistics: dict[str, Any] = {
        "u0": verify.Continuous(lambda x: x[:, 0], lambda u: np.interp(u, np.arange(4) / 3, np.cumsum([0, *SHARES])))
    }
    for j in (1, 2):
        cells = np.concatenate([[SHARES[:j].sum()], *(SHARES[k] * masses for k in range(j, 3))])
        statistics[f"reads, u{j}"] = verify.Discrete(cell(j), cells, cut=True)
    return verify.Law(sample, statistics=statistics, name="product")


class _Begin(eqx.Module):
    """From an exact draw, at a random hour; the numbers not read so far have never been.

    `zeros`: they are 0 with a time stamp of 0, as the book fills gaps; then the hour is 0.
    """

    sampler: LazySampler
    zeros: Array

    def __call__(self, key: Key, position: Array) -> LazyChain:
        further = jnp.minimum((3 * position[0]).astype(jnp.int32), 2)
        read = jnp.arange(3) <= further
        hour = jnp.where(self.zeros, 0, jax.random.randint(key, (), 0, 8))
        samples = self.sampler.init(jnp.zeros(4 * self.sampler.size, position.dtype))
        samples = eqx.tree_at(
            lambda s: (s.value, s.stamp, s.iteration),
            samples,
            (jnp.where(read, position, 0), jnp.where(read, hour, jnp.where(self.zeros, 0, lazy.NEVER)), hour),
        )
        log_g = jnp.where(read[1:], on_quarters(position[1:]), 0).sum()
        return LazyChain(samples, jnp.asarray(np.log(3 * SHARES), position.dtype)[further] + log_g, position)


class _Step(eqx.Module):
    sampler: LazySampler

    def __call__(self, key: Key, chain: LazyChain) -> LazyChain:
        w = jax.random.uniform(key, (self.sampler.dim_w,), chain.log_f.dtype)
        return lazy.step(self.sampler, product, chain, w)[0]


def sample_of(chain: LazyChain) -> Array:
    """The numbers that the chain's state reads."""
    return chain.sample


def under_test(sampler: LazySampler, *, zeros: bool = False) -> verify.JaxKernel:
    """The sampler's chain as a kernel; modules, so that those that differ in `zeros` alone compile once."""
    return verify.JaxKernel(_Step(sampler), _Begin(sampler, jnp.asarray(zeros)), sample_of, name="lazy sampler")


def merged_draws(sampler: LazySampler, iteration: int, w: Array) -> Array:
    """A number that stood at 0.3 in iteration 0 and is next read in `iteration`."""
    state = eqx.tree_at(
        lambda s: (s.value, s.stamp, s.iteration, s.large),
        sampler.init(w[0]),
        (jnp.full(1, 0.3), jnp.zeros(1, jnp.int32), jnp.asarray(iteration, jnp.int32), jnp.zeros((), bool)),
    )
    return _read(sampler, state, w)


@eqx.filter_jit
def _read(sampler: LazySampler, state: LazyState, w: Array) -> Array:
    return jax.vmap(lambda numbers: sampler.get(eqx.tree_at(lambda s: s.w, state, numbers[None]))[0])(w)
