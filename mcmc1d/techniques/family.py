"""Several techniques for one kind of sample, which may share what they compute."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.numerics import pick
from mcmc1d.quadrature import midpoints
from mcmc1d.techniques.base import Technique, sample_shape
from mcmc1d.types import Array, Corners, Float, Index, Scalar


class Looked(NamedTuple):
    """All that the evaluation of (index, u) asks for."""

    x: Float[Array, "..."]
    v: Float[Array, " k"]
    log_det: Scalar
    """log|d(x, v)/du|."""
    log_f: Scalar
    log_p: tuple[Scalar, ...]
    """Of every member."""
    kept: Any = ()
    """What the target found beside its value; see `Target.look`."""


class Family(eqx.Module):
    """The techniques of a `Multiplexed`, together: a map (index, u) <-> (x, v), u and v padded to one length each.

    A subclass is final. One whose techniques have steps in common, as those of bidirectional path tracing have, takes
    each step once; it is held to its `members`, each of which is a technique of its own.
    """

    @property
    @abc.abstractmethod
    def members(self) -> tuple[Technique, ...]:
        """The techniques, in the order of the index."""

    @property
    def dim_u(self) -> int:
        """m, as many numbers as the hungriest member reads."""
        return max(member.dim_u for member in self.members)

    @property
    def dim_x(self) -> int:
        """d, how many numbers a sample has."""
        return int(np.prod(sample_shape(self.members[0])))

    @abc.abstractmethod
    def forward(self, index: Index, u: Float[Array, " m"]) -> tuple[Array, Array, Scalar]:
        """(x, v, log|d(x, v)/du|) of member `index`; what it does not read of u is part of v."""

    @abc.abstractmethod
    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        """(u, log|du/d(x, v)|) of member `index`, the inverse of `forward`."""

    @abc.abstractmethod
    def log_probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...]:
        """The log-density of x with respect to dx of every member."""

    def probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...] | None:
        """The density itself of every member (see `Technique.prob`); None unless redefined."""
        return None

    def look(self, target: Any, index: Index, u: Float[Array, " m"]) -> Looked:
        """The sample, and all that is to be known of it.

        A family that knows the target's kind may find them together; they are held to those found apart.
        """
        return apart(self, target, index, u)

    def probes(self, domain: Corners, count: int) -> np.ndarray:
        """Points x at which a `Multiplexed` is looked at before it is used: a grid of the target's domain."""
        return midpoints(*domain, count)


def apart(family: Family, target: Any, index: Index, u: Float[Array, " m"]) -> Looked:
    """What `Family.look` returns, by the family's own methods and the target's."""
    x, v, log_det = family.forward(index, u)
    log_f, kept = target.look(x)
    return Looked(x, v, log_det, log_f, family.log_probs(x), kept)


class Several(Family):
    """Techniques that have nothing in common: each is asked in turn."""

    techniques: tuple[Technique, ...]

    @property
    def members(self) -> tuple[Technique, ...]:
        return self.techniques

    def forward(self, index: Index, u: Float[Array, " m"]) -> tuple[Array, Array, Scalar]:
        options = []
        for technique in self.techniques:
            x, v, log_det = technique.forward(u[: technique.dim_u])
            options.append((x, jnp.concatenate([v, u[technique.dim_u :]]), log_det))
        return pick(options, index)

    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        options: list[Any] = []
        for technique in self.techniques:
            k = technique.dim_u - self.dim_x
            u, log_det = technique.inverse(x, v[:k])
            options.append((jnp.concatenate([u, v[k:]]), log_det))
        return pick(options, index)

    def log_probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...]:
        return tuple(technique.log_prob(x) for technique in self.techniques)

    def probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...] | None:
        found = [p for technique in self.techniques if (p := technique.prob(x)) is not None]
        return tuple(found) if len(found) == len(self.techniques) else None
