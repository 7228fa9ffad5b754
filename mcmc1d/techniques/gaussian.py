"""Two independent normal numbers at once: the Box-Muller transform, with its exact inverse."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_positive
from mcmc1d.examples import Examples
from mcmc1d.numerics import below_one, is_concrete, number, parameter
from mcmc1d.techniques.base import Forward, Inverse, Technique
from mcmc1d.types import Array, Corners, Float, Real, Scalar


class BoxMuller(Technique):
    """x = mean + sigma r (cos 2 pi u1, sin 2 pi u1), r = sqrt(-2 log(1 - u0)): neither coordinate is of either number.

    Box and Muller 1958; Bitterli et al. 2017, section 8.1, on schemes that yield two samples at once. The density is
    the normal one in the plane, with respect to dx; nothing is forgotten. The support is the whole plane: u0 in [0, 1)
    makes every radius up to 8.5 sigma in float64 and 5.8 in float32, where a number ends, and beyond it the inverse's
    u0 rounds to the largest under 1. (With log(u0), as it is often written, u0 = 0 makes an infinite x.)
    """

    mean: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    sigma: Scalar = eqx.field(converter=number, default=1.0)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)
        if is_concrete(self.mean):
            mean = np.asarray(self.mean)
            require(
                mean.shape == (2,) and bool(np.isfinite(mean).all()),
                f"BoxMuller: mean is a point of the plane, two finite numbers, not {mean}",
            )

    @property
    def dim_u(self) -> int:
        return 2

    @property
    def support(self) -> Corners:
        return np.full(2, -np.inf), np.full(2, np.inf)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        x = self.mean + self.sigma * _radius(u[0]) * _direction(u[1])
        return x, u[2:], -self.log_prob(x)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        z = (x - self.mean) / self.sigma
        u0 = -jnp.expm1(-jnp.sum(z * z) / 2)
        turns = jnp.arctan2(z[1], z[0]) / (2 * jnp.pi)
        u = jnp.stack([below_one(u0), below_one(jnp.where(turns < 0, turns + 1, turns))])
        return u, self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        z = (x - self.mean) / self.sigma
        return -jnp.sum(z * z) / 2 - jnp.log(2 * jnp.pi * self.sigma**2)


def _radius(u: Scalar) -> Scalar:
    return jnp.sqrt(-2 * jnp.log1p(-u))


def _direction(u: Scalar) -> Float[Array, " 2"]:
    return jnp.stack([jnp.cos(2 * jnp.pi * u), jnp.sin(2 * jnp.pi * u)])


EXAMPLES = Examples(lambda: {"box_muller": BoxMuller(), "box_muller_shifted": BoxMuller((0.2, -0.1), 0.3)})
