"""Any density given as a function."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.targets.base import Target
from mcmc1d.types import Scalar


class FromFunction(Target):
    """f given as a JAX function of a scalar x in [lower, upper]; bin masses by adaptive quadrature.

    `breaks` names the points where f jumps or bends. A negative or NaN value of f becomes a NaN of `log_f`, which
    every user of the target reports with its point.
    """

    f: Callable[[Scalar], Scalar]
    lower: float = eqx.field(static=True, default=0.0)
    upper: float = eqx.field(static=True, default=1.0)
    breaks: tuple[float, ...] = eqx.field(static=True, default=())

    @property
    def domain(self) -> tuple[float, float]:
        return self.lower, self.upper

    def log_f(self, x: Scalar) -> Scalar:
        inside = (x >= self.lower) & (x <= self.upper)
        return jnp.where(inside, jnp.log(self.f(x)), -jnp.inf)

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        return self.quadrature(edges)


def _two_bumps(x: Scalar) -> Scalar:
    return jnp.where(x < 0.6, x * x, 0.1 + jnp.exp(-40 * (x - 0.8) ** 2))


EXAMPLES = {"from_function": FromFunction(_two_bumps, breaks=(0.6,))}
