"""A table of masses in the plane: the 2D importance map of renderers."""

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import density_table, require, require_box
from mcmc1d.examples import Examples
from mcmc1d.numerics import below_one, choose, limit, parameter, unchoose, width
from mcmc1d.quadrature import Outline
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.techniques.disk import ConcentricDisk
from mcmc1d.techniques.mixture import Mixture
from mcmc1d.techniques.planar import Planar, Rectangle
from mcmc1d.techniques.triangle import Triangle
from mcmc1d.types import Array, Corners, Float, Index, Real, Scalar


class MarginalConditional(Planar):
    """A table of masses on equal cells of a box: the column by its marginal, then the row by its conditional.

    The 2D importance map of renderers: u0 chooses the column and the place in it, u1 the row and the place in that. A
    cell of mass zero is never made.
    """

    marginal: Float[Real, " nx+1"]
    conditional: Float[Real, "nx ny+1"]
    lower: Float[Real, " 2"]
    upper: Float[Real, " 2"]

    def __init__(self, masses: ArrayLike, lower: ArrayLike = (0.0, 0.0), upper: ArrayLike = (1.0, 1.0)):
        """`masses`: (nx, ny) relative masses, none negative, one positive at least; `lower`, `upper`: the corners."""
        table = np.asarray(masses, np.float64)
        require(
            table.ndim == 2,
            f"MarginalConditional: the masses must be a table of shape (nx, ny), not of {table.ndim} dimensions",
        )
        density_table("MarginalConditional", np.arange(table.size + 1), table.ravel(), cells=True)
        columns = table.sum(1)
        # An empty column is never chosen; equal rows stand in it, so that nothing divides by zero.
        rows = np.where(columns[:, None] > 0, table, 1)
        self.marginal = np.concatenate([[0.0], np.cumsum(columns)]) / columns.sum()
        self.conditional = np.pad(np.cumsum(rows, axis=1), ((0, 0), (1, 0))) / rows.sum(1, keepdims=True)
        self.lower, self.upper = parameter(lower), parameter(upper)
        require_box(self, self.lower, self.upper)

    @property
    def support(self) -> Corners:
        return self.lower, self.upper

    @property
    def outline(self) -> Outline:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        x, y = (np.linspace(lower[k], upper[k], n + 1) for k, n in enumerate(self._shape))
        return Outline.lines(x, y)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        nx, ny = self._shape
        column, place = choose(self.marginal, u[0])
        rows = jnp.asarray(self.conditional)[column]
        row, height = choose(rows, u[1])
        z = jnp.stack([(column + place) / nx, (row + height) / ny])
        x = limit(self.lower + z * (self.upper - self.lower), self.lower, self.upper)
        return x, u[2:], -self._log_density(column, row)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        (column, row), place = self._cell(x)
        rows = jnp.asarray(self.conditional)[column]
        u = jnp.stack([unchoose(self.marginal, column, place[0]), unchoose(rows, row, place[1])])
        return u, self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        inside = jnp.all((x >= self.lower) & (x <= self.upper))
        return jnp.where(inside, self._log_density(*self._cell(x)[0]), -jnp.inf)

    @property
    def _shape(self) -> tuple[int, int]:
        return self.conditional.shape[0], self.conditional.shape[1] - 1

    def _cell(self, x: Float[Array, " 2"]) -> tuple[tuple[Index, Index], Float[Array, " 2"]]:
        """The column and row that hold x, and the place inside the cell."""
        n = np.array(self._shape, np.float64).astype(x.dtype)
        z = (x - self.lower) / (self.upper - self.lower) * n
        cell = jnp.clip(jnp.floor(z), 0, n - 1)
        return (cell[0].astype(jnp.int32), cell[1].astype(jnp.int32)), below_one(z - cell)

    def _log_density(self, column: Index, row: Index) -> Scalar:
        nx, ny = self._shape
        mass = width(self.marginal, column) * width(jnp.asarray(self.conditional)[column], row)
        return jnp.log(mass * (nx * ny)) - jnp.log(self.upper - self.lower).sum()


_INNER = Mixture((Rectangle(), ConcentricDisk((0.6, 0.5), 0.4)), (0.6, 0.4))

EXAMPLES = Examples(
    lambda: {
        "marginal_conditional": MarginalConditional([[1, 2, 0.5], [0, 0, 0], [4, 0, 1], [0.2, 3, 3]], (-1, 0), (1, 3)),
        "planar_mixture": Mixture((Triangle([[0.1, 0.2], [0.9, 0.1], [0.3, 0.95]]), _INNER), (0.3, 0.7)),
    }
)
