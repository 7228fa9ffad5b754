"""Shapes of a local perturbation of u: a Gaussian cut to the unit interval, a uniform and a linear one around the ends.

Segovia et al. 2007, section 6.1. `SmallStep` is the Gaussian that goes around the ends.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.special import ndtr

from mcmc1d.checks import require_positive, require_step
from mcmc1d.examples import Examples
from mcmc1d.moves.base import EachAlone, Proposal, around_the_ends
from mcmc1d.numerics import parameter
from mcmc1d.state import Multiplexed, State
from mcmc1d.techniques import TruncatedNormal
from mcmc1d.types import Array, Float, Scalar


class TruncatedStep(EachAlone):
    """A Gaussian step of every coordinate, cut to the unit interval ("clamped"): q(u' given u) = N(u'; u, s^2) / Z(u).

    The normaliser Z(u) = Phi((1 - u) / s) - Phi(-u / s) depends on where the step starts, and so the log-determinant
    is log Z(u) - log Z(u'): q is not symmetric, and a chain that leaves this out samples f Z instead of f. The number
    is the quantile of u', and w' that of u in the density around u'.
    """

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        u = jax.vmap(lambda centre, place: self._around(centre).quantile(place))(state.u, w)
        back = jax.vmap(lambda centre, there: self._around(centre).cdf(there))(u, state.u)
        return Proposal(State(state.index, u), back, jnp.sum(self.log_normaliser(state.u) - self.log_normaliser(u)))

    def log_normaliser(self, u: Float[Array, "..."]) -> Float[Array, "..."]:
        """Log Z(u), the log of how much of the Gaussian around u lies in the unit interval."""
        return jnp.log(ndtr((1 - u) / self.sigma) - ndtr(-u / self.sigma))

    def _around(self, centre: Scalar) -> TruncatedNormal:
        return TruncatedNormal(centre, jnp.asarray(self.sigma, centre.dtype))


class UniformStep(EachAlone):
    """u' = wrap(u + width (w - 1/2)), w' = 1 - w: a uniform step, of standard deviation width / sqrt(12)."""

    width: Scalar = eqx.field(converter=parameter, default=0.2)

    def __check_init__(self):
        require_step(self, width=self.width)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        return around_the_ends(state, self.width * (w - 0.5), 1 - w)


class LinearStep(EachAlone):
    """A step whose density falls linearly from 0 to +-width / 2, around the ends; standard deviation width / sqrt(24).

    By the quantile of that tent, which is odd about w = 1/2; w' = 1 - w.
    """

    width: Scalar = eqx.field(converter=parameter, default=0.3)

    def __check_init__(self):
        require_step(self, width=self.width)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        up = w >= 0.5
        reach = 1 - jnp.sqrt(2 * jnp.where(up, 1 - w, w))
        return around_the_ends(state, 0.5 * self.width * jnp.where(up, reach, -reach), 1 - w)


EXAMPLES = Examples(
    lambda: {
        "truncated_step": TruncatedStep(),
        "truncated_step_wide": TruncatedStep(0.6),
        "uniform_step": UniformStep(),
        "linear_step": LinearStep(),
    }
)
