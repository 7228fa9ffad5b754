"""A move chosen at random among several, each step."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.batching import only_where
from mcmc1d.checks import require, require_instance
from mcmc1d.examples import Examples
from mcmc1d.moves.base import Move, Proposal, proposal_of
from mcmc1d.numerics import cumulative, is_concrete, locate, parameter, pick
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Real

T = TypeVar("T")


def shares(given: Any, kind: type[T], what: str) -> tuple[tuple[str, ...], tuple[T, ...], Float[Real, " n"]]:
    """Names, what they name, and probabilities, of name -> (probability, a `kind`).

    Raises `ValueError` unless the probabilities, where they are known, are not negative and sum to one. `what`: for
    messages, such as "Mixture: move".
    """
    who, _, one = what.partition(": ")
    require(isinstance(given, Mapping) and len(given) > 0, f"{who}: give {one}s by name, one at least")
    for name, pair in given.items():
        two = isinstance(pair, Sequence) and len(pair) == 2
        require(two, f"{who}: of {one} {name!r} give (probability, {one}), not {type(pair).__name__}")
    members = tuple(require_instance(member, kind, f"{what} {name!r}") for name, (_, member) in given.items())
    chances = [probability for probability, _ in given.values()]
    if not is_concrete(chances):
        return tuple(given), members, jnp.stack([jnp.asarray(p) for p in chances])
    p = np.array(chances)
    require(
        bool(np.all(p >= 0)) and abs(p.sum() - 1) < 1e-6,
        f"{who}: the {one}s' probabilities must not be negative, and sum to one; "
        f"{dict(zip(given, p.tolist(), strict=True))}",
    )
    return tuple(given), members, parameter(p)


class Mixture(Move):
    """One of several moves, each with a fixed probability: w[0] chooses, the rest is the chosen move's.

    The choice does not depend on the state, so w'[0] = w[0] and the mixture is an involution where the moves are.
    Every branch proposes (as a switch under `vmap` would), but for those that are `seldom` chosen; the target is
    evaluated once, at the chosen proposal.
    """

    moves: tuple[Move, ...]
    probabilities: Float[Real, " n"]
    names: tuple[str, ...] = eqx.field(static=True)
    seldom: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, moves: Mapping[str, tuple[ArrayLike, Move]], *, seldom: Sequence[str] = ()):
        """`moves`: name -> (probability, move); the probabilities sum to one.

        `seldom`: the names of moves that propose only in those chains of a batch that have chosen them: faster for a
        move that is chosen by one in ten or fewer and costs more than all others, slower else. The law is the same.
        """
        self.names, self.moves, self.probabilities = shares(moves, Move, "Mixture: move")
        self.seldom = tuple(seldom)
        unknown = set(self.seldom) - set(self.names)
        require(not unknown, f"Mixture: seldom names no move of it: {', '.join(sorted(unknown))}")

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.names

    def dim_w(self, target: Multiplexed) -> int:
        return 1 + max(move.dim_w(target) for move in self.moves)

    def check(self, target: Multiplexed) -> None:
        for move in self.moves:
            move.check(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        chosen = locate(cumulative([jnp.asarray(p) for p in self.probabilities]), w[0])
        points, rests, evals = [], [], []
        for k, move in enumerate(self.moves):
            r = move.dim_w(target)
            if self.names[k] in self.seldom:
                proposal = only_where(jnp.equal(chosen, k), partial(proposal_of, move), target, state, w[1 : 1 + r])
            else:
                proposal = proposal_of(move, target, state, w[1 : 1 + r])
            points.append((proposal.state.index, proposal.state.u, proposal.log_det))
            rests.append(jnp.concatenate([w[:1], proposal.w, w[1 + r :]]))
            evals.append(proposal.state.eval)
        index, u, log_det = pick(points, chosen)
        # Unless every move knows its own, one evaluation of the chosen state is cheaper than selecting among them.
        known = None if any(found is None for found in evals) else pick(evals, chosen)
        return Proposal(State(index, u, known), pick(rests, chosen), log_det, chosen)


def _examples() -> dict[str, Move]:
    from mcmc1d.moves.primary import LargeStep, SmallStep
    from mcmc1d.moves.reversible_jump import AimedJump
    from mcmc1d.moves.technique import StepAndChange

    return {
        "mixture": Mixture(
            {
                "large": (0.1, StepAndChange(LargeStep())),
                "small": (0.6, SmallStep(0.1)),
                "jump": (0.3, AimedJump()),
            }
        )
    }


EXAMPLES = Examples(_examples)
