"""Paths of k edges as points x, their geometry, and the light that they carry.

A path has vertices 0 (on the sensor) to k (on a lamp). x holds a number for each vertex that is free: the place on the
walls' line (see `Walls`), or, for a mirror's bounce on segment j, total + j + a number that nothing depends on; where
the bounce is follows from the vertices around it. So paths with and without mirrors are points of one space, with
densities with respect to one measure, d length for each vertex that is no mirror's bounce.
"""

import abc
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.examples import Examples
from mcmc1d.flatland.geometry import Vector, Walls, where
from mcmc1d.flatland.scattering import Local, brdf, local, log_density
from mcmc1d.flatland.scene import Scene, require_scene
from mcmc1d.flatland.sensors import Sensor, sensor_of
from mcmc1d.numerics import choose, limit, stratum
from mcmc1d.targets import Target
from mcmc1d.types import Array, Bool, Corners, Float, Index, Int, Real, Scalar


class Geometry(NamedTuple):
    """A path looked at: arrays over its k + 1 vertices, or its k edges (edge i joins the vertices i and i + 1)."""

    segment: Int[Array, " vertices"]
    mirror: Bool[Array, " vertices"]
    """Whether the vertex is a mirror's bounce."""
    pad: Float[Array, " vertices"]
    """The number in [0, 1) of a mirror's bounce."""
    out: Local
    """Of shape (k,): at vertex i the direction to i + 1, in its frame."""
    coming: Local
    """Of shape (k,): at vertex i + 1 the direction to i."""
    clear: Bool[Array, " k"]
    """Whether an edge joins two walls with nothing between them, and both ends are where they can be."""
    from_eye: Float[Array, " k"]
    """At vertex i + 1, the distance back to the last vertex before it that is no mirror's bounce, unfolded."""
    from_light: Float[Array, " k"]
    """At vertex i, the distance to the next vertex after it that is no mirror's bounce, unfolded."""
    placed: Bool[Array, " vertices"]
    """Whether the vertex is where one can be."""

    def between(self) -> tuple[Any, Any, Any, Any]:
        """(segment, coming, out, mirror) of the vertices 1 to k - 1, at which a path is scattered."""
        coming = jax.tree.map(lambda a: a[:-1], self.coming)
        return self.segment[1:-1], coming, jax.tree.map(lambda a: a[1:], self.out), self.mirror[1:-1]


_LONGEST = 64
"""Edges: a density is a product of as many factors, of which the smallest paths of all still are float32 numbers."""


