"""The histogram of each chain by itself: chains are independent, steps are not."""

from typing import Any

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
