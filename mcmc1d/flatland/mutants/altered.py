"""Techniques that are another family's but for what a mutant overrides."""

from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.techniques import Family, Technique
from mcmc1d.types import Array, Float, Index, Scalar


class Altered(Family):
    """The techniques of bidirectional path tracing, of which a mutant overrides what it gets wrong."""

    right: Bidirectional

    @property
    def members(self) -> tuple[Technique, ...]:
        return self.right.members

    @property
    def dim_u(self) -> int:
        return self.right.dim_u

    @property
    def dim_x(self) -> int:
        return self.right.dim_x

    def forward(self, index: Index, u: Float[Array, " m"]) -> tuple[Array, Array, Scalar]:
        return self.right.forward(index, u)

    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        return self.right.inverse(index, x, v)

    def log_probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...]:
        return self.right.log_probs(x)
