"""A move applied twice, as production code applies it, with the derivatives that its contract looks at."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from mcmc1d.metropolis import acceptance
from mcmc1d.moves import Move, Proposal
from mcmc1d.numerics import still
from mcmc1d.state import Eval, Multiplexed, State
from mcmc1d.types import Array, Float, Int, Real, Scalar
from mcmc1d.verify.compare import quickly


class Outcome(eqx.Module):
    """A proposal, the proposal from there, and the derivatives."""

    index: Int[Real, ""]
    uw: Float[Real, " d"]
    log_det: Scalar
    acceptance: Scalar
    index_back: Int[Real, ""]
    uw_back: Float[Real, " d"]
    log_det_back: Scalar
    jacobian: Float[Real, "d d"]
    slope: Float[Real, " d"]
    kept: Eval | None
    """What the move says of its proposal; None where it leaves the evaluation to the kernel."""
    found: Eval
    """What an evaluation finds there."""
    sensitivity: Scalar
    """The largest derivative with respect to u of what an evaluation finds, at either end."""
    felt: Scalar
    """The largest |x d log p_i / dx| of any technique, at either end."""


class Twice(eqx.Module):
    """A move applied to (index, u, w), and again to what comes out, as production code applies it."""

    move: Move
    target: Multiplexed

    def __call__(self, index: Int[Array, ""], uw: Float[Array, " d"]) -> Outcome:
        def apply(uw: Float[Array, " d"]) -> tuple[Any, Any]:
            here = _still(self.target.evaluate(State(index, uw[: self.target.dim_u])))
            first = self._propose(here, uw)
            known = State(jnp.asarray(first.state.index, jnp.int32), first.state.u, first.state.eval)
            there = self.target.evaluate(known)
            second = self._propose(there, _flat(first))
            found = self.target.evaluate(State(known.index, known.u)).seen
            a = acceptance(here, Proposal(there, first.w, first.log_det))
            differentiated = (_flat(first), jnp.asarray(first.log_det), here.seen)
            return differentiated, (*differentiated[:2], known, a, second, found, here.seen)

        (jacobian, slope, slopes), aux = jax.jacfwd(apply, has_aux=True)(uw)
        out, log_det, known, a, second, found, here = aux
        slopes = (slopes, jax.jacfwd(lambda u: _still(self.target.evaluate(State(known.index, u))).seen)(known.u))
        steepest = [jnp.max(jnp.abs(leaf), initial=0) for leaf in jax.tree.leaves(slopes)]
        return Outcome(
            index=known.index,
            uw=out,
            log_det=log_det,
            acceptance=a,
            index_back=jnp.asarray(second.state.index, jnp.int32),
            uw_back=_flat(second),
            log_det_back=jnp.asarray(second.log_det),
            jacobian=jacobian,
            slope=slope,
            kept=known.eval,
            found=found,
            sensitivity=jnp.max(jnp.stack(steepest)),
            felt=jnp.maximum(self._felt(here.x), self._felt(found.x)),
        )

    def _felt(self, x: Array) -> Scalar:
        def log_p(x: Array) -> Array:
            return jnp.stack([still(log_p) for log_p in self.target.family.log_probs(x)])

        return jnp.max(jnp.abs(jax.jacfwd(log_p)(x) * x[None]))

    def _propose(self, state: State, uw: Float[Array, " d"]) -> Proposal:
        proposal = self.move.propose(self.target, state, uw[self.target.dim_u :])
        if proposal.w.shape != (uw.shape[0] - self.target.dim_u,) or proposal.state.u.shape != state.u.shape:
            raise ValueError(
                f"{type(self.move).__name__}.propose must return u' of shape {state.u.shape} and w' of shape "
                f"{(uw.shape[0] - self.target.dim_u,)}, not {proposal.state.u.shape} and {proposal.w.shape}"
            )
        return proposal


def _still(state: State) -> State:
    """The state with an `eval` that does not move where it is -inf: in a hole a density's logarithm has no slope."""
    return State(state.index, state.u, jax.tree.map(still, state.seen))


def _flat(proposal: Proposal) -> Float[Array, " d"]:
    return jnp.concatenate([proposal.state.u, proposal.w])


@quickly
def over(twice: Twice, index: Int[Array, " n"], points: Float[Array, "n d"]) -> Outcome:
    """`twice` at many points."""
    return jax.vmap(twice)(index, points)