class Paths(eqx.Module):
    """The space of all paths of k edges in a scene."""

    walls: Walls
    sensor: Sensor
    centre: Float[Real, " 2"]
    """Of the scene: the points of walls and sensor are relative to it."""
    edges: int = eqx.field(static=True)

    def __init__(self, scene: Scene, edges: int):
        """`edges`: k, 1 for a lamp that is seen directly."""
        require_scene(scene, "Paths: the scene")
        require_whole(edges, "Paths: edges")
        require(edges <= _LONGEST, f"Paths: {edges} edges; {_LONGEST} at most, or the densities leave single precision")
        self.walls, self.sensor, self.centre, self.edges = Walls(scene), sensor_of(scene), scene.centre, edges

    @property
    def dim(self) -> int:
        """How many numbers a path has: k, and one more where the sensor is no point."""
        return self.edges + self.sensor.places

    @property
    def eye_lengths(self) -> range:
        """The t of all techniques, of how many vertices they walk from the sensor: 0 where a walk may come upon it."""
        return range(1 - self.sensor.places, self.edges + 2)

    @property
    def corners(self) -> Corners:
        """Of the box that holds every x."""
        top = jnp.broadcast_to(jnp.asarray(self.walls.total) + self.walls.count, (self.dim,))
        return jnp.zeros_like(top), top

    def film(self, x: Float[Array, " d"]) -> Scalar:
        """The film coordinate in [0, 1) at which a path arrives."""
        point, segment = self.sensor.point(self.walls, x[0])
        way = self._first_image(x) - point
        direction = way * (1 / jnp.maximum(way.length(), _shortest(x.dtype)))
        return self.sensor.film(self.walls, x[0], local(self.sensor.frame(self.walls, segment), direction))

    def _first_image(self, x: Float[Array, " d"]) -> Vector:
        """Where the sensor sees the first vertex that is no mirror's bounce, wherever the others are.

        One vertex after the other: over many chains, what is joined in an array is joined by a branch for each number.
        """
        walls, slots = self.walls, x[self.sensor.places :]
        if not walls.mirrors:
            return walls.point(*walls.place(slots[0]))
        image = walls.point(*walls.place(slots[self.edges - 1]))
        for i in reversed(range(self.edges - 1)):
            mirror, _, segment = self._bounce(slots[i])
            image = where(mirror, walls.image(segment, image), walls.point(*walls.place(slots[i])))
        return image

    def pixel(self, x: Float[Array, " d"]) -> Int[Array, ""]:
        """The pixel at which a path arrives."""
        return stratum(self.film(x), self.sensor.pixels)

    def vertices(self, x: Float[Array, " d"]) -> Float[Array, "vertices 2"]:
        """The points in the plane, for pictures."""
        points = self._points(x)[0]
        x, y = self.centre
        return jnp.stack([points.x + x, points.y + y], axis=-1)

    def segments(self, x: Float[Array, " d"]) -> Int[Array, " vertices"]:
        """The segment that each vertex is on; -1 at a pinhole."""
        return self._points(x)[1]

    def geometry(self, x: Float[Array, " d"]) -> Geometry:
        """Everything that densities and light depend on; finite for any x in the box, whether it is a path or not."""
        walls, k = self.walls, self.edges
        points, segment, mirror, pad, placed = self._points(x)
        here, there = (jax.tree.map(lambda a, own=own: a[own], points) for own in (slice(k), slice(1, k + 1)))
        step = there - here
        distance = jnp.maximum(step.length(), _shortest(walls.dtype))
        direction = step * (1 / distance)
        first = self.sensor.frame(walls, segment[0])
        frames = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, jax.vmap(walls.frame)(segment[1:]))
        out = jax.vmap(local)(jax.tree.map(lambda a: a[:-1], frames), direction)
        coming = jax.vmap(local)(jax.tree.map(lambda a: a[1:], frames), direction * -1.0)
        clear = placed[:-1] & placed[1:] & (segment[:-1] != segment[1:])
        clear = clear & ~jax.vmap(walls.blocked)(here, there, segment[:-1], segment[1:])
        from_eye = from_light = distance
        if walls.mirrors:
            # A bounce leaves to the side that it came from.
            turns = mirror[1:-1] & (out.up[1:] * coming.up[:-1] <= 0)
            clear = clear.at[1:].set(clear[1:] & ~turns)
            from_eye = _behind(distance, mirror[1:-1])
            from_light = _behind(distance[::-1], mirror[1:-1][::-1])[::-1]
        return Geometry(segment, mirror, pad, out, coming, clear, from_eye, from_light, placed)

    def _points(self, x: Float[Array, " d"]) -> tuple[Vector, Array, Array, Array, Array]:
        """The vertices: their points, segments, whether mirrors, their pads, and whether each is where it can be."""
        walls = self.walls
        point, segment = self.sensor.point(walls, x[0])
        slots = x[self.sensor.places :]
        segments, along = jax.vmap(walls.place)(slots)
        segments = jnp.asarray(segments, jnp.int32)
        mirror, pad, bounced = self._bounce(slots)
        segments = jnp.where(mirror, bounced, segments)
        points = jax.vmap(walls.point)(segments, along)
        points = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), point, points)
        inside = (x >= 0) & (x <= walls.total + walls.count)
        placed = jnp.concatenate([jnp.ones(1 - self.sensor.places, bool), inside])
        segments = jnp.concatenate([jnp.asarray(segment, jnp.int32)[None], segments])
        mirror = jnp.concatenate([jnp.zeros(1, bool), mirror])
        pad = jnp.concatenate([jnp.zeros_like(slots[:1]), pad])
        if walls.mirrors:
            points, on_mirror = self._unfolded(points, segments, mirror)
            placed = placed & on_mirror
        return points, segments, mirror, pad, placed

    def _bounce(self, slot: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        """Whether a slot is a mirror's bounce, its pad, and the segment that it then is on."""
        past = slot - self.walls.total
        bounce = jnp.floor(past)
        segment = jnp.clip(bounce, 0, self.walls.count - 1).astype(jnp.int32)
        return (bounce >= 0) & self.walls.mirrors, past - bounce, segment

    def _unfolded(self, points: Vector, segments: Array, mirror: Array) -> tuple[Vector, Array]:
        """The points with the mirrors' bounces where the images say they are, and whether each is on its mirror."""
        walls, k = self.walls, self.edges
        at = [jax.tree.map(lambda a, i=i: a[i], points) for i in range(k + 1)]
        frames = [walls.frame(segments[i]) for i in range(k + 1)]
        starts = [walls.point(segments[i], jnp.zeros_like(walls.total)) for i in range(k + 1)]
        images = list(at)
        for i in reversed(range(1, k)):
            images[i] = where(mirror[i], walls.image(segments[i], images[i + 1]), at[i])
        placed = [jnp.ones((), bool)] * k + [~mirror[k]]
        for i in range(1, k):
            ray = images[i] - at[i - 1]
            across = ray.dot(frames[i].normal)
            far = (starts[i] - at[i - 1]).dot(frames[i].normal) / jnp.where(across == 0, 1, across)
            bounce = at[i - 1] + ray * far
            along = (bounce - starts[i]).dot(frames[i].tangent)
            inside = (along >= 0) & (along <= walls.at(walls.length, segments[i]))
            placed[i] = ~mirror[i] | (inside & (far > 0) & (far < 1) & (across != 0))
            at[i] = where(placed[i], where(mirror[i], bounce, at[i]), starts[i])
        return jax.tree.map(lambda *a: jnp.stack(a), *at), jnp.stack(placed)

    def log_eye(self, g: Geometry) -> Float[Array, " vertices"]:
        """Log of the density of each vertex given those before it, when walking from the sensor."""
        first = jnp.where(g.placed[0], self.sensor.log_place(self.walls, g.segment[0]), -jnp.inf)
        direction = self.sensor.log_density(_first(g.out))
        segment, coming, out, mirror = g.between()
        turns = jax.vmap(partial(log_density, self.walls))(segment, coming, out, mirror)
        steps = log_or_dark(jnp.abs(g.coming.up)) - jnp.log(g.from_eye)
        return jnp.concatenate([first[None], jnp.where(g.clear, _chain(direction, turns, steps, mirror), -jnp.inf)])

    def log_lamp(self, g: Geometry) -> Float[Array, " vertices"]:
        """Log of the density of each vertex given those after it, when walking from the lamps.

        A lamp is chosen by its length, and left with density cos(theta) / 2.
        """
        on_lamp = self.walls.at(self.walls.emission, g.segment[-1]) > 0
        last = jnp.where(on_lamp & g.placed[-1], -jnp.log(lamps(self.walls)[-1]), -jnp.inf)
        segment, coming, out, mirror = g.between()
        turns = jax.vmap(partial(log_density, self.walls))(segment, out, coming, mirror)
        steps = log_or_dark(jnp.abs(g.out.up)) - jnp.log(g.from_light)
        factors = _chain(log_or_dark(g.coming.up[-1] / 2), turns[::-1], steps[::-1], mirror[::-1])[::-1]
        return jnp.concatenate([jnp.where(g.clear, factors, -jnp.inf), last[None]])

    def log_light(self, g: Geometry) -> Scalar:
        """Log f: the sensor's response, times f_r G along the path, times L_e."""
        walls = self.walls
        total = self.sensor.log_place(walls, g.segment[0]) + self.sensor.log_response(_first(g.out))
        segment, coming, out, mirror = g.between()
        scattered = log_or_dark(jax.vmap(partial(brdf, walls))(segment, coming, out) * out.up)
        steps = log_or_dark(g.coming.up) - jnp.log(g.from_eye)
        front = (coming.up > 0) & (out.up > 0)
        mirrored = log_or_dark(jnp.where(front, jax.vmap(partial(walls.at, walls.mirror))(segment), 0))
        inner = jnp.where(mirror, mirrored, scattered + steps[:-1])
        total = total + jnp.sum(inner) + steps[-1] + log_or_dark(walls.at(walls.emission, g.segment[-1]))
        return jnp.where(jnp.all(g.clear), total, -jnp.inf)


class Light(Target):
    """f of `Paths`: its integral over the x that arrive in a pixel, times the number of pixels, is the pixel."""

    paths: Paths

    def __check_init__(self):
        require_instance(self.paths, Paths, "Light: the paths")

    @property
    def domain(self) -> Corners:
        return self.paths.corners

    def log_f(self, x: Float[Array, " d"]) -> Scalar:
        return self.paths.log_light(self.paths.geometry(x))

    def bin_masses(self, edges: Any) -> np.ndarray:
        raise ValueError("Light: the exact image is not the target's to tell; see flatland.reference.image")


class LightTimes(Target):
    """f times a factor, for chains that sample more of some paths than of others, or for a part of the light.

    `Bidirectional` finds it at the price of the light.
    """

    light: eqx.AbstractVar[Light]

    @abc.abstractmethod
    def log_factor(self, x: Float[Array, " d"]) -> Scalar:
        """Log of the factor; -inf where nothing of the light is left."""

    @property
    def domain(self) -> Corners:
        return self.light.domain

    def log_f(self, x: Float[Array, " d"]) -> Scalar:
        return self.light.log_f(x) + self.log_factor(x)

    def bin_masses(self, edges: Any) -> np.ndarray:
        return self.light.bin_masses(edges)


def lamps(walls: Walls) -> Float[Array, " ends"]:
    """The ends of the lamps laid end to end: of every segment; what is no lamp has no length there."""
    lengths = jnp.where(jnp.asarray(walls.emission) > 0, jnp.asarray(walls.length), 0)
    return jnp.concatenate([jnp.zeros_like(lengths[:1]), jnp.cumsum(lengths)])


def on_a_lamp(walls: Walls, number: Scalar) -> tuple[Index, Scalar]:
    """Which lamp, chosen by its length, and how far along it."""
    ends = lamps(walls)
    # Their sum itself, to which a product may round, is the end of segments that have no length here.
    most = ends[-1] * (1 - jnp.finfo(ends.dtype).epsneg)
    segment, inside = choose(ends, limit(number * ends[-1], 0, most))
    return segment, inside * walls.at(walls.length, segment)


def _first(directions: Local) -> Local:
    return Local(directions.along[0], directions.up[0])


def _behind(distance: Float[Array, " k"], mirror: Bool[Array, " bounces"]) -> Float[Array, " k"]:
    """The way to each vertex from the last one that is no mirror's bounce."""
    ways = [distance[0]]
    for i in range(len(mirror)):
        ways.append(distance[i + 1] + jnp.where(mirror[i], ways[-1], 0))
    return jnp.stack(ways)


def _chain(first: Scalar, turns: Array, steps: Array, mirror: Array) -> Float[Array, " k"]:
    """What each vertex's density is made of, from the direction in which the last wall before it was left.

    Of a mirror's bounce it is the mirror's probability; the direction that led there counts at the next wall.
    """
    direction, factors = first, []
    for i in range(len(turns)):
        factors.append(jnp.where(mirror[i], turns[i], direction + steps[i]))
        direction = jnp.where(mirror[i], direction, turns[i])
    return jnp.stack([*factors, direction + steps[-1]])


def _shortest(dtype: Any) -> Any:
    """A length under any that matters, whose square is a number."""
    return jnp.finfo(dtype).tiny ** 0.5


def log_or_dark(value: Float[Array, "..."]) -> Float[Array, "..."]:
    """The logarithm; -inf, with a derivative that is a number, where the value is not positive."""
    positive = value > 0
    return jnp.where(positive, jnp.log(jnp.where(positive, value, 1)), -jnp.inf)


def _examples() -> dict[str, Light]:
    from mcmc1d.flatland.scenes import scene

    return {"light": Light(Paths(scene("box"), 2))}


EXAMPLES = Examples(_examples)
