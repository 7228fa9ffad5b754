"""The two samples at once of `beyond_rjmlt`: Box-Muller's pair as a technique, and a wrong inverse of it."""

from mcmc1d.moves import LargeStep, Mixture, Move, ReversibleJump, SmallStep
from mcmc1d.state import Multiplexed
from mcmc1d.targets.planar import Banana
from mcmc1d.techniques import Technique
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.techniques.gaussian import BoxMuller
from mcmc1d.types import Array, Corners, Float, Scalar


class HalfTheAngles(Technique):
    """Box-Muller with an inverse by the arc tangent of the ratio, which knows no quadrant."""

    right: BoxMuller = BoxMuller((0.0, 0.3), 0.8)

    @property
    def dim_u(self) -> int:
        return 2

    @property
    def support(self) -> Corners:
        return self.right.support

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        return self.right.forward(u)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        u, log_det = self.right.inverse(x, v)
        return u.at[1].set(u[1] % 0.5), log_det

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        return self.right.log_prob(x)


def pairs(technique: Technique) -> tuple[Multiplexed, Move]:
    """A banana seen through two Box-Muller techniques, and jumps between them."""
    target = Multiplexed(Banana(), (technique, BoxMuller((0.2, 1.0), 1.6)))
    move = Mixture({"small": (0.5, SmallStep(0.1)), "large": (0.1, LargeStep()), "jump": (0.4, ReversibleJump())})
    return target, move
