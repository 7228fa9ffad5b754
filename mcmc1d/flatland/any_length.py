"""Paths of 1 to K edges as one space, for a chain that goes from one length to another.

A point has the numbers of a path, and one for each edge that the path is short of the longest: a spare number in [0, 1)
less one. So the numbers that are not negative tell the length, and all lengths have one measure: that of a path's own
numbers, which the spare ones leave alone.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_whole
from mcmc1d.examples import Examples
from mcmc1d.flatland.bidirectional import Bidirectional, Joined
from mcmc1d.flatland.evaluation import reads
from mcmc1d.flatland.paths import Light, Paths
from mcmc1d.flatland.scene import Scene
from mcmc1d.numerics import pick
from mcmc1d.targets import Target
from mcmc1d.techniques import Family, Looked, Technique
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.types import Array, Corners, Float, Index, Int, Scalar


class LightOfAnyLength(Target):
    """The light f of paths of 1 to K edges; over those of one length that arrive in a pixel, as that of `Light`."""

    lights: tuple[Light, ...]
    """By length, from 1."""

    def __init__(self, scene: Scene, most: int):
        """`most`: K, the number of edges of the longest paths."""
        require_whole(most, "LightOfAnyLength: the edges of the longest path")
        self.lights = tuple(Light(Paths(scene, k)) for k in range(1, most + 1))

    @property
    def paths(self) -> Paths:
        """The longest."""
        return self.lights[-1].paths

    @property
    def domain(self) -> Corners:
        low, high = self.paths.corners
        return low - 1, high

    def edges(self, x: Float[Array, " d"]) -> Int[Array, ""]:
        """The length of a path."""
        return edges(self.paths, x)

    def pixel(self, x: Float[Array, " d"]) -> Int[Array, ""]:
        """The pixel at which it arrives."""
        return pick([light.paths.pixel(x[: light.paths.dim]) for light in self.lights], self.edges(x) - 1)

    def log_f(self, x: Float[Array, " d"]) -> Scalar:
        return pick([light.log_f(x[: light.paths.dim]) for light in self.lights], self.edges(x) - 1)

    def bin_masses(self, edges: Any) -> np.ndarray:
        raise ValueError("LightOfAnyLength: the exact image is not the target's to tell; see flatland.reference.image")


class AnyLength(Family):
    """The techniques of `Bidirectional` for each length, shortest first; the numbers of u that one does not read spare.

    Eye numbers stand at the front of u and lamp numbers at the back: at the same u, technique (s, t + 1) of the next
    length has the same vertices and one more after the t-th, (s + 1, t) one more before it.
    """

    families: tuple[Bidirectional, ...]

    def __init__(self, target: LightOfAnyLength):
        """`target`: the light of the same paths."""
        self.families = tuple(Bidirectional(light.paths) for light in target.lights)

    @property
    def paths(self) -> Paths:
        """The longest."""
        return self.families[-1].paths

    @property
    def edges(self) -> tuple[int, ...]:
        """The number of edges of each technique's paths."""
        return tuple(family.paths.edges for family in self.families for _ in family.lengths)

    @property
    def lengths(self) -> tuple[int, ...]:
        """How many of its vertices each technique walks from the sensor: its t."""
        return tuple(t for family in self.families for t in family.lengths)

    @property
    def members(self) -> tuple[Technique, ...]:
        members = zip(self.edges, self.lengths, strict=True)
        return tuple(Shorter(Joined(self.families[k - 1].paths, t), self.paths) for k, t in members)

    @property
    def dim_u(self) -> int:
        return self.families[-1].dim_u

    @property
    def dim_x(self) -> int:
        return self.paths.dim

    def forward(self, index: Index, u: Float[Array, " m"]) -> tuple[Array, Array, Scalar]:
        options = []
        for family, first in zip(self.families, self._firsts(), strict=True):
            inner, spare = self._apart(family, index - first, u)
            x, v, log_det = family.forward(index - first, inner)
            options.append((*_with_spare(x, v, spare), log_det))
        return pick(options, self._length(index) - 1)

    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        options = []
        for family, first in zip(self.families, self._firsts(), strict=True):
            d = family.dim_x
            inner, log_det = family.inverse(index - first, x[:d], v[: family.dim_u - d])
            spare = jnp.concatenate([x[d:] + 1, v[family.dim_u - d :]])
            log_det = jnp.where(edges(self.paths, x) == family.paths.edges, log_det, -jnp.inf)
            options.append(
                (pick([_together(t, self.paths, inner, spare) for t in family.lengths], index - first), log_det)
            )
        return pick(options, self._length(index) - 1)

    def log_probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...]:
        own = edges(self.paths, x)
        return tuple(
            jnp.where(own == family.paths.edges, log_p, -jnp.inf)
            for family in self.families
            for log_p in family.log_probs(x[: family.dim_x])
        )

    def look(self, target: Any, index: Index, u: Float[Array, " m"]) -> Looked:
        """Each length by its own family, which meets each edge of the path once."""
        require(
            isinstance(target, LightOfAnyLength) and len(target.lights) == len(self.families),
            "AnyLength: the target must be LightOfAnyLength of as many lengths",
        )
        options = []
        for family, light, first in zip(self.families, target.lights, self._firsts(), strict=True):
            inner, spare = self._apart(family, index - first, u)
            x, v, log_det, log_f, log_p, *_ = family.look(light, index - first, inner)
            never = jnp.full_like(log_f, -jnp.inf)
            all_p = [never] * first + list(log_p) + [never] * (len(self.lengths) - first - len(log_p))
            options.append(Looked(*_with_spare(x, v, spare), log_det, log_f, tuple(all_p)))
        return pick(options, self._length(index) - 1)

    def probes(self, domain: Corners, count: int) -> np.ndarray:
        """Paths that the techniques make themselves, of each length as many."""
        each = [family.probes(domain, -(-count // len(self.families))) for family in self.families]
        spare = np.random.default_rng(1).random((len(each), len(each[0]), self.dim_x))
        return np.concatenate([np.hstack([x, s[:, x.shape[1] :] - 1]) for x, s in zip(each, spare, strict=True)])

    def _firsts(self) -> list[int]:
        """The index of the first technique of each length."""
        counts = [len(family.lengths) for family in self.families]
        return [sum(counts[:k]) for k in range(len(counts))]

    def _length(self, index: Index) -> Int[Array, ""]:
        return jnp.sum(jnp.asarray(index) >= jnp.asarray(self._firsts()), dtype=jnp.int32)

    def _apart(self, family: Bidirectional, own: Index, u: Float[Array, " m"]) -> tuple[Array, Array]:
        return pick([_apart(t, family.paths, self.paths, u) for t in family.lengths], own)


class Shorter(Technique):
    """A technique for paths of one length among those of other lengths: what it does not read of u is spare."""

    technique: Joined
    longest: Paths

    @property
    def dim_u(self) -> int:
        return 2 * self.longest.edges - 1 + self.longest.sensor.places

    @property
    def support(self) -> Corners:
        low, high = self.longest.corners
        return low - 1, high

    def forward(self, u: Float[Array, " m"]) -> Forward:
        inner, spare = _apart(self.technique.t, self.technique.paths, self.longest, u)
        x, v, log_det = self.technique.forward(inner)
        return *_with_spare(x, v, spare), log_det

    def inverse(self, x: Float[Array, " d"], v: Float[Array, " k"]) -> Inverse:
        d = self.technique.paths.dim
        kept = self.technique.dim_u - d
        inner, _ = self.technique.inverse(x[:d], v[:kept])
        spare = jnp.concatenate([x[d:] + 1, v[kept:]])
        return _together(self.technique.t, self.longest, inner, spare), self.log_prob(x)

    def log_prob(self, x: Float[Array, " d"]) -> Scalar:
        own = edges(self.longest, x) == self.technique.paths.edges
        return jnp.where(own, self.technique.log_prob(x[: self.technique.paths.dim]), -jnp.inf)


def edges(longest: Paths, x: Float[Array, " d"]) -> Int[Array, ""]:
    """How many edges a path has, 1 at least."""
    return jnp.maximum(jnp.sum(x[longest.sensor.places :] >= 0, dtype=jnp.int32), 1)


def _apart(t: int, paths: Paths, longest: Paths, u: Float[Array, " m"]) -> tuple[Array, Array]:
    """What technique t reads of u, from both its ends, and the spare numbers between."""
    first, spare = reads(t, paths.sensor.places)[0], 2 * (longest.edges - paths.edges)
    return jnp.concatenate([u[:first], u[first + spare :]]), u[first : first + spare]


def _together(t: int, longest: Paths, inner: Float[Array, " n"], spare: Float[Array, " r"]) -> Float[Array, " m"]:
    first = reads(t, longest.sensor.places)[0]
    return jnp.concatenate([inner[:first], spare, inner[first:]])


def _with_spare(x: Float[Array, " d"], v: Float[Array, " k"], spare: Float[Array, " r"]) -> tuple[Array, Array]:
    """A path's point and v, each with half of the spare numbers."""
    half = len(spare) // 2
    return jnp.concatenate([x, spare[:half] - 1]), jnp.concatenate([v, spare[half:]])


def _examples() -> dict[str, Any]:
    from mcmc1d.flatland.scenes import scene

    light = LightOfAnyLength(scene("box"), 2)
    shorter, longest = (part.paths for part in light.lights)
    return {"light_of_any_length": light, "shorter": Shorter(Joined(shorter, 2), longest)}


EXAMPLES = Examples(_examples)

__all__ = ["EXAMPLES", "AnyLength", "LightOfAnyLength", "Shorter"]
