"""What a target is: an unnormalised density on a bounded domain, with its exact bin masses."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.quadrature import integrate
from mcmc1d.types import Array, Corners, Float, Scalar


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

    @abc.abstractmethod
    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        """Log f(x): one point, -inf where f is zero (outside the domain as well)."""

    @abc.abstractmethod
    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        """The exact integral of f over each bin between the n + 1 `edges`, in float64 on the host: shape (n,)."""

    def complaint(self, x: ArrayLike) -> str:
        """What is wrong with f at an x where `log_f` is NaN or infinite, for a message."""
        if np.isposinf(self.log_f(jnp.asarray(x))):
            return f"{type(self).__name__} is infinite at x = {x}"
        return f"{type(self).__name__} is NaN at x = {x}: the density is negative or undefined there"

    def quadrature(self, edges: np.ndarray) -> np.ndarray:
        """`bin_masses` without a closed form: adaptive quadrature of f, right to 1e-11 of the whole."""
        ends = tuple(float(end) for end in self.domain)  # f may drop to zero there, inside a bin
        return integrate(DensityOf(self), edges, self.breaks + ends)[0]


class DensityOf(eqx.Module):
    """f itself as a function of x: a module, so that its parameters take the precision of the integration."""

    target: Target

    def __call__(self, x: Scalar) -> Scalar:
        return jnp.exp(self.target.log_f(x))
