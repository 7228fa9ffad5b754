"""Targets from tables of numbers: piecewise linear, and tabulated on equal cells."""

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import density_table, rising
from mcmc1d.examples import Examples
from mcmc1d.numerics import locate
from mcmc1d.targets.base import Target
from mcmc1d.types import Corners, Float, Real, Scalar


class PiecewiseLinear(Target):
    """f interpolates `values` linearly between `knots`; zero outside."""

    knots: Float[Real, " n+1"]
    values: Float[Real, " n+1"]

    def __init__(self, knots: ArrayLike, values: ArrayLike):
        """`knots`: n + 1 rising numbers; `values`: f there, none negative, not all zero."""
        self.knots, self.values = density_table("PiecewiseLinear", knots, values, cells=False)

    @property
    def domain(self) -> Corners:
        return self.knots[0], self.knots[-1]

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(np.asarray(self.knots)[1:-1].tolist())

    def log_f(self, x: Scalar) -> Scalar:
        return jnp.log(jnp.interp(x, self.knots, self.values, left=0, right=0))

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        knots, values = np.asarray(self.knots), np.asarray(self.values)
        edges = np.clip(rising(edges, "PiecewiseLinear.bin_masses"), knots[0], knots[-1])
        # The trapezoid rule is exact between knots; the bins are cut there and the pieces summed.
        cuts = np.union1d(edges, knots)
        f = np.interp(cuts, knots, values)
        pieces = np.concatenate([[0.0], np.cumsum((f[1:] + f[:-1]) / 2 * np.diff(cuts))])
        return np.diff(pieces[np.searchsorted(cuts, edges)])


class Tabulated(Target):
    """f is constant on each of n equal cells of [0, 1]: a 1D image."""

    values: Float[Real, " n"]

    def __init__(self, values: ArrayLike):
        """`values`: f in each cell, none negative, not all zero."""
        n = np.size(values)
        _, self.values = density_table("Tabulated", np.arange(n + 1), values, cells=True)

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(self._edges()[1:-1].tolist())

    def log_f(self, x: Scalar) -> Scalar:
        inside = (x >= 0) & (x <= 1)
        # The cells of `bin_masses`, to the last bit, so that f and its masses agree on where it jumps.
        return jnp.where(inside, jnp.log(jnp.asarray(self.values))[locate(self._edges().astype(x.dtype), x)], -jnp.inf)

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        inside = np.clip(rising(edges, "Tabulated.bin_masses"), 0, 1)
        total = np.concatenate([[0.0], np.cumsum(np.asarray(self.values) / self.values.size)])
        return np.diff(np.interp(inside, self._edges(), total))

    def _edges(self) -> np.ndarray:
        return np.arange(self.values.shape[0] + 1) / self.values.shape[0]


EXAMPLES = Examples(
    lambda: {
        "piecewise_linear": PiecewiseLinear([0, 0.1, 0.4, 0.7, 1], [3, 0.5, 0, 0, 2]),
        "tabulated": Tabulated([1, 0, 0, 4, 2, 0.25, 3, 7, 1, 5]),
    }
)
