"""One evaluation of (index, u) for a chain: the path, its light and all densities, with each of its edges met once.

The same numbers as `Bidirectional.forward`, `Bidirectional.log_probs` and `Light.log_f` find one after the other, which
walk from both ends all the way and then look at the finished path again. Here the two walks are one: technique (s, t)
casts t - 1 rays from the sensor and goes on from the lamp, k - 1 rays in all (of k traced: one is thrown away).
The edge that joins is the only one that is looked along for something in the way. Every number is one of a path's,
none an array over its vertices: then a batch of paths is the only axis, the last in memory, and what is done to a path
is one expression.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from mcmc1d.flatland.geometry import Frame, Vector, Walls, where
from mcmc1d.flatland.paths import Paths, lamps, log_or_dark, on_a_lamp
from mcmc1d.flatland.scattering import Local, brdf, density, lambert_direction, local, scatter
from mcmc1d.numerics import pick
from mcmc1d.types import Array, Bool, Float, Index, Scalar


class Vertex(NamedTuple):
    """A vertex of a path where it was met."""

    point: Vector
    frame: Frame
    segment: Index
    number: Scalar
    """In x."""
    mirror: Bool[Array, ""]


class Evaluated(NamedTuple):
    """A sample, and what the chain's density is made of."""

    x: Float[Array, " d"]
    v: Float[Array, " k"]
    log_f: Scalar
    log_p: tuple[Scalar, ...]


def evaluate(paths: Paths, lit: Paths, lengths: Sequence[int], index: Index, u: Float[Array, " m"]) -> Evaluated:
    """The sample of technique `index`, one of t = `lengths`, by the numbers u; see `Bidirectional`.

    `lit` says what the light's walls emit and scatter, and `paths` where they are and how they are sampled: the same
    scene twice, unless its importance is another's.
    """
    sensor, k, m = paths.sensor, paths.edges, u.shape[0]
    t = pick([jnp.asarray(length, jnp.int32) for length in lengths], index)
    eye, eye_way = _eye_start(paths, u)
    lamp, lamp_way = _lamp_start(paths.walls, u)
    casts = _casts(paths, lengths, index, t, u, (eye, eye_way), (lamp, lamp_way))
    met = [jax.tree.map(lambda a, c=c: a[c], casts[0]) for c in range(k)]

    def arranged(t: int) -> tuple[Any, ...]:
        """The vertices of technique t in the path's order, and its v."""
        from_eye = [eye] * (t > 0) + met[: max(t - 1, 0)]
        s = k + 1 - t
        from_lamp = ([lamp] * (s > 0) + met[max(t - 1, 0) : max(t - 1, 0) + max(s - 1, 0)])[::-1]
        (eye_u, eye_v), (lamp_u, lamp_v) = reads(t, sensor.places), reads(s, 1)
        first = max(t - 1, 0)
        v = [casts[1][c] for c in range(eye_v)] + [u[n] for n in range(eye_u, m - lamp_u)]
        v += [casts[1][first + q] for q in range(lamp_v)][::-1]
        return tuple(from_eye + from_lamp), tuple(v)

    vertices, v = pick([arranged(length) for length in lengths], index)
    log_f, log_p = _light_and_densities(paths, lit, lengths, t, vertices)
    numbers = [vertex.number for vertex in vertices][1 - sensor.places :]
    return Evaluated(jnp.stack(numbers), jnp.stack(v) if v else jnp.zeros(0, u.dtype), log_f, log_p)


def reads(vertices: int, places: int) -> tuple[int, int]:
    """How many numbers a walk of so many vertices reads of u, and how many it keeps of them in v."""
    if vertices + places <= 1:
        return 0, 0
    if vertices + places == 2:
        return 1, 0
    return places + 2 * vertices - 3, vertices - 2


# --- walking --------------------------------------------------------------------------------------------------------


def _eye_start(paths: Paths, u: Float[Array, " m"]) -> tuple[Vertex, Vector]:
    walls, sensor = paths.walls, paths.sensor
    place = sensor.place(walls, u[0])
    point, segment = sensor.point(walls, place)
    frame, never = sensor.frame(walls, segment), jnp.zeros((), bool)
    vertex = Vertex(point, frame, jnp.asarray(segment, jnp.int32), place, never)
    return vertex, sensor.direction(u[sensor.places]).world(frame)


def _lamp_start(walls: Walls, u: Float[Array, " m"]) -> tuple[Vertex, Vector]:
    numbers = u[::-1]
    segment, along = on_a_lamp(walls, numbers[0])
    frame = walls.frame(segment)
    vertex = Vertex(
        walls.point(segment, along),
        frame,
        jnp.asarray(segment, jnp.int32),
        walls.slot(segment, along),
        jnp.zeros((), bool),
    )
    return vertex, lambert_direction(numbers[1] if len(numbers) > 1 else numbers[0]).world(frame)


