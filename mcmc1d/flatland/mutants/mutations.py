"""Mistakes of mutations of paths: a proposal's density left out of the acceptance ratio."""

import jax.numpy as jnp

from mcmc1d.moves import Move, Proposal
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Float, Real, Scalar


class TakenForSymmetric(Move):
    """A mutation that is accepted with f(y) / f(x), as if it went from x to y as often as back.

    `share`: of the mistake in the logarithm, 0 is right. Only for moves that know their proposal's evaluation.
    """

    right: Move
    share: Scalar

    def dim_w(self, target: Multiplexed) -> int:
        return self.right.dim_w(target)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.right.kinds

    def propose(self, target: Multiplexed, state: State, w: Float[Real, " r"]) -> Proposal:
        right = self.right.propose(target, state, w)
        here, there = state.seen, right.state.seen
        symmetric = (there.log_f - here.log_f) - (there.log_c - here.log_c)
        # Nothing is wrong where a path is dark, or the mutation impossible.
        mixed = jnp.where(jnp.isfinite(symmetric), right.log_det + self.share * (symmetric - right.log_det), 0)
        log_det = jnp.where(jnp.isfinite(right.log_det) & jnp.isfinite(symmetric), mixed, right.log_det)
        return Proposal(right.state, right.w, log_det, right.kind)


__all__ = ["TakenForSymmetric"]
