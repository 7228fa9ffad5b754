"""Histograms of a planar x, and the exact law of (technique, x) that they converge to."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require_cover, rising
from mcmc1d.estimators import Estimator, add_deposits
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Kernel, Step
from mcmc1d.numerics import require
from mcmc1d.quadrature import Outline, integrate_plane
from mcmc1d.state import Multiplexed, Shares
from mcmc1d.techniques.planar import outlines
from mcmc1d.types import Array, Float


class Histogram2D(Estimator):
    """The deposits' weight in each cell of a planar x: sums of shape (nx, ny), or (n_techniques, nx, ny) if `joint`.

    Divided by the steps it converges to the cell masses of f / b, jointly to those of w_i f / b.
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
        _require_cover("Histogram2D", target, np.asarray(self.x_edges), np.asarray(self.y_edges))
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


def planar_joint_masses(target: Multiplexed, x_edges: np.ndarray, y_edges: np.ndarray) -> np.ndarray:
    """The exact law of (technique, x) in the plane: the integral of w_i f / b over each cell, (n_techniques, nx, ny).

    By adaptive quadrature to 1e-10, split at the outlines of the target and the techniques. `ValueError` where that
    is out of reach: a density or a weight that jumps along a curve that no `outline` names.
    """
    x_edges, y_edges = rising(x_edges, "planar_joint_masses"), rising(y_edges, "planar_joint_masses")
    _require_cover("planar_joint_masses", target, x_edges, y_edges)
    known = [target.target.outline, Outline.box(*target.target.domain)]
    known += [outline for technique in target.techniques for outline in outlines(technique)]
    masses = np.moveaxis(integrate_plane(Shares(target), x_edges, y_edges, known)[0], -1, 0)
    return masses / masses.sum()


def _require_cover(who: str, target: Multiplexed, x_edges: np.ndarray, y_edges: np.ndarray) -> None:
    lower, upper = (np.asarray(corner, np.float64) for corner in target.target.domain)
    name = type(target.target).__name__
    require(lower.shape == (2,), f"{who}: x must be a point of the plane; {name} has x of shape {lower.shape}")
    for k, edges in enumerate((x_edges, y_edges)):
        require_cover(f"{who}, along x[{k}]", edges, (lower[k], upper[k]), name)


EXAMPLES = Examples(
    lambda: {
        "planar_histogram": Histogram2D(np.linspace(0, 1, 17), np.linspace(0, 1, 9)),
        "planar_joint_histogram": Histogram2D([0, 0.2, 0.7, 1], [0, 0.5, 1], joint=True),
    }
)