def _casts(
    paths: Paths,
    lengths: Sequence[int],
    index: Index,
    t: Index,
    u: Float[Array, " m"],
    eye: tuple[Vertex, Vector],
    lamp: tuple[Vertex, Vector],
) -> tuple[Vertex, Float[Array, " casts"]]:
    """The k vertices that are met, those from the sensor first, then those from the lamp; and v at each."""
    walls, k, places, m = paths.walls, paths.edges, paths.sensor.places, u.shape[0]

    def pair(t: int, c: int) -> tuple[Scalar, Scalar]:
        """The numbers that choose the lobe and the direction where cast c has led; a last vertex needs none."""
        if c < t - 1:
            first, step = 1 + places + 2 * c, 1
        else:
            first, step = m - 3 - 2 * (c - max(t - 1, 0)), -1
        inside = min(first, first + step) >= 0 and max(first, first + step) < m
        return (u[first], u[first + step]) if inside else (u[0], u[0])

    pairs = [pick([pair(length, c) for length in lengths], index) for c in range(k)]
    lobe, turn = (jnp.stack(numbers) for numbers in zip(*pairs, strict=True))
    begins = jnp.maximum(t - 1, 0)  # the first cast from the lamp
    # The cast after which no direction is chosen; that from the sensor ends at t - 2.
    final = jnp.where((t == 0) | (t == k + 1), k - 1, k - 2)

    first: Any = t >= 2

    def cast(carry: tuple[Vector, Vector, Index], slot: Any) -> tuple[Any, tuple[Vertex, Scalar]]:
        c, u_lobe, u_direction = slot
        origin, way, leaving = where(jnp.equal(c, begins), (lamp[0].point, lamp[1], lamp[0].segment), carry)
        hit = walls.meet(origin, way, leaving)
        frame = walls.frame(hit.segment)
        x, y = walls.at(walls.start[:, 0], hit.segment), walls.at(walls.start[:, 1], hit.segment)
        point = Vector(x, y) + frame.tangent * hit.along
        back = origin - point
        distance = jnp.maximum(back.length(), jnp.finfo(walls.dtype).tiny ** 0.5)
        turned = scatter(walls, hit.segment, local(frame, back * (1 / distance)), u_lobe, u_direction)
        number, mirror = walls.slot(hit.segment, hit.along), jnp.zeros((), bool)
        if walls.mirrors:
            mirror = turned.mirror & (c != t - 2) & (c != final)
            number = jnp.where(mirror, walls.bounce(hit.segment, u_direction), number)
        vertex = Vertex(point, frame, hit.segment, number, mirror)
        return (point, turned.out.world(frame), hit.segment), (vertex, turned.v)

    start = where(first, (eye[0].point, eye[1], eye[0].segment), (lamp[0].point, lamp[1], lamp[0].segment))
    return jax.lax.scan(cast, start, (jnp.arange(k, dtype=jnp.int32), lobe, turn))[1]


# --- looking at the path --------------------------------------------------------------------------------------------


