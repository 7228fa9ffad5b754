"""What a target is: an unnormalised density on a bounded domain, with its exact bin masses."""

import abc
from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, rising
from mcmc1d.quadrature import Outline, integrate, integrate_plane
from mcmc1d.types import Array, Corners, Float, Scalar

Edges: TypeAlias = Any
"""The edges of bins: n + 1 rising numbers on the line, a pair (x_edges, y_edges) of such in the plane."""


class Target(eqx.Module):
    """An unnormalised density f of x on an interval or box, with respect to Lebesgue measure dx.

    Its integral b need not be one. A subclass is final: it defines `log_f`, and `bin_masses` in closed form (or by
    `return self.quadrature(edges)`).
    """

    @property
    def domain(self) -> Corners:
        """The lower and upper corner of the domain; the unit interval unless redefined."""
        return 0.0, 1.0

    @property
    def breaks(self) -> tuple[float, ...]:
        """Where f jumps or bends (in 1D); quadrature is split there."""
        return ()

    @property
    def outline(self) -> Outline:
        """Where f jumps or bends in the plane, beyond the sides of its domain; nowhere unless redefined."""
        return Outline(np.zeros(0))

    @abc.abstractmethod
    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        """Log f(x): one point, -inf where f is zero (outside the domain as well)."""

    def look(self, x: Float[Array, "..."]) -> tuple[Scalar, Any]:
        """`log_f(x)`, and what else was found that a kernel may want of the state: arrays, or a tree of them.

        Nothing unless redefined; a `Multiplexed` is refused whose target says other than its `log_f` here.
        """
        return self.log_f(x), ()

    @abc.abstractmethod
    def bin_masses(self, edges: Edges) -> np.ndarray:
        """The exact integral of f over each bin between the `edges`, in float64 on the host: (n,), or (nx, ny)."""

    def complaint(self, x: ArrayLike) -> str:
        """What is wrong with f at an x where `log_f` is NaN or infinite, for a message."""
        if np.isposinf(self.log_f(jnp.asarray(x))):
            return f"{type(self).__name__} is infinite at x = {x}"
        return f"{type(self).__name__} is NaN at x = {x}: the density is negative or undefined there"

    def quadrature(self, edges: Edges) -> np.ndarray:
        """`bin_masses` without a closed form: adaptive quadrature, right to 1e-11 of the whole, 1e-10 in the plane."""
        if np.ndim(self.domain[0]) == 0:
            ends = tuple(float(end) for end in self.domain)  # f may drop to zero there, inside a bin
            return integrate(DensityOf(self), edges, self.breaks + ends)[0]
        x_edges, y_edges = pair_of_edges(edges, type(self).__name__)
        return integrate_plane(DensityOf(self), x_edges, y_edges, [self.outline, Outline.box(*self.domain)])[0]


def pair_of_edges(edges: Edges, who: str) -> tuple[np.ndarray, np.ndarray]:
    """The pair (x_edges, y_edges), or `ValueError` where what was given is none."""
    pair = len(edges) == 2 and all(np.ndim(part) == 1 for part in edges)
    require(pair, f"{who}: in the plane, edges are a pair (x_edges, y_edges), each of rising numbers")
    return edges[0], edges[1]


def edges_of_each(edges: Edges, n: int, who: str) -> list[np.ndarray]:
    """The edges of each of n coordinates: as many arrays, or one for all; rising, or `ValueError`."""
    shared = isinstance(edges, np.ndarray) and edges.ndim == 1
    each = [edges] * n if shared else list(edges)
    require(len(each) == n, f"{who}: give the edges of {n} coordinates, not of {len(each)}")
    return [rising(own, who) for own in each]


def unit_cube(d: int) -> Corners:
    """The corners of [0, 1]^d as a domain; of one dimension, two numbers."""
    return (0.0, 1.0) if d == 1 else (np.zeros(d), np.ones(d))


class DensityOf(eqx.Module):
    """f itself as a function of x: a module, so that its parameters take the precision of the integration."""

    target: Target

    def __call__(self, x: Float[Array, "..."]) -> Scalar:
        return jnp.exp(self.target.log_f(x))
