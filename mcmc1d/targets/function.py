"""Any density given as a function."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, several
from mcmc1d.examples import Examples
from mcmc1d.targets.base import Target
from mcmc1d.types import Scalar


class FromFunction(Target):
    """f given as a JAX function of a scalar x in [lower, upper]; bin masses by adaptive quadrature.

    A negative or NaN value of f becomes a NaN of `log_f`, which every user of the target reports with its point.
    """

    f: Callable[[Scalar], Scalar]
    lower: float = eqx.field(static=True)
    upper: float = eqx.field(static=True)
    kinks: tuple[float, ...] = eqx.field(static=True)

    def __init__(
        self, f: Callable[[Scalar], Scalar], lower: float = 0.0, upper: float = 1.0, breaks: Sequence[float] = ()
    ):
        """`f`: from x to a number that is not negative; `breaks`: where it jumps or bends inside [lower, upper]."""
        require(
            np.ndim(lower) == np.ndim(upper) == 0,
            f"FromFunction: it is of one coordinate, between two numbers, not {lower} and {upper}; of several, make a "
            "class of Target with domain, log_f and bin_masses",
        )
        require(
            bool(np.isfinite(lower) and np.isfinite(upper) and lower < upper),
            f"FromFunction: lower must be under upper, both finite, not {lower} and {upper}",
        )
        require(callable(f), f"FromFunction: f is a function of x, not {f!r}")
        self.f, self.lower, self.upper = f, float(lower), float(upper)
        self.kinks = tuple(map(float, several(breaks, "FromFunction: breaks")))
        require(bool(np.isfinite(self.kinks).all()), f"FromFunction: breaks are places, not {self.kinks}")

    @property
    def breaks(self) -> tuple[float, ...]:
        return self.kinks

    @property
    def domain(self) -> tuple[float, float]:
        return self.lower, self.upper

    def log_f(self, x: Scalar) -> Scalar:
        inside, f = (x >= self.lower) & (x <= self.upper), self.f(x)
        require(not jnp.iscomplexobj(f), "FromFunction: f returned a complex number; give its absolute value or square")
        return jnp.where(inside, jnp.log(f), -jnp.inf)

    def complaint(self, x: ArrayLike) -> str:
        f = float(self.f(jnp.asarray(x)))
        if f < 0:
            return f"FromFunction is negative at x = {x}: f = {f:.6g}, and a density never is; give max(f, 0) or |f|"
        return f"FromFunction is {'NaN' if np.isnan(f) else f} at x = {x}"

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        return self.quadrature(edges)


def _two_bumps(x: Scalar) -> Scalar:
    return jnp.where(x < 0.6, x * x, 0.1 + jnp.exp(-40 * (x - 0.8) ** 2))


EXAMPLES = Examples(lambda: {"from_function": FromFunction(_two_bumps, breaks=(0.6,))})
