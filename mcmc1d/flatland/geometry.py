"""Rays, walls and what they hit, for one ray; callers `vmap`."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.flatland.scene import Pinhole, Scene
from mcmc1d.numerics import entry, limit, locate
from mcmc1d.types import Array, Bool, Float, Index, Int, Real, Scalar

T = TypeVar("T")

_WRITTEN_OUT = 32
"""Up to so many segments a ray is held against each in one expression, which fuses and vectorises over paths."""

_CLEAR = 16
"""How many roundings a hit keeps away from a joint: enough for facets that differ by some four degrees."""

Numbers: TypeAlias = Float[Real, "..."]
"""A real number, or an array of them over the vertices of a path or the segments of a scene."""


class Vector(eqx.Module):
    """A vector of the plane, as two numbers, or vectors as two arrays: kept apart, they fuse over a batch."""

    x: Numbers
    y: Numbers

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.y + other.y)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.y - other.y)

    def __mul__(self, factor: Numbers | float) -> "Vector":
        return Vector(self.x * factor, self.y * factor)

    def dot(self, other: "Vector") -> Numbers:
        """The inner product."""
        return self.x * other.x + self.y * other.y

    def cross(self, other: "Vector") -> Numbers:
        """The third component of the cross product: positive where `other` is to the left."""
        return self.x * other.y - self.y * other.x

    def length(self) -> Numbers:
        """Its length; zero, with a zero derivative, at zero."""
        square = self.dot(self)
        return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def where(condition: Bool[Array, "..."], this: Any, that: Any) -> Any:
    """`jnp.where` leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), this, that)


class Frame(NamedTuple):
    """A segment's unit vectors: the normal of its front, and the direction from its start to its end."""

    normal: Vector
    tangent: Vector


class Hit(NamedTuple):
    """The first segment that a ray meets."""

    segment: Index
    along: Scalar
    """The distance of the point from the segment's start."""


class _Crossing(NamedTuple):
    """Where a line meets that of a segment: both numbers are quotients by |across|, which is not divided by."""

    across: Scalar
    distance: Scalar
    """In lengths of the direction."""
    along: Scalar
    """From the segment's start."""
    length: Scalar
    """Of the segment, with what it is lengthened by."""


