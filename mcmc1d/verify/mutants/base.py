"""What a mutant is made of: a right technique or move, all of which is forwarded but for the mistake."""

from typing import Any

import equinox as eqx

from mcmc1d.moves import Move, Proposal
from mcmc1d.state import Multiplexed, State
from mcmc1d.techniques import Technique
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.types import Array, Corners, Float, Scalar


class WrongTechnique(Technique):
    """A technique that is `right` in everything which a subclass does not redefine."""

    right: eqx.AbstractVar[Any]  # a technique; a subclass may ask for a kind of it

    @property
    def dim_u(self) -> int:
        return self.right.dim_u

    @property
    def support(self) -> Corners:
        return self.right.support

    @property
    def breaks(self) -> tuple[float, ...]:
        return self.right.breaks

    def forward(self, u: Float[Array, " m"]) -> Forward:
        return self.right.forward(u)

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        return self.right.inverse(x, v)

    def log_prob(self, x: Float[Array, "..."]) -> Scalar:
        return self.right.log_prob(x)


class WrongMove(Move):
    """A move that is `right` in everything which a subclass does not redefine."""

    right: eqx.AbstractVar[Any]  # a move

    def dim_w(self, target: Multiplexed) -> int:
        return self.right.dim_w(target)

    def check(self, target: Multiplexed) -> None:
        self.right.check(target)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.right.kinds

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        return self.right.propose(target, state, w)


MUTANTS = {}
"""None here: the tests look for a mapping in every file of this folder."""
