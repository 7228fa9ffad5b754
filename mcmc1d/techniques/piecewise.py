"""Techniques from tables of numbers: piecewise constant, piecewise linear, and tabulated on equal cells."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import density_table
from mcmc1d.examples import Examples
from mcmc1d.numerics import between, choose, entry, linear_cdf, linear_quantile, locate, unchoose, width
from mcmc1d.techniques.base import Inversion, density_within, within
from mcmc1d.types import Array, Corners, Float, Index, Real, Scalar


class PiecewiseConstant(Inversion):
    """A step density: `heights[k]` on [edges[k], edges[k+1]), rescaled to integrate to one.

    A cell of height zero has an interval of zero width in u and is never selected.
    """

    edges: Float[Real, " n+1"]
    cumulative: Float[Real, " n+1"]

    def __init__(self, edges: ArrayLike, heights: ArrayLike):
        """`edges`: n + 1 rising numbers; `heights`: n relative heights, none negative, one positive at least."""
        self.edges, heights = density_table(type(self).__name__, edges, heights, cells=True)
        self.cumulative = _cumulative(heights * np.diff(self.edges))

    @property
    def support(self) -> Corners:
        return self.edges[0], self.edges[-1]

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(np.asarray(self.edges)[1:-1].tolist())

    def quantile(self, u: Scalar) -> Scalar:
        return between(self.edges, *choose(self.cumulative, u))

    def cdf(self, x: Scalar) -> Scalar:
        return unchoose(self.cumulative, *choose(self.edges, x))

    def log_prob(self, x: Scalar) -> Scalar:
        # The logarithm of the table, not one for each x: a loop over steps takes it once.
        return self._within(x, jnp.log(self._heights()), -jnp.inf)

    def prob(self, x: Scalar) -> Scalar:
        return self._within(x, self._heights(), 0)

    def _heights(self) -> Float[Array, " n"]:
        return jnp.diff(jnp.asarray(self.cumulative)) / jnp.diff(jnp.asarray(self.edges))

    def _within(self, x: Scalar, table: Float[Array, " n"], outside: float) -> Scalar:
        """What a table has for the cell that x lies in; outside all of them, `outside`."""
        inside = (x >= self.edges[0]) & (x <= self.edges[-1])
        return jnp.where(inside, entry(table, locate(self.edges, x)), outside)


class Tabulated(Inversion):
    """A density tabulated on equal cells of [0, 1]: the mass of each, uniform inside; x is looked up without a search.

    The 1D importance map of renderers and of two-stage methods. `Tabulated.of` fills the table from a function.
    """

    cumulative: Float[Real, " n+1"]

    def __init__(self, masses: ArrayLike):
        """`masses`: n relative masses, none negative, one positive at least."""
        masses = np.asarray(masses, np.float64)
        density_table(type(self).__name__, np.linspace(0, 1, masses.size + 1), masses, cells=True)
        self.cumulative = _cumulative(masses)

    @staticmethod
    def of(density: Callable[[np.ndarray], ArrayLike], cells: int) -> "Tabulated":
        """The table of an unnormalised density's values (of an array of x) at the middles of `cells` equal cells."""
        return Tabulated(density((np.arange(cells) + 0.5) / cells))

    @property
    def breaks(self) -> tuple[float, ...]:
        n = self.cumulative.shape[0] - 1
        return tuple((np.arange(1, n) / n).tolist())

    def _cell(self, x: Scalar) -> tuple[Index, Scalar]:
        n = self.cumulative.shape[0] - 1
        k = jnp.clip(jnp.floor(x * n), 0, n - 1)
        return k.astype(jnp.int32), x * n - k

    def quantile(self, u: Scalar) -> Scalar:
        k, place = choose(self.cumulative, u)
        return (k + place) / (self.cumulative.shape[0] - 1)

    def cdf(self, x: Scalar) -> Scalar:
        return unchoose(self.cumulative, *self._cell(x))

    def log_prob(self, x: Scalar) -> Scalar:
        return within(x, jnp.log(self._density(x)))

    def prob(self, x: Scalar) -> Scalar:
        return density_within(x, self._density(x))

    def _density(self, x: Scalar) -> Scalar:
        n = self.cumulative.shape[0] - 1
        return n * width(self.cumulative, self._cell(x)[0])


class PiecewiseLinear(Inversion):
    """A density that interpolates `values` linearly between `knots`, rescaled to integrate to one.

    Where it starts from zero, dx/du is infinite.
    """

    knots: Float[Real, " n+1"]
    values: Float[Real, " n+1"]
    cumulative: Float[Real, " n+1"]

    def __init__(self, knots: ArrayLike, values: ArrayLike):
        """`knots`: n + 1 rising numbers; `values`: n + 1 relative densities, none negative."""
        self.knots, values = density_table(type(self).__name__, knots, values, cells=False)
        masses = (values[1:] + values[:-1]) / 2 * np.diff(self.knots)
        self.cumulative = _cumulative(masses)
        self.values = values / masses.sum()

    @property
    def support(self) -> Corners:
        return self.knots[0], self.knots[-1]

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(np.asarray(self.knots)[1:-1].tolist())

    def quantile(self, u: Scalar) -> Scalar:
        k, place = choose(self.cumulative, u)
        return between(self.knots, k, linear_quantile(*self._ends(k), place))

    def cdf(self, x: Scalar) -> Scalar:
        k, t = choose(self.knots, x)
        return unchoose(self.cumulative, k, linear_cdf(*self._ends(k), t))

    def log_prob(self, x: Scalar) -> Scalar:
        return within(x, jnp.log(self._density(x)), self.knots[0], self.knots[-1])

    def prob(self, x: Scalar) -> Scalar:
        return density_within(x, self._density(x), self.knots[0], self.knots[-1])

    def _density(self, x: Scalar) -> Scalar:
        k, t = choose(self.knots, x)
        left, right = self._ends(k)
        return left * (1 - t) + right * t

    def _ends(self, k: Index) -> tuple[Scalar, Scalar]:
        """The density at both ends of cell k."""
        return entry(self.values[:-1], k), entry(self.values[1:], k)


def _cumulative(masses: np.ndarray) -> np.ndarray:
    total = np.concatenate([[0.0], np.cumsum(masses)])
    return total / total[-1]


EXAMPLES = Examples(
    lambda: {
        "step": PiecewiseConstant([0, 0.5, 1], [1.6, 0.4]),
        "step_with_hole": PiecewiseConstant([0, 0.1, 0.3, 0.35, 0.9, 1], [2, 0, 5, 1, 0.01]),
        "tabulated": Tabulated([1, 3, 0, 2, 4, 1, 0.5, 7]),
        "tabulated_fine": Tabulated.of(lambda x: np.exp(-3 * x) + (x > 0.7), 1000),
        "piecewise_linear": PiecewiseLinear([0, 0.2, 0.5, 0.8, 1], [0, 3, 1, 1, 4]),
        "piecewise_linear_with_hole": PiecewiseLinear([0, 0.25, 0.5, 0.75, 1], [2, 0, 0, 1, 0]),
    }
)
