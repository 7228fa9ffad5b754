"""The normal density cut to the unit interval."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri

from mcmc1d.checks import require, require_positive
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, limit, number
from mcmc1d.techniques.base import Inversion, within
from mcmc1d.types import Scalar


class TruncatedNormal(Inversion):
    """The normal density of a mean (anywhere) and a standard deviation sigma, cut to [0, 1] and rescaled.

    Probabilities are counted from the side where they are small, so an interval far out in one tail keeps its
    accuracy. Where sigma is large against the interval, the rounding error in u grows as sigma.
    """

    mean: Scalar = eqx.field(converter=number)
    sigma: Scalar = eqx.field(converter=number)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)
        if is_concrete(self.mean, self.sigma):
            away = float(np.maximum(np.maximum(-np.asarray(self.mean), np.asarray(self.mean) - 1), 0) / self.sigma)
            require(
                away < 12,
                f"TruncatedNormal: the mean {self.mean} lies {away:.3g} sigma outside [0, 1]; keep it within 12, "
                "where float32 still holds its mass",
            )

    def _limits(self) -> tuple[Scalar, Scalar, Scalar]:
        """The sign that turns the interval into the lower tail, and the normal probabilities of both ends there."""
        mean, sigma = jnp.asarray(self.mean), jnp.asarray(self.sigma)
        sign = jnp.where(mean < 0, -1, 1).astype(sigma.dtype)
        return sign, ndtr(sign * -mean / sigma), ndtr(sign * (1 - mean) / sigma)

    def quantile(self, u: Scalar) -> Scalar:
        sign, at_zero, at_one = self._limits()
        z = sign * ndtri(at_zero + u * (at_one - at_zero))
        return limit(self.mean + self.sigma * z, 0, 1)

    def cdf(self, x: Scalar) -> Scalar:
        sign, at_zero, at_one = self._limits()
        return (ndtr(sign * (x - self.mean) / self.sigma) - at_zero) / (at_one - at_zero)

    def log_prob(self, x: Scalar) -> Scalar:
        _, at_zero, at_one = self._limits()
        z = (x - self.mean) / self.sigma
        log_scale = jnp.log(self.sigma * jnp.sqrt(2 * jnp.pi) * jnp.abs(at_one - at_zero))
        return within(x, -z * z / 2 - log_scale)


EXAMPLES = Examples(
    lambda: {
        "truncated_normal": TruncatedNormal(0.3, 0.2),
        "truncated_normal_tail_below": TruncatedNormal(-0.4, 0.1),
        "truncated_normal_tail_above": TruncatedNormal(1.2, 0.1),
        "truncated_normal_wide": TruncatedNormal(0.5, 3.0),
    }
)
