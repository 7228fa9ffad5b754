"""Wrong reversible jumps: the determinant of a right one dropped, inverted or doubled."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.moves import AimedJump, Move, Proposal, ReversibleJump, SmallStep, TechniqueChange
from mcmc1d.moves.technique import LOPSIDED
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar
from mcmc1d.verify.mutants import Mutant
from mcmc1d.verify.mutants.base import WrongMove


class WrongDeterminant(WrongMove):
    """A right move whose log-determinant is altered; all else is the move's own."""

    right: Move
    alter: Callable[[Scalar], Scalar]

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        proposal = self.right.propose(target, state, w)
        return eqx.tree_at(lambda p: p.log_det, proposal, self.alter(proposal.log_det))


class Frozen(WrongMove):
    """A right move that never fires: its selection test misses, and it proposes the current state."""

    right: Move

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        return Proposal(state, w, jnp.zeros((), state.u.dtype))


class StaleEval(WrongMove):
    """A right jump that keeps the current state's evaluation after it has changed the technique."""

    right: Move

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        proposal = self.right.propose(target, state, w)
        return eqx.tree_at(lambda p: p.state.eval, proposal, state.eval, is_leaf=lambda leaf: leaf is None)


def no_jacobian(move: Move) -> WrongDeterminant:
    """Bitterli et al. 2017, figure 3b: the jump taken for a discrete transition without a determinant."""
    return WrongDeterminant(move, jnp.zeros_like)


def reciprocal_jacobian(move: Move) -> WrongDeterminant:
    """The determinant of the way back."""
    return WrongDeterminant(move, jnp.negative)


class WrongBesideAHole(WrongMove):
    """A right jump whose log-determinant is off at an x that one of the techniques can not make."""

    right: Move

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        proposal = self.right.propose(target, state, w)
        beside = jnp.any(jnp.isneginf(jnp.stack(state.seen.log_p)))
        return eqx.tree_at(lambda p: p.log_det, proposal, proposal.log_det + 0.1 * beside)


class IndexOffByOne(WrongMove):
    """A uniform change of the technique whose way back leads to the technique after the one it came from."""

    right: TechniqueChange

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        proposal = self.right.propose(target, state, w)
        return eqx.tree_at(lambda p: p.w, proposal, (proposal.w + 1 / target.n_techniques) % 1)


_DETERMINANT = "log_det = log|det d(u', w')/d(u, w)| by autodiff"

MUTANTS = {
    "no_jacobian": Mutant(
        no_jacobian(ReversibleJump()),
        "Jacobian dropped",
        "Bitterli et al. 2017, figure 3b",
        _DETERMINANT,
    ),
    "reciprocal_jacobian": Mutant(
        reciprocal_jacobian(ReversibleJump()),
        "reciprocal of the Jacobian",
        "Fermat: both stand in the source",
        _DETERMINANT,
    ),
    # Not on the aimed jump: under the balance heuristic its log-determinant is 0 everywhere, and so is half of it.
    "half_jacobian": Mutant(
        WrongDeterminant(ReversibleJump(), lambda log_det: 0.5 * log_det),
        "half of the correction",
        "tensorflow/probability 17af734f8: a correction off by a factor",
        _DETERMINANT,
    ),
    "proposal_matrix_taken_for_symmetric": Mutant(
        WrongDeterminant(TechniqueChange(LOPSIDED), jnp.zeros_like),
        "asymmetric proposal treated as symmetric",
        "CES.jl #447",
        _DETERMINANT,
    ),
    "move_that_never_fires": Mutant(
        Frozen(SmallStep()),
        "a move that never fires",
        "Tungsten 5ea3909",
        "it proposes other states, and some are accepted",
    ),
    "index_off_by_one": Mutant(
        IndexOffByOne(TechniqueChange()),
        "index off by one on the way back",
        "ours: a counter that starts at 1 on one of the two ways",
        "applied twice, the identity on (index, u, w)",
    ),
    "wrong_beside_a_hole": Mutant(
        WrongBesideAHole(AimedJump()),
        "a determinant that is wrong only where one of the techniques has no density",
        "ours: what a contract misses that leaves out points with a density of zero",
        _DETERMINANT,
    ),
    "stale_eval": Mutant(
        StaleEval(ReversibleJump()),
        "stale cache after a jump",
        "mlcg #70",
        "the proposal's eval = an evaluation of it",
    ),
}
