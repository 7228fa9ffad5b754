"""The kernels that `mtm_lambda` enumerates on a ring: weights, candidates and competitors, right and wrong."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import mcmc1d
from mcmc1d.checks import require
from mcmc1d.moves import Antithetic, Move, MultipleTry, Rotated, Stratified
from mcmc1d.moves.candidates import Candidates, Reverse, insert
from mcmc1d.moves.multiple_try import SymmetricLambda, by_importance, evenly
from mcmc1d.types import Index
from mcmc1d.verify import RingStep
from mcmc1d.verify.mutants.base import WrongMove

SOURCE = "Segovia et al. 2007"
_CRAIU = "Craiu and Lemieux 2007"
F = (1.0, 3.0, 0.5, 2.0, 4.0, 1.5)
CHANCES = {1: 0.5, -1: 0.25, 3: 0.25}
"""Lopsided, and with q(y given x) q(x given y) not the same for all pairs: 1 and 1/(qq) are different lambdas."""
RING_STEP = RingStep(len(F), CHANCES)


def _log_qq(x: mcmc1d.State, y: mcmc1d.State) -> jax.Array:
    """The log of q(y given x) q(x given y) on the ring."""
    n = len(F)
    chances = np.array([CHANCES.get(k, 0) + CHANCES.get(k - n, 0) for k in range(n)])
    table = np.log(np.maximum(chances * chances[-np.arange(n)], 1e-300))
    offset = jnp.round((y.u[0] - x.u[0]) * n).astype(jnp.int32) % n
    return jnp.asarray(table, x.u.dtype)[offset]


SYMMETRIC = {
    "1": SymmetricLambda(lambda x, y: 0.5 * _log_qq(x, y)),
    "1/(qq)": SymmetricLambda(lambda x, y: -0.5 * _log_qq(x, y)),
    "1/sqrt(qq)": by_importance,
    "exp(cos 7(x-y) + xy)": SymmetricLambda(lambda x, y: jnp.cos(7 * (x.u[0] - y.u[0])) + x.u[0] * y.u[0]),
}


def _tilted(x: mcmc1d.State, y: mcmc1d.State, log_ratio: jax.Array) -> jax.Array:
    """Lambda = exp(2 y) / sqrt(qq), which is not symmetric."""
    return by_importance(x, y, log_ratio) + 2 * y.u[0]


ASYMMETRIC = {"equal weights": evenly, "exp(2y)/sqrt(qq)": _tilted}


class Unchecked(WrongMove):
    """A multiple-try that `check` would refuse."""

    right: MultipleTry

    def check(self, target: mcmc1d.Multiplexed) -> None:
        """Nothing is refused."""


class OtherStrata(Candidates):
    """Stratified candidates; the competitors in all strata but the chosen one's, wherever the way back lies."""

    def dim(self, p: int, r: int) -> int:
        return Stratified().dim(p, r)

    def forth(self, p: int, r: int, w: jax.Array) -> jax.Array:
        return Stratified().forth(p, r, w)

    def back(self, p: int, r: int, w: jax.Array, k: Index, number: jax.Array) -> Reverse:
        rows = insert(w.reshape(2 * p - 1, r)[p:], number, k)
        return Reverse(Stratified().forth(p, r, rows.ravel()).at[k].set(number), k, w)


class FreshCompetitors(Candidates):
    """Candidates that one vector makes, and competitors that are independent of where the way back lies."""

    together: Candidates

    def check(self, p: int) -> None:
        require(p == 2 or isinstance(self.together, Rotated), f"FreshCompetitors: one vector makes two, not {p}")

    def dim(self, p: int, r: int) -> int:
        return p * r

    def forth(self, p: int, r: int, w: jax.Array) -> jax.Array:
        return self.together.forth(p, r, w[:r])

    def back(self, p: int, r: int, w: jax.Array, k: Index, number: jax.Array) -> Reverse:
        return Reverse(insert(w[r:].reshape(p - 1, r), number, k), k, w)


def rings() -> dict[str, tuple[Move, list[int | None]]]:
    """What is enumerated: each kernel, and how its numbers are told apart."""
    made: dict[str, tuple[Move, list[int | None]]] = {"Metropolis": (RING_STEP, [4, None])}
    made["one candidate"] = MultipleTry(RING_STEP, 1), [4, None, None]
    plan = [4, 4, 4, None, None]
    for name, weight in SYMMETRIC.items():
        made[f"R_g: {name}"] = MultipleTry(RING_STEP, 2, weight, ratio="R_g"), plan
    for name, weight in ASYMMETRIC.items():
        made[f"R_g: {name}"] = Unchecked(MultipleTry(RING_STEP, 2, weight, ratio="R_g")), plan
        made[f"intervals: {name}"] = MultipleTry(RING_STEP, 2, weight), plan
    made["strata: left free"] = MultipleTry(RING_STEP, 2, by_importance, Stratified()), [2, 2, 2, None, None]
    made["strata: all but the chosen"] = MultipleTry(RING_STEP, 2, by_importance, OtherStrata()), [2, 2, 2, None, None]
    made["quasi-random: rotated"] = MultipleTry(RING_STEP, 2, by_importance, Rotated()), [None, None, None]
    fresh = FreshCompetitors(Rotated()), FreshCompetitors(Antithetic())
    made["quasi-random: independent"] = MultipleTry(RING_STEP, 2, by_importance, fresh[0]), [None, 4, None, None]
    # Eight outcomes: the opposite of a way back lies in an eighth.
    made["antithetic: opposite"] = MultipleTry(RING_STEP, 2, by_importance, Antithetic()), [8, None, None]
    made["antithetic: independent"] = MultipleTry(RING_STEP, 2, by_importance, fresh[1]), [4, 4, None, None]
    return made


class Kept(NamedTuple):
    """That a kernel keeps the law: enumerated on the ring, and verified on the line."""

    name: str
    statement: str
    source: str
    ring: str
    line: str
    """Its names there."""
    expected: str = "holds"
    there: str = ""
    """In what it differs there."""


CANDIDATES = (
    Kept(
        "strata-all-but-chosen",
        "Stratified candidates, with competitors in all strata but the chosen one's, keep the law",
        f"ours; {SOURCE}, sec. 6.2; {_CRAIU}",
        "strata: all but the chosen",
        "other strata",
        "fails",
    ),
    Kept(
        "strata-left-free",
        "With competitors in the strata that the way back leaves free they do",
        f"ours; {_CRAIU}",
        "strata: left free",
        "right",
        there=", four clamped ones",
    ),
    Kept(
        "quasi-random-independent",
        "Quasi-random candidates with independent competitors keep the law",
        f"ours; {SOURCE}, sec. 6.3; {_CRAIU}",
        "quasi-random: independent",
        "fresh competitors",
        "fails",
    ),
    Kept(
        "quasi-random-rotated",
        "With competitors of the rotation that leads back they do",
        f"ours; {_CRAIU}",
        "quasi-random: rotated",
        "rotated",
    ),
    Kept(
        "antithetic-independent",
        "Antithetic candidates, w and 1 - w, with an independent competitor keep the law",
        f"ours; {_CRAIU}",
        "antithetic: independent",
        "fresh opposite",
        "fails",
    ),
    Kept(
        "antithetic-opposite",
        "With the opposite of the way back as the competitor they do",
        f"ours; {_CRAIU}",
        "antithetic: opposite",
        "antithetic",
    ),
)