def _light_and_densities(
    paths: Paths, lit: Paths, lengths: Sequence[int], t: Index, vertices: Sequence[Vertex]
) -> tuple[Scalar, tuple[Scalar, ...]]:
    """Log of f, and of the density of every technique: products of what each vertex contributes."""
    walls, sensor, k = paths.walls, paths.sensor, paths.edges
    steps = [there.point - here.point for here, there in pairwise(vertices)]
    distance = [jnp.maximum(step.length(), jnp.finfo(walls.dtype).tiny ** 0.5) for step in steps]
    ways = [step * (1 / far) for step, far in zip(steps, distance, strict=True)]
    out = [local(vertex.frame, way) for vertex, way in zip(vertices, ways, strict=False)]
    coming = [Local(0.0, 0.0)] + [
        local(vertex.frame, way * -1.0) for vertex, way in zip(vertices[1:], ways, strict=True)
    ]
    visible = _joined(walls, t, vertices)
    # In lengths of the sky, so that no product of many factors vanishes because a scene is measured in millimetres.
    unit = walls.at(walls.length, walls.count - 1)
    from_eye, from_lamp = _unfolded(walls, [far / unit for far in distance], vertices)
    log_unit = jnp.log(unit)
    inner = range(1, k)

    def turn(j: int, a: Local, b: Local) -> Scalar:
        return density(walls, vertices[j].segment, a, b, vertices[j].mirror)

    direction = jnp.exp(sensor.log_density(out[0]))
    eye = [jnp.exp(sensor.log_place(walls, vertices[0].segment) + sensor.places * log_unit)]
    for j in range(1, k + 1):
        step = direction * jnp.abs(coming[j].up) / from_eye[j - 1]
        if j < k:
            turned, mirror = turn(j, coming[j], out[j]), vertices[j].mirror
            eye.append(jnp.where(mirror, turned, step))
            direction = jnp.where(mirror, direction, turned)
        else:
            eye.append(step)
    emits = walls.at(walls.emission, vertices[k].segment)
    lamp = [jnp.where(emits > 0, unit / lamps(walls)[-1], 0)]
    direction = jnp.maximum(coming[k].up, 0) / 2
    for j in range(k - 1, -1, -1):
        step = direction * jnp.abs(out[j].up) / from_lamp[j]
        if j > 0:
            turned, mirror = turn(j, out[j], coming[j]), vertices[j].mirror
            lamp.append(jnp.where(mirror, turned, step))
            direction = jnp.where(mirror, direction, turned)
        else:
            lamp.append(step)
    lamp = lamp[::-1]
    sensed = lit.sensor.log_response(out[0]) + lit.sensor.log_place(walls, vertices[0].segment)
    f = jnp.exp(sensed + sensor.places * log_unit) * walls.at(lit.walls.emission, vertices[k].segment)
    f = f * jnp.maximum(coming[k].up, 0) / from_eye[k - 1]
    for j in inner:
        front = jnp.maximum(coming[j].up, 0) * jnp.maximum(out[j].up, 0) > 0
        scattered = brdf(lit.walls, vertices[j].segment, coming[j], out[j]) * out[j].up * coming[j].up / from_eye[j - 1]
        if walls.mirrors:
            mirrored = walls.at(lit.walls.mirror, vertices[j].segment)
            scattered = jnp.where(vertices[j].mirror, mirrored, scattered)
        f = f * jnp.where(front, scattered, 0)
    mirror = [vertex.mirror for vertex in vertices]
    each = _products(lengths, t, eye, lamp, visible, mirror, walls)
    # Per length again, for each vertex but the mirrors' bounces.
    bounces = sum(jnp.asarray(bounce).astype(walls.dtype) for bounce in mirror) if walls.mirrors else 0
    per_length = (paths.dim - bounces) * log_unit
    return log_or_dark(jnp.where(visible, f, 0)) - per_length, tuple(log_or_dark(p) - per_length for p in each)


def _products(
    lengths: Sequence[int],
    t: Index,
    eye: Sequence[Scalar],
    lamp: Sequence[Scalar],
    visible: Bool[Array, ""],
    mirror: Sequence[Bool[Array, ""]],
    walls: Walls,
) -> list[Scalar]:
    """The density of each technique: of the vertices before t from the sensor, of the others from the lamp.

    A path whose joint is blocked is made by the technique that joins there and by no other.
    """
    before, after = [jnp.ones_like(eye[1])], [jnp.ones_like(eye[1])]
    for factor in eye:
        before.append(before[-1] * factor)
    for factor in lamp[::-1]:
        after.append(after[-1] * factor)
    found = []
    for length in lengths:
        p = before[length] * after[len(lamp) - length]
        p = jnp.where(visible | (t == length), p, 0)
        if walls.mirrors:
            joined = mirror[max(length - 1, 0) : length + 1]
            bounces = joined[0] if len(joined) == 1 else joined[0] | joined[1]
            p = jnp.where(bounces, 0, p)
        found.append(p)
    return found


def _joined(walls: Walls, t: Index, vertices: Sequence[Vertex]) -> Bool[Array, ""]:
    """Whether nothing stands between the two walks; nothing does where one of them made all of the path."""
    k = len(vertices) - 1
    ends = [(vertices[j], vertices[j + 1]) for j in range(k)]
    here, there = pick(ends, t - 1)
    clear = (here.segment != there.segment) & ~walls.blocked(here.point, there.point, here.segment, there.segment)
    return clear | (t == 0) | (t == k + 1)


def _unfolded(
    walls: Walls, distance: Sequence[Scalar], vertices: Sequence[Vertex]
) -> tuple[Sequence[Scalar], Sequence[Scalar]]:
    """At the far end of each edge the way from the last vertex that is no mirror's bounce; and the same backwards."""
    if not walls.mirrors:
        return distance, distance
    forth, back = [distance[0]], [distance[-1]]
    for j in range(1, len(distance)):
        forth.append(distance[j] + jnp.where(vertices[j].mirror, forth[-1], 0))
    for j in range(len(distance) - 1, 0, -1):
        back.append(distance[j - 1] + jnp.where(vertices[j].mirror, back[-1], 0))
    return forth, back[::-1]
