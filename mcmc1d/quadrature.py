"""Exact integrals over bins, by adaptive quadrature with an error bound, on the host in float64."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import cubature

from mcmc1d.checks import rising
from mcmc1d.numerics import cast, require
from mcmc1d.types import Array, Float


def integrate(
    function: Callable[[Float[Array, "..."]], Float[Array, "..."]],
    edges: np.ndarray,
    breaks: Iterable[float] = (),
    tolerance: float = 1e-11,
) -> tuple[np.ndarray, np.ndarray]:
    """The integral of a JAX function of one scalar over each of the bins between the n + 1 `edges`.

    `function` maps a scalar x to an array of any shape. The bins are split at `breaks` (where it jumps or bends) and
    then halved until the Gauss-Kronrod error estimate is under `tolerance` times the whole integral. Returns the
    integrals and their error estimates, both of shape (n, ...). Raises `ValueError` where that is out of reach.
    """
    edges = rising(edges, "integrate")
    inner = [b for b in breaks if edges[0] < b < edges[-1]]
    cuts = np.unique(np.concatenate([edges, inner]))
    with jax.enable_x64(True):
        evaluate = eqx.filter_jit(eqx.filter_vmap(cast(function, jnp.float64)))

        def on_nodes(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
            # All pieces at once: node t of [0, 1] in each piece, scaled by its width.
            x = a + t * (b - a)
            values = np.asarray(evaluate(jnp.asarray(x.ravel())))
            values = values.reshape(x.shape + values.shape[1:])
            return values * (b - a).reshape((1, -1) + (1,) * (values.ndim - 2))

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
        k = int(np.argmax(endless))
        raise ValueError(
            f"integrate: the function is unbounded in [{a[k]:.6g}, {b[k]:.6g}], and its integral there is infinite or "
            "can not be told; cut the pole off, or move it to x = 0, where floats are dense, if it is integrable"
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
        evaluate = eqx.filter_jit(eqx.filter_vmap(cast(function, jnp.float64)))

        def values(x: np.ndarray) -> np.ndarray:
            # Padded to multiples of 512, so that pieces of many sizes compile once.
            n = len(x)
            padded = np.pad(x, ((0, -n % 512), (0, 0)), mode="edge")
            return np.asarray(evaluate(jnp.asarray(padded)))[:n]

        options: dict[str, Any] = {"rtol": 0, "atol": 1e-11, "max_subdivisions": 300}
        result = cubature(values, lower, upper, points=list(breaks), **options)
    return float(result.estimate), float(result.error)


def midpoints(lower: np.ndarray, upper: np.ndarray, count: int) -> np.ndarray:
    """About `count` midpoints of a regular grid over a box: shape (n,), or (n, d) for corners of shape (d,)."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    if lower.ndim == 0:
        return lower + (upper - lower) * (np.arange(count) + 0.5) / count
    side = max(2, round(count ** (1 / lower.size)))
    grid = np.array(list(itertools.product((np.arange(side) + 0.5) / side, repeat=lower.size)))
    return lower + (upper - lower) * grid
