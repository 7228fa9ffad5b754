"""Images over the unit interval and square: where a point falls, exact pixel values, other resolutions."""

import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_whole, rising
from mcmc1d.compiling import quickly
from mcmc1d.numerics import cast, stratum
from mcmc1d.targets import DensityOf, Target
from mcmc1d.types import Array, Float, Index

_ORDERS = (10, 14)  # of Gauss-Legendre's rule in each cell and axis; the second checks the first
_BATCH = 2**16


class Pixels(eqx.Module):
    """A line of `side` equal pixels on [0, 1] (`dim` 1), or a square of side x side on [0, 1]^2 (`dim` 2).

    The image's axes are the first coordinates of x; further ones are integrated over, as a renderer's paths are.
    """

    side: int = eqx.field(static=True)
    dim: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        require_whole(self.side, "Pixels: side")
        require(self.dim in (1, 2), f"Pixels: an image has one or two axes, not dim={self.dim}")

    @property
    def count(self) -> int:
        """How many pixels there are."""
        return self.side**self.dim

    def require_under(self, f: Target) -> None:
        """Raise `ValueError` unless f lives on the unit cube, of as many coordinates as the image has axes, or more."""
        lower, upper = (np.asarray(end) for end in f.domain)
        require(
            max(1, lower.size) >= self.dim and bool(np.all(lower == 0) and np.all(upper == 1)),
            f"Pixels: an image of {self.dim} axes lies over the unit cube; {type(f).__name__} lives on {f.domain}",
        )

    def cell(self, x: Float[Array, "..."], regions: Index | None = None) -> Index:
        """The pixel that holds x, counted row by row; with `regions` a side, that of a coarser grid in this one's rows.

        The coarser grid's regions need not be made of whole pixels, and their number may be traced.
        """
        k = self.side if regions is None else regions
        cells = stratum(jnp.atleast_1d(x)[: self.dim], k)
        return cells[0] if self.dim == 1 else cells[0] * self.side + cells[1]


def masses(f: Target, edges: Sequence[np.ndarray], cuts: Sequence[Sequence[float]] = ()) -> np.ndarray:
    """The exact integral of f over each cell of a grid in [0, 1]^d: float64, of shape (n_1, ..., n_d).

    `edges`: of the cells, for each coordinate; `cuts`: where f jumps or turns sharply, for each. In one dimension by
    the target's own `bin_masses`; in more by Gauss-Legendre's rule, twice. Raises `ValueError` where the two orders
    differ by more than 1e-9 of the whole: more cuts are needed.
    """
    edges = [rising(axis, "masses") for axis in edges]
    if np.ndim(f.domain[0]) == 0:
        return f.bin_masses(edges[0])
    require(
        np.shape(f.domain[0]) == (len(edges),),
        f"masses: {type(f).__name__} has points of shape {np.shape(f.domain[0])}, edges are for {len(edges)} axes",
    )
    more = [*cuts, *[()] * (len(edges) - len(cuts))]
    fine = [np.unique(np.concatenate([axis, np.asarray(c, np.float64)])) for axis, c in zip(edges, more, strict=True)]
    fine = [c[(c >= axis[0]) & (c <= axis[-1])] for c, axis in zip(fine, edges, strict=True)]
    first, second = (_gauss(f, edges, fine, order) for order in _ORDERS)
    error = float(np.abs(first - second).max() / max(second.sum(), 1e-300))
    require(
        error < 1e-9,
        f"masses: {type(f).__name__} is integrated over the cells to {error:.1e} of the whole only; name in `cuts` "
        "where it jumps, and cut where it turns sharply",
    )
    return second


def _gauss(f: Target, edges: list[np.ndarray], fine: list[np.ndarray], order: int) -> np.ndarray:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    widths = [np.diff(axis) for axis in fine]
    points = [(a[:-1, None] + w[:, None] * (nodes + 1) / 2).ravel() for a, w in zip(fine, widths, strict=True)]
    grid = np.stack(np.meshgrid(*points, indexing="ij"), -1).reshape(-1, len(edges))
    with jax.enable_x64(True):
        wide, values = cast(f, jnp.float64), []
        for first in range(0, len(grid), _BATCH):  # of one size, padded, so that grids of all sizes compile once
            part = grid[first : first + _BATCH]
            padded = jnp.asarray(np.pad(part, ((0, _BATCH - len(part)), (0, 0)), mode="edge"))
            values.append(np.asarray(_density(wide, padded))[: len(part)])
    result = np.concatenate(values).reshape([len(p) for p in points])
    for axis, (own, cells, width) in enumerate(zip(edges, fine, widths, strict=True)):
        weighted = np.moveaxis(result, axis, -1) * (width[:, None] * weights / 2).ravel()
        # Cells without a node would repeat their neighbour in `reduceat`; the fine cells refine the own ones, so none.
        firsts = np.searchsorted(cells, own[:-1]) * order
        result = np.moveaxis(np.add.reduceat(weighted, firsts, axis=-1), -1, axis)
    return result


@quickly
def _density(f: Target, points: Float[Array, "n d"]) -> Float[Array, " n"]:
    return jax.vmap(DensityOf(f))(points)


def pixel_values(f: Target, pixels: Pixels, cuts: Sequence[Sequence[float]] = ()) -> np.ndarray:
    """The exact mean of f in each pixel, hidden coordinates integrated over: the image, of shape (count,)."""
    pixels.require_under(f)
    d = max(1, int(np.prod(np.shape(f.domain[0]))))
    edges = [np.linspace(0, 1, pixels.side + 1)] * pixels.dim + [np.array([0.0, 1.0])] * (d - pixels.dim)
    return masses(f, edges, cuts).ravel() * pixels.count


def resampling(side: int, to: int) -> np.ndarray:
    """The matrix (to, side) that makes means over `to` equal regions from means over `side` pixels, by overlap."""
    coarse, fine = np.linspace(0, 1, to + 1), np.linspace(0, 1, side + 1)
    overlap = np.minimum(coarse[1:, None], fine[None, 1:]) - np.maximum(coarse[:-1, None], fine[None, :-1])
    return np.maximum(overlap, 0) * to


def resample(image: np.ndarray, to: int, axes: int) -> np.ndarray:
    """Images at `to` pixels a side, from their last `axes` axes: each the mean over its own area."""
    matrix = resampling(image.shape[-1], to)
    for axis in itertools.islice((-1, -2), axes):
        image = np.moveaxis(np.moveaxis(image, axis, -1) @ matrix.T, -1, axis)
    return image
