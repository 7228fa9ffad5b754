"""Techniques on [0, 1] with an elementary closed form both ways: uniform, tent, ramp."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, linear_cdf, linear_quantile, number
from mcmc1d.techniques.base import Inversion, density_within, within
from mcmc1d.types import Scalar


class Uniform(Inversion):
    """x = u: density 1 on [0, 1]. With it alone, a chain in primary sample space is a chain in x."""

    def quantile(self, u: Scalar) -> Scalar:
        return u

    def cdf(self, x: Scalar) -> Scalar:
        return x

    def log_prob(self, x: Scalar) -> Scalar:
        return within(x, jnp.zeros_like(x))

    def prob(self, x: Scalar) -> Scalar:
        return density_within(x, jnp.ones_like(x))


class Tent(Inversion):
    """The triangular density on [0, 1]: zero at both ends, 2 at the mode, which lies strictly between.

    At u = 0 and u -> 1 the density vanishes and dx/du is infinite.
    """

    mode: Scalar = eqx.field(converter=number, default=0.5)

    def __check_init__(self):
        if is_concrete(self.mode):
            require(bool(0 < self.mode < 1), f"Tent: mode must lie strictly between 0 and 1, not {self.mode}")

    @property
    def breaks(self) -> tuple[float, ...]:
        return (float(self.mode),)

    def quantile(self, u: Scalar) -> Scalar:
        c = jnp.asarray(self.mode)
        # The mass left of the mode equals the mode; each side is a square root measured from its own end.
        return jnp.where(u < c, jnp.sqrt(u * c), 1 - jnp.sqrt((1 - u) * (1 - c)))

    def cdf(self, x: Scalar) -> Scalar:
        c = jnp.asarray(self.mode)
        return jnp.where(x < c, x * x / c, 1 - (1 - x) * (1 - x) / (1 - c))

    def log_prob(self, x: Scalar) -> Scalar:
        return within(x, jnp.log(self._density(x)))

    def prob(self, x: Scalar) -> Scalar:
        return density_within(x, self._density(x))

    def _density(self, x: Scalar) -> Scalar:
        c = jnp.asarray(self.mode)
        return 2 * jnp.where(x < c, x / c, (1 - x) / (1 - c))


class Ramp(Inversion):
    """The linear density 1 + slope (x - 1/2) on [0, 1], for a slope in [-2, 2]; slope 2 is the density 2x."""

    slope: Scalar = eqx.field(converter=number, default=2.0)

    def __check_init__(self):
        if is_concrete(self.slope):
            slope = np.asarray(self.slope)
            require(bool(-2 <= slope <= 2), f"Ramp: slope must lie in [-2, 2], or the density turns negative: {slope}")

    def _ends(self) -> tuple[Scalar, Scalar]:
        half = jnp.asarray(self.slope) / 2
        return 1 - half, 1 + half

    def quantile(self, u: Scalar) -> Scalar:
        return linear_quantile(*self._ends(), u)

    def cdf(self, x: Scalar) -> Scalar:
        return linear_cdf(*self._ends(), x)

    def log_prob(self, x: Scalar) -> Scalar:
        return within(x, jnp.log(self._density(x)))

    def prob(self, x: Scalar) -> Scalar:
        return density_within(x, self._density(x))

    def _density(self, x: Scalar) -> Scalar:
        left, right = self._ends()
        return left * (1 - x) + right * x


EXAMPLES = Examples(
    lambda: {
        "uniform": Uniform(),
        "tent": Tent(),
        "tent_skewed": Tent(0.125),
        "ramp": Ramp(),
        "ramp_down": Ramp(-2.0),
        "ramp_gentle": Ramp(0.7),
    }
)
