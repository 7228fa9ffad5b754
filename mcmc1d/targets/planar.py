"""Targets in the plane, each on a box: a rotated mixture, a ring, a banana, a checkerboard with holes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.nn import logsumexp
from numpy.typing import ArrayLike

from mcmc1d.checks import density_table, require, require_box, require_positive, rising
from mcmc1d.examples import Examples
from mcmc1d.numerics import number, parameter
from mcmc1d.quadrature import Outline
from mcmc1d.targets.base import Edges, Target
from mcmc1d.types import Corners, Float, Real, Scalar


class RotatedMixture(Target):
    """f(x) = sum_k weights_k N(x; means_k, R_k diag(sigmas_k^2) R_k') on a box, R_k the rotation by angles_k (radians).

    What the box cuts off is lost, so the integral is under the sum of the weights.
    """

    means: Float[Real, "n 2"] = eqx.field(converter=parameter)
    sigmas: Float[Real, "n 2"] = eqx.field(converter=parameter)
    angles: Float[Real, " n"] = eqx.field(converter=parameter)
    weights: Float[Real, " n"] = eqx.field(converter=parameter)
    lower: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    upper: Float[Real, " 2"] = eqx.field(converter=parameter, default=(1.0, 1.0))

    def __check_init__(self):
        n = len(self.weights)
        shapes = [np.shape(v) for v in (self.means, self.sigmas, self.angles)]
        require(
            shapes == [(n, 2), (n, 2), (n,)],
            f"RotatedMixture: {n} weights need means and sigmas of shape ({n}, 2) and {n} angles, not {shapes}",
        )
        require_positive(self, sigmas=self.sigmas, weights=self.weights)
        require_box(self, self.lower, self.upper)

    @property
    def domain(self) -> Corners:
        return self.lower, self.upper

    def log_f(self, x: Float[Real, " 2"]) -> Scalar:
        d = x[None, :] - jnp.asarray(self.means)
        cos, sin = jnp.cos(self.angles), jnp.sin(self.angles)
        along = (d[:, 0] * cos + d[:, 1] * sin) / self.sigmas[:, 0]
        across = (d[:, 1] * cos - d[:, 0] * sin) / self.sigmas[:, 1]
        log_terms = jnp.log(self.weights / (2 * np.pi * self.sigmas[:, 0] * self.sigmas[:, 1]))
        return _on_box(self, x, logsumexp(log_terms - (along * along + across * across) / 2))

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)


class Ring(Target):
    """A ring about `centre`, as steep as a normal density of deviation `width`, brighter on one side by exp(tilt x0).

    log f = -((r^2 - radius^2) / (2 radius width))^2 / 2 + tilt x0, with r the distance from the centre and x0 =
    (x[0] - centre[0]) / radius: smooth at the centre too, and near the ring ((r - radius) / width)^2 / 2.
    """

    centre: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.5, 0.5))
    radius: Scalar = eqx.field(converter=number, default=0.3)
    width: Scalar = eqx.field(converter=number, default=0.04)
    tilt: Scalar = eqx.field(converter=number, default=0.8)
    lower: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    upper: Float[Real, " 2"] = eqx.field(converter=parameter, default=(1.0, 1.0))

    def __check_init__(self):
        require_positive(self, radius=self.radius, width=self.width)
        require_box(self, self.lower, self.upper)

    @property
    def domain(self) -> Corners:
        return self.lower, self.upper

    def log_f(self, x: Float[Real, " 2"]) -> Scalar:
        z = (x - self.centre) / self.radius
        off = (z @ z - 1) * self.radius / (2 * self.width)
        return _on_box(self, x, self.tilt * z[0] - off * off / 2)

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)


class Banana(Target):
    """x0 ~ N(0, 1) and x1 ~ N(bend x0^2, noise^2), cut off by a box: curved, and skewed in x1."""

    bend: Scalar = eqx.field(converter=number, default=0.5)
    noise: Scalar = eqx.field(converter=number, default=0.4)
    lower: Float[Real, " 2"] = eqx.field(converter=parameter, default=(-3.0, -1.5))
    upper: Float[Real, " 2"] = eqx.field(converter=parameter, default=(3.0, 5.0))

    def __check_init__(self):
        require_positive(self, noise=self.noise)
        require_box(self, self.lower, self.upper)

    @property
    def domain(self) -> Corners:
        return self.lower, self.upper

    def log_f(self, x: Float[Real, " 2"]) -> Scalar:
        off = (x[1] - self.bend * x[0] * x[0]) / self.noise
        return _on_box(self, x, -(x[0] * x[0] + off * off) / 2)

    def bin_masses(self, edges: Edges) -> np.ndarray:
        return self.quadrature(edges)


class Checkerboard(Target):
    """f is constant on each of nx times ny equal cells of a box, and 0 in some: a 2D image with holes."""

    values: Float[Real, "nx ny"]
    lower: Float[Real, " 2"]
    upper: Float[Real, " 2"]

    def __init__(self, values: ArrayLike, lower: ArrayLike = (0.0, 0.0), upper: ArrayLike = (1.0, 1.0)):
        """`values`: (nx, ny), f in each cell, none negative, not all zero; `lower`, `upper`: the corners."""
        table = np.asarray(values, np.float64)
        require(
            table.ndim == 2,
            f"Checkerboard: the values must be a table of shape (nx, ny), not of {table.ndim} dimensions",
        )
        density_table("Checkerboard", np.arange(table.size + 1), table.ravel(), cells=True)
        self.values, self.lower, self.upper = table, parameter(lower), parameter(upper)
        require_box(self, self.lower, self.upper)

    @property
    def domain(self) -> Corners:
        return self.lower, self.upper

    @property
    def outline(self) -> Outline:
        return Outline.lines(*self._lines())

    def log_f(self, x: Float[Real, " 2"]) -> Scalar:
        n = np.array(self.values.shape, np.float64).astype(x.dtype)
        cell = jnp.clip(jnp.floor((x - self.lower) / (self.upper - self.lower) * n), 0, n - 1).astype(jnp.int32)
        return _on_box(self, x, jnp.log(jnp.asarray(self.values))[cell[0], cell[1]])

    def bin_masses(self, edges: Edges) -> np.ndarray:
        shares = [_overlaps(rising(e, "Checkerboard.bin_masses"), t) for e, t in zip(edges, self._lines(), strict=True)]
        return shares[0] @ np.asarray(self.values) @ shares[1].T

    def _lines(self) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        x, y = (np.linspace(lower[k], upper[k], n + 1) for k, n in enumerate(self.values.shape))
        return x, y


def _overlaps(edges: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """The length that each bin has in common with each cell."""
    upper = np.minimum(edges[1:, None], lines[None, 1:])
    return np.maximum(upper - np.maximum(edges[:-1, None], lines[None, :-1]), 0)


def _on_box(target: "RotatedMixture | Ring | Banana | Checkerboard", x: Float[Real, " 2"], log_f: Scalar) -> Scalar:
    return jnp.where(jnp.all((x >= target.lower) & (x <= target.upper)), log_f, -jnp.inf)


def two_ridges() -> RotatedMixture:
    """Two crossing ridges and a round peak at a wall: asymmetric, three modes, correlated both ways."""
    return RotatedMixture(
        [[0.35, 0.4], [0.7, 0.65], [0.95, 0.1]],
        [[0.2, 0.05], [0.16, 0.06], [0.07, 0.07]],
        [0.6, -0.8, 0.0],
        [0.45, 0.35, 0.2],
    )


def board() -> Checkerboard:
    """Bright and dark cells that do not alternate evenly; four holes."""
    return Checkerboard([[4, 0, 1, 2], [0.5, 3, 0, 1], [1, 0, 5, 0.2], [2, 1, 0, 3]])


EXAMPLES = Examples(
    lambda: {"rotated_mixture": two_ridges(), "ring": Ring(), "banana": Banana(), "checkerboard": board()}
)
