"""Moves in the primary sample space of the current technique: small steps and large steps, log-determinant 0."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.moves.base import Move, Proposal, zero
from mcmc1d.numerics import is_concrete, normal_quantile, parameter, require, require_positive, wrap
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar


class SmallStep(Move):
    """u' = wrap(u + sigma Phi^-1(w)), w' = 1 - w: a Gaussian step of every coordinate, around the ends."""

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        u = wrap(state.u + self.sigma * normal_quantile(w))
        return Proposal(State(state.index, u), 1 - w, zero(u))


class ExponentialStep(Move):
    """Kelemen et al. 2002: u' = wrap(u +- s2 (s1 / s2)^r), a step log-uniform in [s1, s2].

    Every order of magnitude between the two is as likely as another, not every size.

    The first half of each w means up, the second down, with r the place inside the half; w' is the same place in the
    other half.
    """

    smallest: Scalar = eqx.field(converter=parameter, default=1 / 1024)
    largest: Scalar = eqx.field(converter=parameter, default=1 / 64)

    def __check_init__(self):
        require_positive(self, smallest=self.smallest, largest=self.largest)
        if is_concrete(self.smallest, self.largest):
            require(
                bool(np.all(np.asarray(self.smallest) < self.largest)),
                f"ExponentialStep: smallest must be under largest, not {self.smallest} and {self.largest}",
            )

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        up = w < 0.5
        place = jnp.where(up, 2 * w, 2 * w - 1)
        step = self.largest * jnp.exp(place * jnp.log(self.smallest / self.largest))
        u = wrap(state.u + jnp.where(up, step, -step))
        return Proposal(State(state.index, u), jnp.where(up, w + 0.5, w - 0.5), zero(u))


class LargeStep(Move):
    """Swap u and w: fresh primary samples for the current technique."""

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        return Proposal(State(state.index, w), state.u, zero(w))


EXAMPLES = {
    "small_step": SmallStep(),
    "small_step_wide": SmallStep(0.7),
    "exponential_step": ExponentialStep(),
    "large_step": LargeStep(),
}
