"""Wrong steps in primary sample space."""

import jax.numpy as jnp

from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.base import zero
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float
from mcmc1d.verify.mutants import Mutant


class ClampedStep(Move):
    """A Gaussian step clamped to the unit cube instead of wrapped: it piles up at the walls and can not come back."""

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        u = jnp.clip(state.u + 0.2 * normal_quantile(w), 0, 0.999)
        return Proposal(State(state.index, u), 1 - w, zero(u))


class LopsidedStep(Move):
    """A step whose size is that of the place it starts from, the Hastings ratio missing."""

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        u = state.u + (0.01 + 0.3 * state.u) * normal_quantile(w)
        return Proposal(State(state.index, u), 1 - w, zero(u))


class UntrackedNumber(Move):
    """A large step that mixes in a number which the way back does not know."""

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        return Proposal(State(state.index, jnp.roll(w, 1) ** 2), state.u, zero(w))


_TWICE = "applied twice, the identity on (index, u, w)"

_DETERMINANT = "log_det = log|det d(u', w')/d(u, w)| by autodiff"

MUTANTS = {
    "clamped_step": Mutant(
        ClampedStep(),
        "clamped instead of wrapped",
        "Segovia et al. 2007, section 6.1; pbrt 16.4 on wrapping",
        _DETERMINANT,
    ),
    "lopsided_step": Mutant(
        LopsidedStep(), "asymmetric proposal treated as symmetric", "blackjax and CES.jl: Barker proposals", _TWICE
    ),
    "untracked_number": Mutant(
        UntrackedNumber(), "a fresh number that the chain does not track", "bptmlt: the film position", _TWICE
    ),
}
