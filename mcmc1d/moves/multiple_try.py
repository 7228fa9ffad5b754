"""Multiple-try: several candidates, one of them selected, competitors for the way back (Liu, Liang, Wong 2000)."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.compiling import quickly
from mcmc1d.examples import Examples
from mcmc1d.moves.base import Move, Proposal, proposal_of
from mcmc1d.moves.candidates import Antithetic, Candidates, Independent, Rotated, Stratified
from mcmc1d.moves.primary import ExponentialStep, SmallStep
from mcmc1d.numerics import choose, ends_of, select, unchoose
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Scalar

LogWeight = Callable[[State, State, Scalar], Scalar]
"""(x, y, log q(x given y) - log q(y given x)) -> log w(x, y), maybe -inf; both states are evaluated."""


def by_target(x: State, y: State, log_ratio: Scalar) -> Scalar:
    """w(x, y) = pi(y): lambda = 1 / q(x given y), symmetric where q is."""
    return y.seen.log_c


def by_importance(x: State, y: State, log_ratio: Scalar) -> Scalar:
    """w(x, y) = pi(y) sqrt(q(x given y) / q(y given x)): lambda = 1 / sqrt(q q), which is symmetric."""
    return y.seen.log_c + 0.5 * log_ratio


def evenly(x: State, y: State, log_ratio: Scalar) -> Scalar:
    """w(x, y) = 1: any of the candidates; no symmetric lambda makes it."""
    return jnp.zeros_like(y.seen.log_c)


class SymmetricLambda(eqx.Module):
    """w(x, y) = pi(y) q(x given y) lambda(x, y), with lambda = h(x, y) / sqrt(q(x given y) q(y given x)).

    `log_h(x, y)` is any symmetric function of two states: 0 makes the lambda of `by_importance`, log q(y given x) of a
    symmetric step lambda = 1, and minus that lambda = 1 / q^2.
    """

    log_h: Callable[[State, State], Scalar] = eqx.field(static=True)

    def __call__(self, x: State, y: State, log_ratio: Scalar) -> Scalar:
        return y.seen.log_c + 0.5 * log_ratio + self.log_h(x, y)


class Packet(NamedTuple):
    """All that a multiple-try proposal looked at: two families of p states each, with a leading axis."""

    candidates: State
    """Around the current state x."""
    competitors: State
    """Around the chosen y; the current state is among them."""
    log_forth: Float[Array, " p"]
    """log w(x, y_k); -inf for a candidate outside the unit cube."""
    log_back: Float[Array, " p"]
    """log w(y, x_k)."""


class MultipleTry(Move):
    """p candidates by a `step`, one of them selected by its weight, and p - 1 competitors around that one.

    As an involution: the two families are swapped, and the selector keeps its place inside the chosen interval. The
    determinant is the step's times the ratio of the two intervals, so that any weights at all are right (Pandolfi,
    Bartolucci, Friel 2010). For w(x, y) = pi(y) q(x given y) lambda(x, y) with a symmetric lambda the acceptance ratio
    is the papers' R_g = sum w(x, y_k) / sum w(y, x_k) (Liu, Liang, Wong 2000; Segovia et al. 2007, section 5.1);
    `ratio="R_g"` uses that formula itself.

    The step is any move; `candidates` says how its numbers are drawn together. States: x, y evaluated p times each.
    Where the target is NaN at any of them, the proposal is that state, which traps the chain for the runner to find.
    """

    step: Move
    tries: int = eqx.field(static=True)
    log_weight: LogWeight
    candidates: Candidates
    ratio: str = eqx.field(static=True)

    def __init__(
        self,
        step: Move,
        tries: int = 4,
        log_weight: LogWeight = by_importance,
        candidates: Candidates | None = None,
        ratio: str = "intervals",
    ):
        """`tries`: p, one at least; `log_weight`: any function, see `LogWeight`; `candidates`: independent, if None."""
        require_instance(step, Move, "MultipleTry: the step")
        require_whole(tries, "MultipleTry: tries")
        require(ratio in ("intervals", "R_g"), f'MultipleTry: ratio must be "intervals" or "R_g", not {ratio!r}')
        self.step, self.tries, self.log_weight, self.ratio = step, tries, log_weight, ratio
        self.candidates = require_instance(
            Independent() if candidates is None else candidates, Candidates, "MultipleTry: the candidates"
        )
        self.candidates.check(tries)

    def dim_w(self, target: Multiplexed) -> int:
        return self.candidates.dim(self.tries, self.step.dim_w(target)) + 1

    def check(self, target: Multiplexed) -> None:
        self.step.check(target)
        if self.ratio == "R_g":
            _require_symmetric(self, target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        return self.propose_packet(target, state, w)[0]

    def propose_packet(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> tuple[Proposal, Packet]:
        """The proposal, and all that was looked at on the way."""
        p, r = self.tries, self.step.dim_w(target)
        forth = around(self.step, target, state, self.candidates.forth(p, r, w[:-1]))
        log_forth = self._log_weights(state, forth)
        k, place = choose(_ends(log_forth), w[-1])
        y: Proposal = row(forth, k)
        reverse = self.candidates.back(p, r, w[:-1], k, y.w)
        back = around(self.step, target, y.state, reverse.family)
        # Where the way back leads, the current state itself: what came round again would only have been rounded.
        here = Proposal(state, row(forth, k).w, -y.log_det, y.kind)
        back = jax.tree.map(lambda new, own: new.at[reverse.place].set(own), back, here)
        log_back = self._log_weights(y.state, back)
        log_sums = jax.nn.logsumexp(log_forth) - jax.nn.logsumexp(log_back)
        if self.ratio == "R_g":
            log_det = log_sums - y.state.seen.log_c + state.seen.log_c
        else:
            log_det = y.log_det + log_back[reverse.place] - log_forth[k] + log_sums
        # A dark state accepts any lit one, as everywhere.
        dark = ~(state.seen.log_c > -jnp.inf)
        log_det = jnp.where(dark, 0, log_det)
        possible = (log_forth[k] > -jnp.inf) & (dark | (log_back[reverse.place] > -jnp.inf))
        w_back = jnp.concatenate([reverse.w, unchoose(_ends(log_back), reverse.place, place)[None]])
        proposal = Proposal(y.state, w_back, jnp.where(possible, log_det, -jnp.inf))
        lost, trap = _undefined(y.state, forth.state, back.state)
        proposal = select(lost, Proposal(trap, w, jnp.zeros_like(log_det)), proposal)
        return proposal, Packet(forth.state, back.state, log_forth, log_back)

    def _log_weights(self, x: State, family: Proposal) -> Float[Array, " p"]:
        return jax.vmap(lambda y: jnp.where(possible(y), self.log_weight(x, y.state, y.log_det), -jnp.inf))(family)


def around(step: Move, target: Multiplexed, state: State, numbers: Float[Array, "p r"]) -> Proposal:
    """The step's proposals from one state by p vectors of numbers, evaluated, with a leading axis."""

    def one(w: Float[Array, " r"]) -> Proposal:
        proposal = proposal_of(step, target, state, w)
        kind = jnp.asarray(proposal.kind, jnp.int32)
        return Proposal(target.evaluate(proposal.state), proposal.w, proposal.log_det, kind)

    return jax.vmap(one)(numbers)


