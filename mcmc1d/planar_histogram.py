"""Histograms of a planar x."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require_planar_cover, rising
from mcmc1d.estimators import Estimator, add_deposits
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Kernel, Step
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Float


class Histogram2D(Estimator):
    """The deposits' weight in each cell of a planar x: sums of shape (nx, ny), or (n_techniques, nx, ny) if `joint`.

    Divided by the steps it converges to the cell masses of f / b, jointly to `Multiplexed.joint_masses`.
    """

    x_edges: np.ndarray
    y_edges: np.ndarray
    joint: bool = eqx.field(static=True)

    def __init__(self, x_edges: ArrayLike, y_edges: ArrayLike, *, joint: bool = False):
        """`x_edges`, `y_edges`: the rising edges of the columns and rows; `joint`: by technique as well."""
        self.x_edges = rising(np.asarray(x_edges), "Histogram2D: x_edges")
        self.y_edges = rising(np.asarray(y_edges), "Histogram2D: y_edges")
        self.joint = joint

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, "..."]:
        f, edges = target.target, (np.asarray(self.x_edges), np.asarray(self.y_edges))
        require_planar_cover("Histogram2D", *edges, f.domain, type(f).__name__)
        return jnp.zeros((target.n_techniques, *self._shape) if self.joint else self._shape, dtype)

    def update(self, sums: Float[Array, "..."], steps: Step) -> Float[Array, "..."]:
        nx, ny = self._shape
        flat = sums.reshape(*sums.shape[:-2], nx * ny)
        return add_deposits(flat, steps.deposits, self._cell, joint=self.joint).reshape(sums.shape)

    @property
    def _shape(self) -> tuple[int, int]:
        return self.x_edges.shape[0] - 1, self.y_edges.shape[0] - 1

    def _cell(self, x: Float[Array, "2 chains"]) -> Array:
        (nx, ny), found = self._shape, []
        for edges, part, n in zip((self.x_edges, self.y_edges), x, (nx, ny), strict=True):
            found.append(jnp.clip(jnp.searchsorted(jnp.asarray(edges, part.dtype), part, side="right") - 1, 0, n - 1))
        return found[0] * ny + found[1]


EXAMPLES = Examples(
    lambda: {
        "planar_histogram": Histogram2D(np.linspace(0, 1, 17), np.linspace(0, 1, 9)),
        "planar_joint_histogram": Histogram2D([0, 0.2, 0.7, 1], [0, 0.5, 1], joint=True),
    }
)
