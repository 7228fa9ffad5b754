"""Moves in the primary sample space of the current technique: small steps and large steps, log-determinant 0."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_step
from mcmc1d.examples import Examples
from mcmc1d.moves.base import EachAlone, Proposal, around_the_ends, zero
from mcmc1d.numerics import is_concrete, parameter
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar


class SmallStep(EachAlone):
    """u' = wrap(u + sigma Phi^-1(w)), w' = 1 - w: a Gaussian step of every coordinate, around the ends."""

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)

    def __check_init__(self):
        require_step(self, sigma=self.sigma)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        return around_the_ends(state, self.sigma * normal_quantile(w), 1 - w)


class ExponentialStep(EachAlone):
    """Kelemen et al. 2002: u' = wrap(u +- s2 (s1 / s2)^r), a step log-uniform in [s1, s2].

    Every order of magnitude between the two is as likely as another, not every size.

    The first half of each w means up, the second down, with r the place inside the half; w' is the same place in the
    other half.
    """

    smallest: Scalar = eqx.field(converter=parameter, default=1 / 1024)
    largest: Scalar = eqx.field(converter=parameter, default=1 / 64)

    def __check_init__(self):
        require_step(self, smallest=self.smallest, largest=self.largest)
        if is_concrete(self.smallest, self.largest):
            require(
                bool(np.all(np.asarray(self.smallest) < self.largest)),
                f"ExponentialStep: smallest must be under largest, not {self.smallest} and {self.largest}",
            )

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        up = w < 0.5
        place = jnp.where(up, 2 * w, 2 * w - 1)
        step = self.largest * jnp.exp(place * jnp.log(self.smallest / self.largest))
        return around_the_ends(state, jnp.where(up, step, -step), jnp.where(up, w + 0.5, w - 0.5))


class LargeStep(EachAlone):
    """Swap u and w: fresh primary samples for the current technique."""

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        return Proposal(State(state.index, w), state.u, zero(w))


EXAMPLES = Examples(
    lambda: {
        "small_step": SmallStep(),
        "small_step_wide": SmallStep(0.7),
        "exponential_step": ExponentialStep(),
        "large_step": LargeStep(),
    }
)
