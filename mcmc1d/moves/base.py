"""What a move is: an involution of the chain's state and of the uniform numbers that it consumes."""

import abc

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require, require_instance
from mcmc1d.numerics import in_unit_cube, wrap
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Scalar


class Proposal(eqx.Module):
    """Where a move leads: (s, w) -> (s', w') and log|d(s', w')/d(s, w)|.

    A move that has not evaluated s' leaves `state.eval` None; the evaluation then happens once, in the kernel.
    """

    state: State
    w: Float[Array, " r"]
    log_det: Scalar
    kind: Index = 0
    """Which move of a mixture this was; acceptance rates are kept by it."""

    @property
    def inside(self) -> Bool[Array, ""]:
        """Whether s' and w' are any state and numbers at all: in the unit cube, and of one of the techniques.

        Of a proposal whose state has been evaluated.
        """
        index = self.state.index
        known = (index >= 0) & (index < len(self.state.seen.log_p))
        return known & in_unit_cube(self.state.u) & in_unit_cube(self.w)


class Move(eqx.Module):
    """An involution (s, w) <-> (s', w') with w in [0, 1)^r: applied twice it is the identity.

    Accepted with min(1, pi(s') / pi(s) |d(s', w') / d(s, w)|) it leaves pi invariant (Tierney 1998; Neklyudov et al.
    2020). `w'` is what would undo the move; a proposal with any of s', w' outside the unit cube is rejected.

    Everything is written for one chain; callers `vmap`. A subclass is final: it defines `dim_w` and `propose`, and is
    held to them by `verify.check_move`.
    """

    @abc.abstractmethod
    def dim_w(self, target: Multiplexed) -> int:
        """r, how many uniform numbers the move consumes."""

    @abc.abstractmethod
    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        """The proposal from an evaluated state with the numbers w."""

    def check(self, target: Multiplexed) -> None:
        """Raise `ValueError` where the move does not fit the target; every move fits unless redefined."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The names that `Proposal.kind` counts through."""
        return (type(self).__name__,)


def proposal_of(move: Move, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
    """What the move proposes; `ValueError` where that is no proposal."""
    proposal, who = move.propose(target, state, w), f"{type(move).__name__}.propose"
    require_instance(proposal, Proposal, f"{who}: what it returns", ": the state, w, log_det and kind")
    u, own = jnp.shape(proposal.state.u), jnp.shape(state.u)
    require(u == own, f"{who}: it proposes u of shape {u}, and a state's is {own}; give one size, or one for each")
    shape = jnp.shape(proposal.log_det)
    require(shape == (), f"{who}: log_det must be one number for one state, not of shape {shape}")
    return proposal


class EachNumber(Move):
    """A move that consumes one uniform number for each coordinate of u."""

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u


class EachAlone(EachNumber):
    """One that moves each coordinate by its own number, whatever the others, the technique and the target are."""


def around_the_ends(state: State, step: Float[Array, " m"], w: Float[Array, " m"]) -> Proposal:
    """The proposal of wrap(u + step), around the ends, with the numbers `w` of the step back: log-determinant 0."""
    u = wrap(state.u + step)
    return Proposal(State(state.index, u), w, zero(u))


def zero(u: Float[Array, " m"]) -> Scalar:
    """A log-determinant of 0 in the precision of u."""
    return jnp.zeros((), u.dtype)
