"""Reversible jumps: change the technique and keep the sample (Bitterli et al. 2017)."""

import jax.numpy as jnp
from numpy.typing import ArrayLike

from mcmc1d.examples import Examples
from mcmc1d.moves.base import Move, Proposal
from mcmc1d.moves.technique import LOPSIDED, Proposals
from mcmc1d.numerics import choose, cumulative, pick, unchoose
from mcmc1d.state import Eval, Multiplexed, State
from mcmc1d.types import Array, Float, Index, Scalar


class ReversibleJump(Move):
    """(i, u) -> (j, S_j^-1(x, w)) at the same x = S_i(u), with j from T_i and w' = v.

    The log-determinant is log p_j(x) - log p_i(x) + log T_ji / T_ij (eqs. 8-14 and 17-19), or what the techniques'
    own determinants say where those are not their densities; the acceptance ratio becomes w_j T_ji / (w_i T_ij).
    """

    proposals: Proposals

    def __init__(self, matrix: ArrayLike | None = None):
        """`matrix`: T, n x n, rows that sum to one; None proposes every technique alike, the current one too."""
        self.proposals = Proposals(matrix)

    def dim_w(self, target: Multiplexed) -> int:
        return 1 + target.dim_v

    def check(self, target: Multiplexed) -> None:
        self.proposals.check(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        j, back, log_t = self.proposals.draw(target, state.index, w[0])
        return _jump(target, state, j, back, log_t, w[1:])


class AimedJump(Move):
    """The reversible jump to technique j with probability w_j(x), its MIS weight: it is always accepted.

    Bitterli et al. 2017, section 4, "Discussion". The place inside the chosen weight's interval is kept, so the log-
    determinant is log w_i / w_j on top of the jump's, and cancels everything else in the acceptance ratio.
    """

    def dim_w(self, target: Multiplexed) -> int:
        return 1 + target.dim_v

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        log_weights = target.log_weights(state.seen.x, state.seen.log_p)
        ends = cumulative([jnp.exp(log_w) for log_w in log_weights])
        j, place = choose(ends, w[0])
        back = unchoose(ends, state.index, place)
        log_back, log_forth = pick(log_weights, state.index), pick(log_weights, j)
        log_t = jnp.where(log_back > -jnp.inf, log_back - log_forth, -jnp.inf)
        return _jump(target, state, j, back, log_t, w[1:])


def _jump(target: Multiplexed, state: State, j: Index, back: Scalar, log_t: Scalar, v: Float[Array, " k"]) -> Proposal:
    """The proposal of technique j for the state's x, at fresh v; nothing of f or p is evaluated again."""
    here = state.seen
    u, log_det = target.inverse(j, here.x, v)
    log_c = target.log_c(j, here.x, here.log_f, here.log_p)
    there = State(j, u, Eval(here.x, v, -log_det, here.log_f, here.log_p, log_c, here.kept))
    return Proposal(there, jnp.concatenate([back[None], here.v]), log_det + here.log_det + log_t)


EXAMPLES = Examples(
    lambda: {
        "reversible_jump": ReversibleJump(),
        "reversible_jump_lopsided": ReversibleJump(LOPSIDED),
        "aimed_jump": AimedJump(),
    }
)
