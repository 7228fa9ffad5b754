"""A move applied twice, as production code applies it, with the derivatives that its contract looks at.

In three programs, for compiling is nearly all of a contract's time: what an evaluation of the target finds, with its
derivatives, is compiled once for all moves; the way forth is differentiated by the chain rule through it; the way back
is not differentiated.
"""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from mcmc1d.compiling import quickly
from mcmc1d.metropolis import acceptance
from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.base import proposal_of
from mcmc1d.special import still
from mcmc1d.state import Eval, Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Int, Real, Scalar


class Outcome(eqx.Module):
    """Proposals from n points, the proposals from there, and the derivatives."""

    index: Int[Real, " n"]
    uw: Float[Real, "n d"]
    log_det: Float[Real, " n"]
    acceptance: Float[Real, " n"]
    index_back: Int[Real, " n"]
    uw_back: Float[Real, "n d"]
    log_det_back: Float[Real, " n"]
    jacobian: Float[Real, "n d d"]
    slope: Float[Real, "n d"]
    kept: Eval | None
    """What the move says of its proposal; None where it leaves the evaluation to the kernel."""
    found: Eval
    """What an evaluation finds there."""
    lit: Bool[Real, " n"]
    """Whether the target is positive where it began: a chain is nowhere else."""
    sensitivity: Float[Real, " n"]
    """The largest derivative with respect to u of what an evaluation finds, at either end."""
    felt: Float[Real, " n"]
    """The largest |x d log p_i / dx| of any technique, at either end."""


class End(eqx.Module):
    """What an evaluation finds at one end of a move, and how it changes."""

    found: Eval
    slopes: Eval
    """The derivatives with respect to u, along the last axis of each leaf."""
    felt: Scalar


def over(move: Move, target: Multiplexed, index: Int[Array, " n"], points: Float[Array, "n d"]) -> Outcome:
    """A move applied to many (index, u, w), and again to what comes out."""
    m = target.dim_u
    here = _ends(target, index, points[:, :m])
    first, jacobian, slope = _forth(move, target, index, points, here)
    there = _ends(target, jnp.asarray(first.state.index), first.state.u)
    second, a = _back(move, target, State(index, points[:, :m], here.found), first, there.found)
    slopes = jax.tree.leaves((here.slopes, there.slopes))
    steepest = [jnp.max(jnp.abs(leaf.reshape(len(points), -1)), axis=1, initial=0) for leaf in slopes]
    return Outcome(
        index=first.state.index,
        uw=_flat(first),
        log_det=first.log_det,
        acceptance=a,
        index_back=second.state.index,
        uw_back=_flat(second),
        log_det_back=second.log_det,
        jacobian=jacobian,
        slope=slope,
        kept=None if first.state.eval is None else _bare(first.state.eval),
        found=_bare(there.found),
        lit=here.found.log_c > -jnp.inf,
        sensitivity=jnp.max(jnp.stack(steepest), axis=0),
        felt=jnp.maximum(here.felt, there.felt),
    )


def _bare(found: Eval) -> Eval:
    """What is the same of every target: all but what this one keeps, which need not be numbers."""
    return dataclasses.replace(found, kept=())


@quickly
def _ends(target: Multiplexed, index: Int[Array, " n"], u: Float[Array, "n m"]) -> End:
    def evaluate(index: Array, u: Array) -> tuple[Eval, Eval]:
        seen = target.evaluate(State(index, u)).seen
        # In a hole a density's logarithm has no slope.
        return jax.tree.map(still, _bare(seen)), seen

    def log_p(x: Array) -> Array:
        return jnp.stack([still(log_p) for log_p in target.family.log_probs(x)])

    def one(index: Array, u: Array) -> End:
        slopes, found = jax.jacfwd(partial(evaluate, index), has_aux=True)(u)
        return End(found, slopes, jnp.max(jnp.abs(jax.jacfwd(log_p)(found.x) * found.x[None])))

    return jax.vmap(one)(index, u)


@quickly
def _forth(
    move: Move, target: Multiplexed, index: Int[Array, " n"], uw: Float[Array, "n d"], here: End
) -> tuple[Proposal, Float[Array, "n d d"], Float[Array, "n d"]]:
    """The proposals, d(u', w')/d(u, w) and d log_det/d(u, w)."""
    d, m = uw.shape[1], target.dim_u

    def one(index: Array, uw: Array, here: End) -> tuple[Proposal, Array, Array]:
        def apply(uw: Array, seen: Eval) -> tuple[tuple[Array, Array], Proposal]:
            known = dataclasses.replace(seen, kept=here.found.kept)
            proposal = _propose(move, target, State(index, uw[:m], known), uw[m:])
            return (_flat(proposal), proposal.log_det), proposal

        def along(direction: Array, tangent: Eval) -> tuple[Proposal, tuple[Array, Array]]:
            _, slopes, proposal = jax.jvp(apply, (uw, _bare(here.found)), (direction, tangent), has_aux=True)
            return proposal, slopes

        # An evaluation does not depend on w.
        tangents = jax.tree.map(lambda s: jnp.pad(s, [(0, 0)] * (s.ndim - 1) + [(0, d - m)]), here.slopes)
        each = jax.vmap(along, in_axes=(0, -1), out_axes=(None, -1))
        proposal, (jacobian, slope) = each(jnp.eye(d, dtype=uw.dtype), tangents)
        return proposal, jacobian, slope

    return jax.vmap(one)(index, uw, here)


@quickly
def _back(
    move: Move, target: Multiplexed, here: State, first: Proposal, found: Eval
) -> tuple[Proposal, Float[Array, " n"]]:
    """The proposals from the proposals, and the probability with which the first ones are accepted."""

    def one(here: State, first: Proposal, found: Eval) -> tuple[Proposal, Scalar]:
        # A move that knows its proposal's evaluation is taken at its word, as the kernel takes it.
        seen = found if first.state.eval is None else first.state.eval
        there = State(first.state.index, first.state.u, seen)
        a = acceptance(here, Proposal(there, first.w, first.log_det))
        return _propose(move, target, there, first.w), a

    return jax.vmap(one)(here, first, found)


def _propose(move: Move, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
    proposal = proposal_of(move, target, state, w)
    if proposal.w.shape != w.shape or proposal.state.u.shape != state.u.shape:
        raise ValueError(
            f"{type(move).__name__}.propose must return u' of shape {state.u.shape} and w' of shape {w.shape}, not "
            f"{proposal.state.u.shape} and {proposal.w.shape}"
        )
    index = jnp.asarray(proposal.state.index, jnp.int32)
    return Proposal(State(index, proposal.state.u, proposal.state.eval), proposal.w, jnp.asarray(proposal.log_det))


def _flat(proposal: Proposal) -> Float[Array, "... d"]:
    return jnp.concatenate([proposal.state.u, proposal.w], axis=-1)
