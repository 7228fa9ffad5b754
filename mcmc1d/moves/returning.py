"""A move whose inverse is only numerical: what does not come back is rejected."""

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require_instance, require_positive
from mcmc1d.examples import Examples
from mcmc1d.moves.base import Move, Proposal, proposal_of
from mcmc1d.moves.reversible_jump import ReversibleJump
from mcmc1d.numerics import in_unit_cube, parameter
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Scalar


class Returning(Move):
    """A move applied twice: a proposal that does not lead back to (s, w) is rejected (log-determinant -inf).

    An involution wherever it is kept, whatever the inverse does elsewhere. To reject only what can not be inverted on
    the way forth, as Bitterli et al. 2017 do (section 6, "Final algorithm"), is right where no technique makes a sample
    that it can not invert, and is not otherwise: the way back would still be taken. Costs a second evaluation.
    """

    move: Move
    tolerance: Scalar = eqx.field(converter=parameter, default=1e-3)
    """The largest distance in a number of u or w, around the ends, that counts as come back."""

    def __check_init__(self):
        require_instance(self.move, Move, "Returning: the move")
        require_positive(self, tolerance=self.tolerance)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.move.kinds

    def dim_w(self, target: Multiplexed) -> int:
        return self.move.dim_w(target)

    def check(self, target: Multiplexed) -> None:
        self.move.check(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        proposal = proposal_of(self.move, target, state, w)
        there = target.evaluate(proposal.state)
        back = self.move.propose(target, there, proposal.w)
        same = jnp.asarray(back.state.index == state.index) & self._near(back.state.u, state.u) & self._near(back.w, w)
        same &= back.log_det > -jnp.inf  # a way back that is never taken is none, wherever it would lead; nor is NaN
        return Proposal(there, proposal.w, jnp.where(same, proposal.log_det, -jnp.inf), proposal.kind)

    def _near(self, a: Float[Array, " n"], b: Float[Array, " n"]) -> Bool[Array, ""]:
        apart = jnp.abs(a - b)
        # Around the ends of the unit interval, and in it alone: neither NaN nor what lies far outside is near.
        return in_unit_cube(a) & jnp.all(jnp.minimum(apart, 1 - apart) <= self.tolerance)


EXAMPLES = Examples(lambda: {"returning_jump": Returning(ReversibleJump())})
