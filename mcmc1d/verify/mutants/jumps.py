"""Wrong reversible jumps: the determinant of a right one dropped, inverted or doubled."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.moves import Move, Proposal, ReversibleJump, SmallStep, TechniqueChange
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar
from mcmc1d.verify.mutants import Mutant


class WrongDeterminant(Move):
    """A right move whose log-determinant is altered; all else is the move's own."""

    move: Move
    alter: Callable[[Scalar], Scalar]

    def dim_w(self, target: Multiplexed) -> int:
        return self.move.dim_w(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        proposal = self.move.propose(target, state, w)
        return eqx.tree_at(lambda p: p.log_det, proposal, self.alter(proposal.log_det))


class Frozen(Move):
    """A right move that never fires: its selection test misses, and it proposes the current state."""

    move: Move

    def dim_w(self, target: Multiplexed) -> int:
        return self.move.dim_w(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        return Proposal(state, w, jnp.zeros((), state.u.dtype))


class StaleEval(Move):
    """A right jump that keeps the current state's evaluation after it has changed the technique."""

    move: Move

    def dim_w(self, target: Multiplexed) -> int:
        return self.move.dim_w(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        proposal = self.move.propose(target, state, w)
        return eqx.tree_at(lambda p: p.state.eval, proposal, state.eval, is_leaf=lambda leaf: leaf is None)


def no_jacobian(move: Move) -> WrongDeterminant:
    """Bitterli et al. 2017, figure 3b: the jump taken for a discrete transition without a determinant."""
    return WrongDeterminant(move, jnp.zeros_like)


def reciprocal_jacobian(move: Move) -> WrongDeterminant:
    """The determinant of the way back."""
    return WrongDeterminant(move, jnp.negative)


_LOPSIDED = [[0.2, 0.5, 0.3], [0.1, 0.1, 0.8], [0.6, 0.4, 0.0]]
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
        WrongDeterminant(TechniqueChange(_LOPSIDED), jnp.zeros_like),
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
    "stale_eval": Mutant(
        StaleEval(ReversibleJump()),
        "stale cache after a jump",
        "mlcg #70",
        "the proposal's eval = an evaluation of it",
    ),
}
