"""Exact integrals over bins, by adaptive quadrature with an error bound, on the host in float64."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import cubature

from mcmc1d.checks import require, rising
from mcmc1d.compiling import quickly
from mcmc1d.numerics import cast
from mcmc1d.types import Array, Float


def integrate(
    function: Callable[[Float[Array, "..."]], Float[Array, "..."]],
    edges: np.ndarray,
    breaks: Iterable[float] = (),
    tolerance: float = 1e-11,
) -> tuple[np.ndarray, np.ndarray]:
    """The integral of a JAX function of one scalar over each of the bins between the n + 1 `edges`.

    `function` maps a scalar x to an array of any shape. The bins are split at `breaks` (where it jumps or bends), and
    around what is sharp at 2**14 regular points, whatever the bins (a peak between two of them is missed); then all are
    halved until the Gauss-Kronrod error estimate is under `tolerance` times the whole integral. Returns the integrals
    and their error estimates, both of shape (n, ...). Raises `ValueError` where that is out of reach.
    """
    edges = rising(edges, "integrate")
    with jax.enable_x64(True):
        values = by_chunks(quickly(eqx.filter_vmap(cast(function, jnp.float64))), 2**12)

        def on_nodes(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
            # All pieces at once: node t of [0, 1] in each piece, scaled by its width.
            x = a + t * (b - a)
            found = values(x.ravel())
            found = found.reshape(x.shape + found.shape[1:])
            return found * (b - a).reshape((1, -1) + (1,) * (found.ndim - 2))

        marks = [np.asarray(list(breaks), np.float64), around_the_sharpest(values, edges[0], edges[-1])]
        cuts = _cuts(edges, np.concatenate(marks))
        a, b = cuts[:-1], cuts[1:]
        scale = np.abs(on_nodes(np.linspace(0, 1, 33)[1:-1, None], a, b)).mean(0).sum(0).max()
        require(bool(np.isfinite(scale)), "integrate: the function is not finite somewhere inside the bins")
        with np.errstate(invalid="ignore"):  # infinities are looked for below
            result = cubature(
                lambda t: on_nodes(t, a, b),
                [0.0],
                [1.0],
                rule="gk21",
                rtol=0,
                atol=max(tolerance * scale / len(a), 1e-300),
                max_subdivisions=2000,
            )
    endless = ~np.isfinite(result.estimate.reshape(len(a), -1)).all(1)
    if endless.any():
        k = int(np.searchsorted(edges, a[np.argmax(endless)], side="right")) - 1
        raise ValueError(
            f"integrate: the function is unbounded in [{edges[k]:.6g}, {edges[k + 1]:.6g}], and its integral there is "
            "infinite or can not be told; cut the pole off, or move it to x = 0, where floats are dense, if it is "
            "integrable"
        )
    require(
        result.status == "converged",
        f"integrate: the error is {np.max(result.error):.2g} after {result.subdivisions} subdivisions, above "
        f"{tolerance:.2g} of the whole; name the points where the function jumps or bends in `breaks`",
    )
    bins = np.searchsorted(edges, (a + b) / 2) - 1
    shape = (edges.size - 1, *result.estimate.shape[1:])
    integral, error = np.zeros(shape), np.zeros(shape)
    np.add.at(integral, bins, result.estimate)
    np.add.at(error, bins, result.error)
    return integral, error


_SHARPEST = 32
_ROUNDINGS = 16  # between two cuts that are one, met in two ways


def _cuts(edges: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """The edges and the marks inside, rising, but for marks a few roundings from an edge or from another.

    A piece so narrow would have nodes at its ends, where a function may be unbounded that is not inside.
    """

    def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.abs(a - b) > _ROUNDINGS * np.spacing(np.maximum(np.abs(a), np.abs(b)))

    marks = np.unique(marks[(marks > edges[0]) & (marks < edges[-1])])
    next_edge = np.searchsorted(edges, marks)
    marks = marks[apart(marks, edges[next_edge - 1]) & apart(marks, edges[next_edge])]
    return np.sort(np.concatenate([edges, marks[:1], marks[1:][apart(marks[1:], marks[:-1])]]))


def around_the_sharpest(values: Callable[[np.ndarray], np.ndarray], lower: float, upper: float) -> np.ndarray:
    """Both sides of the points of a regular grid at which a function bends most."""
    x = midpoints(np.asarray(lower), np.asarray(upper), 2**14)
    height = np.abs(values(x)).reshape(len(x), -1).sum(1)
    bend = np.abs(np.diff(np.where(np.isfinite(height), height, 0), 2))
    most = x[1:-1][np.argsort(bend)[-_SHARPEST:]]
    half = (x[1] - x[0]) / 2
    return np.concatenate([most - half, most + half])


def by_chunks(evaluate: Callable[[Array], Array], size: int) -> Callable[[np.ndarray], np.ndarray]:
    """A batched function, evaluated at so many points at once, so that one program serves every number of them."""

    def values(points: np.ndarray) -> np.ndarray:
        found = []
        for first in range(0, len(points), size):
            chunk = points[first : first + size]
            padded = np.pad(chunk, ((0, size - len(chunk)), *((0, 0),) * (chunk.ndim - 1)), mode="edge")
            found.append(np.asarray(evaluate(jnp.asarray(padded)))[: len(chunk)])
        return np.concatenate(found)

    return values


def integrate_box(
    function: Callable[[Float[Array, " d"]], Float[Array, ""]],
    lower: np.ndarray,
    upper: np.ndarray,
    breaks: Sequence[np.ndarray] = (),
) -> tuple[float, float]:
    """The integral of a JAX function of a (d,) array over a box (infinite sides allowed), and its error estimate.

    The caller judges the error: it is small for a smooth function, and not for one that jumps inside the box, at
    points other than the `breaks`, in two dimensions or more.
    """
    with jax.enable_x64(True):
        values = by_chunks(quickly(eqx.filter_vmap(cast(function, jnp.float64))), 2**9)
        options: dict[str, Any] = {"rtol": 0, "atol": 1e-11, "max_subdivisions": 300}
        result = cubature(values, lower, upper, points=list(breaks), **options)
    return float(result.estimate), float(result.error)


def midpoints(lower: np.ndarray, upper: np.ndarray, count: int) -> np.ndarray:
    """About `count` midpoints of a regular grid over a box: shape (n,), or (n, d) for corners of shape (d,).

    In so many dimensions that two a side are more, a low-discrepancy sequence of `count` points.
    """
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    if lower.ndim == 0:
        return lower + (upper - lower) * (np.arange(count) + 0.5) / count
    if 2**lower.size > count:
        return lower + (upper - lower) * r_sequence(count, lower.size)
    side = max(2, round(count ** (1 / lower.size)))
    grid = np.array(list(itertools.product((np.arange(side) + 0.5) / side, repeat=lower.size)))
    return lower + (upper - lower) * grid


def r_sequence(count: int, d: int) -> np.ndarray:
    """The first points of a low-discrepancy sequence in the unit cube, (count, d): Roberts 2018, "R_d"."""
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (d + 1))
    return np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, d + 1) % 1


# --- the plane ------------------------------------------------------------------------------------------------------


def _nowhere(t: np.ndarray) -> np.ndarray:
    return np.full((len(t), 0), np.nan)


class Outline(NamedTuple):
    """Where a function of the plane may jump or bend: at vertical lines, and along curves y(x)."""

    x: np.ndarray
    """The vertical lines, and where a curve begins, ends or turns back."""
    y_at: Callable[[np.ndarray], np.ndarray] = _nowhere
    """(n,) x -> (n, c) y of the curves; NaN where a curve is not."""
    x_at: Callable[[np.ndarray], np.ndarray] = _nowhere
    """(n,) y -> (n, c) x of the curves: where they cross a bin's edge, the bin's mass bends as a function of x."""

    @staticmethod
    def together(outlines: Sequence["Outline"]) -> "Outline":
        """All of several."""
        parts = tuple(outlines)

        def along(which: str, t: np.ndarray) -> np.ndarray:
            return np.concatenate([_nowhere(t), *(getattr(part, which)(t) for part in parts)], axis=1)

        x = np.concatenate([np.zeros(0), *(part.x for part in parts)])
        return Outline(x, partial(along, "y_at"), partial(along, "x_at"))

    @staticmethod
    def lines(x: np.ndarray, y: np.ndarray) -> "Outline":
        """Vertical and horizontal lines."""
        y = np.asarray(y, np.float64)
        return Outline(np.asarray(x, np.float64), lambda t: np.broadcast_to(y, (len(t), y.size)))

    @staticmethod
    def box(lower: Any, upper: Any) -> "Outline":
        """The sides of a box."""
        lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
        return Outline.lines(np.array([lower[0], upper[0]]), np.array([lower[1], upper[1]]))

    @staticmethod
    def circle(centre: Any, radius: Any) -> "Outline":
        """A circle."""
        centre, radius = np.asarray(centre, np.float64), float(radius)

        def across(t: np.ndarray, k: int) -> np.ndarray:
            with np.errstate(invalid="ignore"):
                half = np.sqrt(radius**2 - (t - centre[k]) ** 2)
            return np.stack([centre[1 - k] - half, centre[1 - k] + half], 1)

        ends = np.array([centre[0] - radius, centre[0] + radius])
        return Outline(ends, lambda x: across(x, 0), lambda y: across(y, 1))

    @staticmethod
    def polygon(vertices: np.ndarray) -> "Outline":
        """The sides of a polygon, from its (n, 2) vertices."""
        start = np.asarray(vertices, np.float64)
        side = np.roll(start, -1, axis=0) - start

        def along(t: np.ndarray, k: int) -> np.ndarray:
            with np.errstate(divide="ignore", invalid="ignore"):
                place = (t[:, None] - start[:, k]) / side[:, k]
            found = start[:, 1 - k] + place * side[:, 1 - k]
            return np.where((place >= 0) & (place <= 1), found, np.nan)

        return Outline(start[:, 0], lambda x: along(x, 0), lambda y: along(y, 1))


_OUTER, _INNER, _CHECK = 12, 12, 8  # nodes of Gauss and Legendre across a strip, along it, and to tell its error


def integrate_plane(
    function: Callable[[Float[Array, " 2"]], Float[Array, "..."]],
    x_edges: np.ndarray,
    y_edges: np.ndarray,
    outlines: Sequence[Outline] = (),
    tolerance: float = 1e-10,
) -> tuple[np.ndarray, float]:
    """The integral of a JAX function of a point (2,) over each cell between the edges, and a bound on its error.

    `function` maps a point to an array of any shape. Along y it is integrated between the edges and the `outlines`,
    where it jumps or bends; across, strips are halved until a strip and its halves agree. Pieces are a 32nd of the
    whole at most, of 12 nodes: a peak that is far narrower than their distance may be missed. Returns integrals of
    shape (nx, ny, ...) and the sum of all disagreements, which is under `tolerance` times the whole; `ValueError` where
    that is out of reach.
    """
    x_edges, y_edges = rising(x_edges, "integrate_plane"), rising(y_edges, "integrate_plane")
    marks = [
        x_edges,
        np.linspace(x_edges[0], x_edges[-1], 33),
        *(outline.x for outline in outlines),
        *(outline.x_at(y_edges).ravel() for outline in outlines),
    ]
    cuts = np.unique(np.concatenate(marks))
    cuts = cuts[(cuts >= x_edges[0]) & (cuts <= x_edges[-1])]
    # Cuts a few roundings apart are one cut, met in two ways.
    near = np.diff(cuts, prepend=-np.inf) > 1e-13 * np.ptp(x_edges)
    a, b = cuts[near][:-1], np.append(cuts[near][1:-1], x_edges[-1])
    with jax.enable_x64(True):
        values = by_chunks(quickly(eqx.filter_vmap(cast(function, jnp.float64))), 2**16)
        for pieces in (32, 64, 128, 256, 512):
            inside = np.linspace(y_edges[0], y_edges[-1], pieces + 1)
            strips = _Strips(values, y_edges, np.union1d(y_edges, inside), outlines)
            coarse = strips.integrals(a, b, _INNER)
            scale = max(float(np.abs(coarse).sum()), 1e-300)
            require(bool(np.isfinite(scale)), "integrate_plane: the function is not finite somewhere inside the cells")
            along = float(np.abs(coarse - strips.integrals(a, b, _CHECK)).sum())
            if along <= tolerance * scale / 2:
                break
        else:
            a, b, along = a[:0], b[:0], np.inf  # hopeless, and said so below
        total = np.zeros((len(x_edges) - 1, *coarse.shape[1:]))
        # The check is of fewer nodes than what is used, whose own error is far smaller still.
        error, budget = along, tolerance * scale / (16 * len(cuts))
        while len(a) > 0:
            middle = (a + b) / 2
            halves = [strips.integrals(a, middle, _INNER), strips.integrals(middle, b, _INNER)]
            apart = np.abs(halves[0] + halves[1] - coarse).reshape(len(a), -1).sum(1)
            done = (apart <= budget) | (b - a <= 4 * np.spacing(np.maximum(np.abs(a), np.abs(b))))
            error += float(apart[done].sum())
            np.add.at(total, np.searchsorted(x_edges, middle[done], side="right") - 1, (halves[0] + halves[1])[done])
            again = ~done
            a, b = np.concatenate([a[again], middle[again]]), np.concatenate([middle[again], b[again]])
            coarse = np.concatenate([half[again] for half in halves])
            if len(a) * pieces > 2**18:
                error = np.inf
                break
    require(
        error <= tolerance * scale,
        f"integrate_plane: the error is {error / scale:.2g} of the whole, above {tolerance:.2g}; name the curves along "
        "which the function jumps or bends in `outline`",
    )
    return total, error


class _Strips:
    """The integrals of a function over the cells of vertical strips."""

    def __init__(self, values: Callable, y_edges: np.ndarray, ends: np.ndarray, outlines: Sequence[Outline]):
        self.values, self.y_edges, self.ends, self.outlines = values, y_edges, ends, outlines

    def integrals(self, a: np.ndarray, b: np.ndarray, inner: int) -> np.ndarray:
        """Over [a_k, b_k] x each bin of y: (n, ny, ...), with `inner` nodes in each piece along y."""
        (s, outer), (t, weights) = (np.polynomial.legendre.leggauss(count) for count in (_OUTER, inner))
        x = ((a + b)[:, None] / 2 + (b - a)[:, None] / 2 * s).ravel()
        lower, upper = self.ends[0], self.ends[-1]
        curves = [np.clip(np.nan_to_num(o.y_at(x), nan=lower), lower, upper) for o in self.outlines]
        ends = np.sort(np.concatenate([np.broadcast_to(self.ends, (len(x), len(self.ends))), *curves], axis=1), axis=1)
        low, half = ends[:, :-1, None], np.diff(ends, axis=1)[..., None] / 2
        y = low + half * (1 + t)
        values = self.values(np.stack([np.broadcast_to(x[:, None, None], y.shape), y], -1).reshape(-1, 2))
        shape = values.shape[1:]
        parts = (values.reshape(*y.shape, -1) * (half * weights)[..., None]).sum(2)
        bins = np.clip(np.searchsorted(self.y_edges, (ends[:, 1:] + ends[:, :-1]) / 2) - 1, 0, len(self.y_edges) - 2)
        found = np.zeros((len(x), len(self.y_edges) - 1, parts.shape[-1]))
        np.add.at(found, (np.arange(len(x))[:, None], bins), parts)
        found = found.reshape(len(a), _OUTER, *found.shape[1:]) * (outer * (b - a)[:, None] / 2)[..., None, None]
        return found.sum(1).reshape(len(a), len(self.y_edges) - 1, *shape)