def possible(proposal: Proposal) -> Array:
    """Whether an evaluated proposal is a state, and in the support."""
    return proposal.inside & (proposal.state.seen.log_c > -jnp.inf) & ~jnp.isnan(proposal.log_det)


def _undefined(like: State, *families: State) -> tuple[Bool[Array, ""], State]:
    """Whether the target is NaN at any state of the families, and the first such one: all of it that will be read."""
    lost = jnp.isposinf(jnp.concatenate([family.seen.log_c for family in families]))
    index, u = (jnp.concatenate([getattr(family, part) for family in families]) for part in ("index", "u"))
    k = jnp.argmax(lost)
    seen = eqx.tree_at(lambda s: s.log_c, like.seen, jnp.full_like(like.seen.log_c, jnp.inf))
    return lost.any(), State(index[k], u[k], seen)


def row(tree: Any, k: Index) -> Any:
    """Entry k of every leaf's leading axis."""
    return jax.tree.map(lambda leaf: leaf[k], tree)


def _ends(log_weights: Float[Array, " p"]) -> Float[Array, " p+1"]:
    """The ends of intervals in proportion to the weights; equal ones where all are zero."""
    largest = jnp.max(log_weights)
    shares = jnp.where(largest > -jnp.inf, jnp.exp(log_weights - largest), 1)
    return ends_of(shares)


def _require_symmetric(move: MultipleTry, target: Multiplexed, probes: int = 64) -> None:
    """Raise `ValueError` where the weights come from no symmetric lambda, at some random pair of states."""
    rng = np.random.default_rng(0)
    r = move.step.dim_w(target)
    index = jnp.asarray(rng.integers(0, target.n_techniques, probes), jnp.int32)
    u, w = jnp.asarray(rng.random((probes, target.dim_u))), jnp.asarray(rng.random((probes, r)))

    def asymmetry(index: Index, u: Array, w: Array) -> Scalar:
        x = target.evaluate(State(index, u))
        y: Proposal = row(around(move.step, target, x, w[None]), 0)
        forth, back = move.log_weight(x, y.state, y.log_det), move.log_weight(y.state, x, -y.log_det)
        gap = forth - back - (y.state.seen.log_c - x.seen.log_c + y.log_det)
        return jnp.where(possible(y) & (x.seen.log_c > -jnp.inf), jnp.abs(gap), 0)

    gaps = np.asarray(quickly(jax.vmap(asymmetry))(index, u, w))
    bad = ~(gaps < 1e-3)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(
            f"MultipleTry: R_g needs a symmetric lambda, and log lambda(x, y) - log lambda(y, x) is {gaps[k]:.3g} from "
            f'u = {np.asarray(u)[k]}; mend the weight, or leave out ratio="R_g": the intervals correct any weights'
        )


EXAMPLES = Examples(
    lambda: {
        "multiple_try": MultipleTry(SmallStep(0.2)),
        "multiple_try_stratified": MultipleTry(ExponentialStep(1e-3, 0.3), 3, evenly, Stratified()),
        "multiple_try_antithetic": MultipleTry(SmallStep(0.15), 4, by_target, Antithetic()),
        "multiple_try_quasi_random": MultipleTry(SmallStep(0.3), 5, evenly, Rotated()),
        "multiple_try_lambda": MultipleTry(SmallStep(0.3), 2, SymmetricLambda(lambda x, y: jnp.cos(x.u[0] - y.u[0]))),
    }
)
