"""The raised sinusoid: a density whose distribution function inverts through Kepler's equation."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient

from mcmc1d.checks import require
from mcmc1d.compiling import inlined
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, limit, number
from mcmc1d.special import sin_turns
from mcmc1d.techniques.base import Inversion, density_within, within
from mcmc1d.types import Scalar


class RaisedSinusoid(Inversion):
    """The density 1 + amplitude sin(2 pi (frequency x + phase)) on [0, 1], the phase in turns.

    `amplitude` lies in [-1, 1] and `frequency` is a whole number of periods. Measured from a minimum of the density,
    P(x) - u = 0 is Kepler's equation M = E - e sin E with eccentricity e = |amplitude|: a solver for it is right to a
    few ulps of 1 everywhere, the places included where the density vanishes (e = 1) and P is flat; in float32 to the
    error of its sine, 1.5e-7 e / frequency, which is up to 42 ulps of a small u. The quantile is differentiable in u
    and in the parameters by the implicit function theorem.
    """

    amplitude: Scalar = eqx.field(converter=number, default=0.9)
    frequency: int = eqx.field(static=True, default=1)
    phase: Scalar = eqx.field(converter=number, default=0.0)

    def __check_init__(self):
        require(
            isinstance(self.frequency, int) and self.frequency >= 1,
            f"RaisedSinusoid: frequency must be a whole number of periods, 1 at least, not {self.frequency!r}",
        )
        if is_concrete(self.amplitude):
            require(
                bool(np.abs(self.amplitude) <= 1),
                f"RaisedSinusoid: amplitude must lie in [-1, 1], or the density turns negative: {self.amplitude}",
            )

    def _from_minimum(self) -> tuple[Scalar, Scalar]:
        """The eccentricity, and the place of x = 0 in turns after a minimum of the density."""
        amplitude = jnp.asarray(self.amplitude)
        phase = jnp.asarray(self.phase) + jnp.where(amplitude < 0, 0.5, 0.0).astype(amplitude.dtype)
        start = phase - 0.75
        return jnp.abs(amplitude), start - jnp.round(start)

    def quantile(self, u: Scalar) -> Scalar:
        u = jnp.asarray(u)
        n = self.frequency
        e, start = self._from_minimum()
        mean = n * u + _mean_anomaly(e, start)
        period = jnp.round(mean)
        y = stop_gradient(_solve_kepler(e, mean - period))
        x = limit(stop_gradient((period + y - start) / n), 0, 1)
        p = jnp.maximum(stop_gradient(self._density(x)), jnp.finfo(x.dtype).tiny)
        residual = self.cdf(x) - u
        # One Newton step carries the derivatives. Its value mends the last ulps next to x = 0, where x is a
        # difference; next to a minimum the residual is rounding alone and would be blown up, so only its derivatives
        # are kept.
        mend = (jnp.abs(y) > 0.125) | (p > 4 * n * x)
        return limit(x - jnp.where(mend, residual, residual - stop_gradient(residual)) / p, 0, 1)

    def cdf(self, x: Scalar) -> Scalar:
        x = jnp.asarray(x)
        n = self.frequency
        e, start = self._from_minimum()
        y = start + n * x
        period = jnp.round(y)
        here, there = _mean_anomaly(e, y - period), _mean_anomaly(e, start)
        # Two forms of one number, each for where the other cancels: counted from a minimum of the density, and the
        # difference of two cosines as a product, whose rounding error is proportional to x.
        from_minimum = (period + here - there) / n
        from_zero = x + e / (jnp.pi * n) * sin_turns(start + 0.75 + n * x / 2) * sin_turns(n * x / 2)
        rounding = jnp.abs(period) + jnp.abs(here) + jnp.abs(there)
        return jnp.where((jnp.abs(y - period) <= 0.125) & (rounding <= 4 * n * x), from_minimum, from_zero)

    def log_prob(self, x: Scalar) -> Scalar:
        return within(x, jnp.log(self._density(x)))

    def prob(self, x: Scalar) -> Scalar:
        return density_within(x, self._density(x))

    def _density(self, x: Scalar) -> Scalar:
        e, start = self._from_minimum()
        half = sin_turns((start + self.frequency * x) / 2)
        # 1 - e cos = (1 - e) + 2 e sin^2(half): no cancellation where the density vanishes.
        return (1 - e) + 2 * e * half * half


@inlined
def _mean_anomaly(e: Scalar, y: Scalar) -> Scalar:
    """(E - e sin E) / 2 pi at E = 2 pi y, exact to a few ulps for e = 1 and y -> 0 as well; |y| <= 1/2."""
    angle = 2 * jnp.pi * y
    z = angle * angle
    # E - sin E = E^3/6 (1 - E^2/20 (1 - E^2/42 (...))), the next term under 1e-17 for |E| <= 1.
    series = jnp.ones_like(y)
    for k in range(8, 1, -1):
        series = 1 - z / ((2 * k) * (2 * k + 1)) * series
    excess = jnp.where(jnp.abs(angle) < 1, angle * z / 6 * series, angle - sin_turns(y))
    return (1 - e) * y + e * excess / (2 * jnp.pi)


@inlined
def _solve_kepler(e: Scalar, mean: Scalar) -> Scalar:
    """The y in [-1/2, 1/2] with `_mean_anomaly(e, y) == mean`.

    The start is Markley's (1995, "Kepler equation solver", eqs. 15-20), right to a few times 1e-4 for every e in
    [0, 1]; steps of Halley's method with a residual that does not cancel, three in float64 and one in
    float32, make it exact.
    """
    m = 2 * jnp.pi * jnp.abs(mean)
    pi2 = jnp.pi**2
    alpha = (3 * pi2 + 1.6 * jnp.pi * (jnp.pi - m) / (1 + e)) / (pi2 - 6)
    d = 3 * (1 - e) + alpha * e
    q = 2 * alpha * d * (1 - e) - m * m
    r = 3 * alpha * d * (d - 1 + e) * m + m * m * m
    cube = r + jnp.sqrt(jnp.maximum(q * q * q + r * r, 0))
    cube = jnp.where(cube > 0, cube, 1)  # only for a mean of 0, where r is 0 as well
    w = jnp.exp(jnp.log(cube) * (2 / 3))  # for a starting value as good as a cube root, which does not vectorise
    y = jnp.clip((2 * r / (w + q + q * q / w) + m) / d / (2 * jnp.pi), 0, 0.5)
    target = jnp.abs(mean)
    for _ in range(3 if y.dtype == jnp.float64 else 1):
        half = sin_turns(y / 2)
        slope = (1 - e) + 2 * e * half * half
        curvature = 2 * jnp.pi * e * sin_turns(y)
        newton = (_mean_anomaly(e, y) - target) / jnp.where(slope > 0, slope, 1)
        halley = newton / (1 - newton * curvature / (2 * jnp.where(slope > 0, slope, 1)))
        y = jnp.clip(y - jnp.where(slope > 0, halley, 0), 0, 0.5)
    return jnp.where(mean < 0, -y, y)


EXAMPLES = Examples(
    lambda: {
        "raised_sinusoid": RaisedSinusoid(),
        "raised_sinusoid_two_periods": RaisedSinusoid(0.9, 2, 0.3),
        "raised_sinusoid_flat_inside": RaisedSinusoid(1.0, 1, 0.0),
        "raised_sinusoid_flat_at_zero": RaisedSinusoid(-1.0, 3, 0.25),
    }
)