class Walls(eqx.Module):
    """A scene's segments as arrays, closed by a black box around everything, the sky: so that every ray ends somewhere.

    Laid end to end, the segments make one line: a place in the scene is a number in [0, total), and a density "with
    respect to length" is one on that line. Beyond it, [total + j, total + j + 1) stands for a mirror's bounce on
    segment j.

    Points are relative to the scene's centre, wherever that is: single precision is for the scene alone.
    """

    start: Float[Real, "n 2"]
    tangent: Float[Real, "n 2"]
    length: Float[Real, " n"]
    overhang: Float[Real, "n 2"]
    """1 for each end that touches another segment, of which a ray meets a little more, or light leaks; 0 where none."""
    offsets: Float[Real, " ends"]
    """Where each segment begins on the line, and where the last one ends."""
    emission: Float[Real, " n"]
    lambert: Float[Real, " n"]
    glossy: Float[Real, " n"]
    mirror: Float[Real, " n"]
    finish: Int[Real, " n"]
    """Which of the `exponents` is that of the segment's glossy lobe."""
    exponents: tuple[int, ...] = eqx.field(static=True)
    """The different exponents of all glossy lobes; none where nothing is glossy."""
    mirrors: bool = eqx.field(static=True)
    """Whether any segment is a mirror: where none is, no path is unfolded."""

    def __init__(self, scene: Scene):
        """The sky stands off by a tenth of the scene's extent, and is the last four segments."""
        ends = np.concatenate([scene.ends, _sky(scene)]) - scene.centre
        along = ends[:, 1] - ends[:, 0]
        self.length = np.hypot(along[:, 0], along[:, 1])
        self.start, self.tangent = ends[:, 0], along / self.length[:, None]
        self.overhang = np.concatenate([scene.touching, np.ones((4, 2))]).astype(np.float64)
        self.offsets = np.concatenate([[0.0], np.cumsum(self.length)])
        materials = [segment.material for segment in scene.segments]
        for name in ("emission", "lambert", "glossy", "mirror"):
            setattr(self, name, np.array([getattr(m, name) for m in materials] + [0.0] * 4))
        self.exponents = tuple(sorted({material.exponent for material in materials if material.glossy > 0}))
        self.mirrors = scene.mirrors
        finishes = [self.exponents.index(m.exponent) if m.glossy > 0 else 0 for m in materials]
        self.finish = np.array(finishes + [0] * 4)

    @property
    def count(self) -> int:
        """How many segments there are, the four of the sky included."""
        return self.length.shape[0]

    @property
    def dtype(self) -> Any:
        """The precision in which JAX takes the arrays, which are NumPy's at rest."""
        return jnp.asarray(self.length).dtype

    @property
    def total(self) -> Scalar:
        """The length of the line."""
        return jnp.asarray(self.offsets[-1])

    @property
    def _rounding(self) -> Scalar:
        """By how much a point of the scene may be off."""
        return jnp.finfo(self.dtype).eps * jnp.asarray(self.length)[-2:].sum()

    def frame(self, segment: Index) -> Frame:
        """The unit vectors of a segment."""
        x, y = self._component(self.tangent, segment)
        return Frame(Vector(-y, x), Vector(x, y))

    def point(self, segment: Index, along: Scalar) -> Vector:
        """The point of a segment at a distance from its start."""
        x, y = self._component(self.start, segment)
        return Vector(x, y) + self.frame(segment).tangent * along

    def image(self, segment: Index, point: Vector) -> Vector:
        """A point's image in the line of a segment."""
        normal, start = self.frame(segment).normal, Vector(*self._component(self.start, segment))
        return point - normal * (2 * (point - start).dot(normal))

    def place(self, slot: Scalar) -> tuple[Index, Scalar]:
        """The segment that holds a place on the line, and the distance from its start."""
        segment = locate(self.offsets, slot)
        return segment, limit(slot - self.at(self.offsets, segment), 0, self.at(self.length, segment))

    def slot(self, segment: Index, along: Scalar) -> Scalar:
        """The inverse of `place`: a number that belongs to the segment, also where rounding has come to its end."""
        first, beyond = self.at(self.offsets, segment), self.at(self.offsets[1:], segment)
        return limit(first + along, first, beyond - jnp.finfo(self.dtype).epsneg * beyond)

    def bounce(self, segment: Index, pad: Scalar) -> Scalar:
        """The number of a mirror's bounce; the roundings of its own addition stay clear of the next segment's."""
        first = self.total + jnp.asarray(segment).astype(self.dtype)
        clear = 4 * jnp.finfo(self.dtype).eps * (self.total + self.count)
        return limit(first + pad, first + clear, first + 1 - clear)

    def at(self, table: Real, segment: Index) -> Any:
        """A number of a segment's, from a table of them."""
        return entry(table, segment)

    def meet(self, origin: Vector, direction: Vector, leaving: Index) -> Hit:
        """What a ray meets first, other than the segment `leaving`, which it starts on (-1: it starts on none).

        The length of `direction` does not matter.
        """

        def nearer(best: tuple[Scalar, Index], j: Index, crossing: _Crossing) -> tuple[Scalar, Index]:
            size = jnp.abs(crossing.across)
            inside = (crossing.along >= 0) & (crossing.along <= crossing.length * size)
            met = inside & (crossing.distance > 0) & (size > 0) & (j != leaving)
            # One quotient a segment: what decides whether it is met needs none.
            distance = crossing.distance / jnp.where(size > 0, size, 1)
            first = met & (distance < best[0])
            return jnp.where(first, distance, best[0]), jnp.where(first, j, best[1])

        nothing = jnp.full_like(origin.x, jnp.inf), jnp.full(jnp.shape(origin.x), self.count - 1, jnp.int32)
        # Which segment it is has no derivative; the place on it has.
        segment = self._over_segments(*jax.lax.stop_gradient((origin, direction)), nearer, nothing)[1]
        return Hit(segment, self._along(origin, direction, segment))

    def blocked(self, origin: Vector, end: Vector, leaving: Index, arriving: Index) -> Bool[Array, ""]:
        """Whether a segment other than the two stands between two points.

        What only touches the line of sight does not block it, and neither do the segments' own ends.
        """
        origin, end = jax.lax.stop_gradient((origin, end))

        def stands(before: Bool[Array, ""], j: Index, crossing: _Crossing) -> Bool[Array, ""]:
            size = jnp.abs(crossing.across)
            within = (crossing.distance > 0) & (crossing.distance < size)
            within = within & (crossing.along > 0) & (crossing.along < crossing.length * size)
            return before | (within & (j != leaving) & (j != arriving))

        return self._over_segments(origin, end - origin, stands, jnp.zeros(jnp.shape(origin.x), bool))

    def _over_segments(self, origin: Vector, direction: Vector, take: Callable, first: T) -> T:
        """`take(carry, j, crossing)` over all segments: written out for a few, which fuses; in a loop for many.

        A segment is a rounding longer at each end that touches another: they let nothing through. What stands free is
        as long as it is.
        """
        tangent, beyond = jnp.asarray(self.tangent), self._rounding * jnp.asarray(self.overhang)
        start, length = self.start - beyond[:, :1] * tangent, self.length + beyond.sum(1)

        def one(carry: T, j: Any) -> T:
            tangents = Vector(tangent[j, 0], tangent[j, 1])
            to_start = Vector(start[j, 0], start[j, 1]) - origin
            across = direction.cross(tangents)
            sign = jnp.where(across < 0, -1, 1).astype(across.dtype)
            crossing = _Crossing(across, to_start.cross(tangents) * sign, to_start.cross(direction) * sign, length[j])
            return take(carry, j, crossing)

        if self.count <= _WRITTEN_OUT:
            carry = first
            for j in range(self.count):
                carry = one(carry, j)
            return carry
        return jax.lax.fori_loop(0, self.count, lambda j, carry: one(carry, j), first, unroll=4)

    def _along(self, origin: Vector, direction: Vector, segment: Index) -> Scalar:
        """The same for one segment: here derivatives are taken.

        Within its ends, and a few roundings away from one that touches another segment: a point that is rounded to lie
        behind that one would see what it hides.
        """
        across = direction.cross(self.frame(segment).tangent)
        to_start = self.point(segment, jnp.zeros_like(origin.x)) - origin
        along = to_start.cross(direction) / jnp.where(across == 0, 1, across)
        length = jnp.asarray(self.length)
        clear = jnp.minimum(_CLEAR * self._rounding, length / 64)
        first, last = clear * self.overhang[:, 0], length - clear * self.overhang[:, 1]
        return limit(along, self.at(first, segment), self.at(last, segment))

    def _component(self, table: Float[Real, "n 2"], segment: Index) -> tuple[Scalar, Scalar]:
        return self.at(table[:, 0], segment), self.at(table[:, 1], segment)


def _sky(scene: Scene) -> np.ndarray:
    """Four sides, counter-clockwise: their fronts look inward."""
    points = scene.ends.reshape(-1, 2)
    if isinstance(scene.sensor, Pinhole):
        points = np.concatenate([points, [scene.sensor.position]])
    low, high = points.min(0), points.max(0)
    margin = 0.1 * float((high - low).max())
    (left, bottom), (right, top) = low - margin, high + margin
    corners = np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
