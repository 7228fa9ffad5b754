"""The histogram, and the mean, of each chain by itself: chains are independent, steps are not."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.estimators import Estimator
from mcmc1d.metropolis import Kernel, Step
from mcmc1d.state import Multiplexed


class EachHistogram(Estimator):
    """The deposits' weight in each bin of a scalar x, for each of `chains` chains: sums of shape (chains, bins)."""

    edges: np.ndarray
    chains: int = eqx.field(static=True)

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> jax.Array:
        return jnp.zeros((self.chains, len(self.edges) - 1), dtype)

    def update(self, sums: jax.Array, steps: Step) -> jax.Array:
        x, weight = steps.deposits.x, steps.deposits.weight
        edges = jnp.asarray(self.edges, x.dtype)
        cell = jnp.clip(jnp.searchsorted(edges, x, side="right") - 1, 0, sums.shape[1] - 1)
        return sums.at[jnp.broadcast_to(jnp.arange(self.chains), cell.shape), cell].add(weight)


class EachMean(Estimator):
    """The sum of the scalar x of each of `chains` chains after each step, and that of its square: (chains,) each."""

    chains: int = eqx.field(static=True)
    reads_deposits: ClassVar[bool] = False

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> tuple[jax.Array, jax.Array]:
        zero = jnp.zeros(self.chains, dtype)
        return zero, zero

    def update(self, sums: tuple[jax.Array, jax.Array], steps: Step) -> tuple[jax.Array, jax.Array]:
        x = steps.state.seen.x.astype(sums[0].dtype)
        return sums[0] + x, sums[1] + x * x


def autocorrelation_time(sums: tuple[np.ndarray, np.ndarray], steps: int) -> float:
    """The integrated autocorrelation time of x, by the sums of `EachMean` over stationary chains of so many steps.

    The variance of a chain's mean, over that of independent draws: known to sqrt(2 / chains) of it, and low by some
    half of its share of the steps.
    """
    mean, square = (s.ravel() / steps for s in sums)
    return float(steps * mean.var(ddof=1) / (square.mean() - mean.mean() ** 2))
