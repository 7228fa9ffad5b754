"""Techniques in the plane, uniform or not: what they have in common, and a box."""

import abc

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require_box
from mcmc1d.examples import Examples
from mcmc1d.numerics import below_one, limit, parameter
from mcmc1d.quadrature import Outline
from mcmc1d.techniques.base import Forward, Inverse, Technique
from mcmc1d.techniques.mixture import Mixture
from mcmc1d.types import Array, Corners, Float, Real, Scalar

ROUNDINGS = 8
"""Of the coordinates, by which a sample on the rim may lie beyond it."""


class Planar(Technique):
    """A technique u in [0, 1)^2 <-> x in the plane, which forgets nothing: its determinant is -log p(x)."""

    @property
    def dim_u(self) -> int:
        return 2

    @property
    @abc.abstractmethod
    def outline(self) -> Outline:
        """Where the density jumps or bends: exact quadrature is split there."""


def outlines(technique: Technique) -> list[Outline]:
    """All curves along which a planar technique's density may jump; the sides of its support where it names none."""
    if isinstance(technique, Mixture):
        return [outline for lobe in technique.lobes for outline in outlines(lobe)]
    return [technique.outline if isinstance(technique, Planar) else Outline.box(*technique.support)]


class Rectangle(Planar):
    """Uniform on a box: x = lower + u (upper - lower)."""

    lower: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    upper: Float[Real, " 2"] = eqx.field(converter=parameter, default=(1.0, 1.0))

    def __check_init__(self):
        require_box(self, self.lower, self.upper)

    @property
    def support(self) -> Corners:
        return self.lower, self.upper

    @property
    def outline(self) -> Outline:
        return Outline.box(self.lower, self.upper)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        x = limit(self.lower + u * (self.upper - self.lower), self.lower, self.upper)
        return x, u[2:], jnp.log(self.upper - self.lower).sum()

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        return below_one((x - self.lower) / (self.upper - self.lower)), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        inside = jnp.all((x >= self.lower) & (x <= self.upper))
        return jnp.where(inside, -jnp.log(self.upper - self.lower).sum(), -jnp.inf)


EXAMPLES = Examples(lambda: {"rectangle": Rectangle((-1, 0.5), (2, 1))})
