"""Kernels that deposit a whole packet of candidates: coherent Metropolis light transport, as published and repaired."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Deposits, Info, Kernel, OfMove, Step, accept
from mcmc1d.moves import Move, MultipleTry, Proposal, SmallStep
from mcmc1d.moves.candidates import insert
from mcmc1d.moves.multiple_try import around, possible, row
from mcmc1d.numerics import choose, ends_of
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float


class PublishedDeposit(OfMove[MultipleTry]):
    """Multiple-try with the deposits of Segovia, Iehl, Peroche 2007, section 5.2: biased for two candidates or more.

    Every candidate gets R_g times its share of its family, every competitor, the current state among them, 1 - R_g
    times its share of the other, with R_g limited to one. As published a share is in proportion to the target, f / sum
    f; `inner="weights"` takes the weights w by which one candidate is selected. The chain itself is right; what is
    deposited is biased, except for p = 1, for a symmetric step whose candidates are chosen evenly, and with
    `inner="weights"` for an independent proposal and lambda = 1 / (g g): there the current state is among its
    competitors as any of them would be, in proportion to f. See `metropolis.Metropolis` for the deposit on two states,
    `AuxiliaryCentre` for p + 1.
    """

    move: MultipleTry
    inner: Literal["target", "weights"] = eqx.field(static=True, default="target")

    def __check_init__(self):
        require_instance(self.move, MultipleTry, "PublishedDeposit: the move")
        require(
            self.inner in ("target", "weights"),
            f'PublishedDeposit: inner must be "target" or "weights", not {self.inner!r}',
        )

    def check(self, target: Multiplexed) -> None:
        self.move.check(target)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        proposal, packet = self.move.propose_packet(target, state, w[:-1])
        step = accept(target, state, proposal, w[-1], "plain")
        a = step.info.acceptance[0]
        # A dead end has neither family: all of it on the current state.
        alone = a == 0
        forth, back = packet.log_forth, packet.log_back
        if self.inner == "target":
            # What can not be proposed has no weight, and so no share.
            forth, back = (
                jnp.where(w > -jnp.inf, family.seen.log_c, -jnp.inf)
                for w, family in ((forth, packet.candidates), (back, packet.competitors))
            )
        forth = jnp.where(alone, 0, a * jax.nn.softmax(forth))
        back = jnp.where(alone | (a >= 1), 0, (1 - a) * jax.nn.softmax(back))  # which may be dark, and then is NaN
        weights = jnp.concatenate([forth, back, jnp.where(alone, 1, 0)[None].astype(a.dtype)])
        deposits = _deposits([packet.candidates, packet.competitors, _one(state)], weights, state)
        return Step(step.state, deposits, step.info)


class AuxiliaryCentre(Kernel):
    """A centre z around x, p candidates around z, and one of all p + 1 by its weight: exact deposits on every one.

    The weights pi(s) q(z given s) / q(s given z) are those with which the next state is drawn, x among them, so that
    nothing is ever rejected, there are no competitors, and half the evaluations of multiple-try suffice (Tjelmeland
    2004; Calderhead 2014). The centre's own density does not matter, but the centre must lie in the unit cube.
    """

    step_by: Move
    tries: int = eqx.field(static=True)

    def __init__(self, step: Move, tries: int = 4):
        """`step`: a move that leads to the centre and from there to the candidates; `tries`: p, one at least."""
        require_instance(step, Move, "AuxiliaryCentre: the step")
        require_whole(tries, "AuxiliaryCentre: tries")
        self.step_by, self.tries = step, tries

    @property
    def kinds(self) -> tuple[str, ...]:
        return ("AuxiliaryCentre",)

    def dim_w(self, target: Multiplexed) -> int:
        return (self.tries + 1) * self.step_by.dim_w(target) + 1

    def check(self, target: Multiplexed) -> None:
        self.step_by.check(target)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        p, r = self.tries, self.step_by.dim_w(target)
        numbers = w[:-1].reshape(p + 1, r)
        centre: Proposal = row(around(self.step_by, target, state, numbers[:1]), 0)
        reached = centre.inside & jnp.isfinite(centre.log_det)
        family = around(self.step_by, target, centre.state, numbers[1:])
        log_weights = jnp.where(
            jax.vmap(possible)(family) & reached, family.state.seen.log_c + family.log_det, -jnp.inf
        )
        own = jnp.where(reached, state.seen.log_c - centre.log_det, 0)  # without a centre all stays as it is
        log_weights = jnp.concatenate([own[None], log_weights])
        # Where the target is NaN the chain goes, and is found; a dark state among dark ones stays.
        lost = jnp.isposinf(log_weights)
        log_weights = jnp.where(lost.any(), jnp.where(lost, 0, -jnp.inf), log_weights)
        log_weights = log_weights.at[0].set(jnp.where(jnp.isneginf(log_weights).all(), 0, log_weights[0]))
        shares = jax.nn.softmax(log_weights)
        states = jax.tree.map(lambda one, more: insert(more, one, jnp.zeros((), jnp.int32)), state, family.state)
        k, _ = choose(ends_of(shares), w[-1])
        moved = 1 - shares[0]
        info = Info(jnp.zeros(1, jnp.int32), moved[None], jnp.asarray(k > 0)[None])
        return Step(row(states, k), _deposits([states], shares, state), info)


def _one(state: State) -> State:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], state)


def _deposits(families: list[State], weights: Float[Array, " n"], home: State) -> Deposits:
    """The families' points with their weights; a point without weight, which may be no point, stands at home."""
    x = jnp.concatenate([family.seen.x for family in families])
    index = jnp.concatenate([jnp.asarray(family.index, jnp.int32) for family in families])
    lit = weights > 0
    x = jnp.where(lit.reshape(-1, *[1] * (x.ndim - 1)), x, home.seen.x)
    return Deposits(x, jnp.where(lit, index, home.index), weights)


EXAMPLES = Examples(
    lambda: {
        "published_deposit": PublishedDeposit(MultipleTry(SmallStep(0.2), 3)),
        "published_deposit_by_weights": PublishedDeposit(MultipleTry(SmallStep(0.2), 3), "weights"),
        "auxiliary_centre": AuxiliaryCentre(SmallStep(0.2), 3),
    }
)
