"""The techniques of bidirectional path tracing as bijections u <-> (path, v): each end walks, and the ends are joined.

Technique (s, t) walks s vertices from a lamp and t from the sensor, s + t = k + 1 (Veach 1997, chapter 10; in the plane
p = p(theta) cos(theta') / r for each step). The eye's numbers are read from the front of u, the light's from its back;
what lies between is not read. A number chooses a lobe and another the direction at each vertex that is walked through;
v keeps the lobe's place, and of a mirror's bounce the number that was not needed is kept in the path itself.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance
from mcmc1d.examples import Examples
from mcmc1d.flatland.evaluation import evaluate, reads
from mcmc1d.flatland.geometry import Vector, Walls
from mcmc1d.flatland.paths import EXAMPLES as LIT
from mcmc1d.flatland.paths import Geometry, Light, LightTimes, Paths, lamps, on_a_lamp
from mcmc1d.flatland.scattering import Local, lambert_direction, lambert_number, local, scatter, unscatter
from mcmc1d.numerics import below_one, between, cast, pick
from mcmc1d.techniques import Family, Looked, Technique
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.techniques.family import apart
from mcmc1d.types import Array, Corners, Float, Index, Scalar


class Walk(NamedTuple):
    """Vertices with a number in x, in the order in which they are walked, the first included."""

    last: Float[Array, " n"]
    """The vertex's number in x if the walk ends there."""
    through: Float[Array, " n"]
    """The same if it goes on from there."""
    v: Float[Array, " n"]
    """What the choice of direction forgets, at the vertices that were met."""
    log_last: Float[Array, " n"]
    """Log of the density of the vertices up to this one, if the walk ends there."""


class _Step(NamedTuple):
    """Where a walk stands: a point, the segment it is on, a direction, log of its density, and the way since a wall."""

    point: Vector
    segment: Index
    direction: Vector
    log_direction: Scalar
    behind: Scalar
    log_p: Scalar
    """Log of the density of all vertices so far."""


class Bidirectional(Family):
    """Every (s, t) for paths of k edges, in the order of t: k + 1 techniques for a pinhole, k + 2 for a wall sensor.

    Infeasible ones, which would join at a mirror's bounce, have density zero there, and still count.
    """

    paths: Paths
    lengths: tuple[int, ...] = eqx.field(static=True)
    """t of each technique."""

    def __init__(self, paths: Paths, lengths: Sequence[int] | None = None):
        """`lengths`: which t, all of them unless given: (k + 1,) is path tracing without next event estimation."""
        require_instance(paths, Paths, "Bidirectional: the paths")
        known = paths.eye_lengths
        require(
            lengths is None or np.iterable(lengths),
            f"Bidirectional: lengths are several numbers t, such as ({lengths},), not {lengths!r}",
        )
        self.paths, self.lengths = paths, tuple(known if lengths is None else lengths)
        require(
            len(self.lengths) > 0 and set(self.lengths) <= set(known),
            f"Bidirectional: t is one of {list(known)} for paths of {paths.edges} edges, not {self.lengths}",
        )

    @property
    def members(self) -> tuple[Technique, ...]:
        return tuple(Joined(self.paths, t) for t in self.lengths)

    @property
    def dim_u(self) -> int:
        """2k - 1 for a pinhole, 2k for a wall sensor."""
        return _dim_u(self.paths)

    @property
    def dim_x(self) -> int:
        return self.paths.dim

    def forward(self, index: Index, u: Float[Array, " m"]) -> tuple[Array, Array, Scalar]:
        eye = walk_eye(self.paths, u, self.paths.edges + 1)
        light = walk_light(self.paths, u, self.paths.dim)
        return pick([_join(self.paths, t, eye, light, u) for t in self.lengths], index)

    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        g = self.paths.geometry(x)
        eye, light = _eye_numbers(self.paths, x, g, v), _light_numbers(self.paths, x, g, v)
        log_p = self.log_probs(x)
        options = [_disjoin(self.paths, t, eye, light, v) for t in self.lengths]
        return pick(options, index), pick(log_p, index)

    def log_probs(self, x: Float[Array, "..."]) -> tuple[Scalar, ...]:
        g = self.paths.geometry(x)
        eye, light = self.paths.log_eye(g), self.paths.log_lamp(g)
        return tuple(_log_density(t, g, eye, light) for t in self.lengths)

    def look(self, target: Any, index: Index, u: Float[Array, " m"]) -> Looked:
        """Of the light of the same space of paths all at once, each edge of the path met once; see `evaluation`."""
        light = target.light if isinstance(target, LightTimes) else target
        if not isinstance(light, Light):
            return apart(self, target, index, u)
        (paths, lit), u = _of_one_kind((self.paths, light.paths), u)
        found = evaluate(paths, lit, self.lengths, index, u)
        log_f = found.log_f + target.log_factor(found.x) if isinstance(target, LightTimes) else found.log_f
        return Looked(found.x, found.v, -pick(found.log_p, index), log_f, found.log_p)

    def probes(self, domain: Corners, count: int) -> np.ndarray:
        """Paths that the techniques make themselves: of a grid of the box, next to none would be one."""
        u = np.random.default_rng(0).random((count, self.dim_u))
        index = np.arange(count) % len(self.members)
        with jax.enable_x64(True):
            return np.asarray(_made(self, jnp.asarray(index), jnp.asarray(u)))


@eqx.filter_jit
def _made(family: Bidirectional, index: Array, u: Array) -> Array:
    return jax.vmap(lambda i, u: cast(family, u.dtype).forward(i, u)[0])(index, u)


class Joined(Technique):
    """One technique (s, t) of `Bidirectional`: t vertices from the sensor, and s = k + 1 - t from a lamp."""

    paths: Paths
    t: int = eqx.field(static=True)

    def __check_init__(self):
        known = self.paths.eye_lengths
        require(
            self.t in known,
            f"Joined: of the {self.paths.edges + 1} vertices of a path, t = {known[0]} to {self.paths.edges + 1} are "
            f"walked from the sensor, not {self.t}",
        )

    @property
    def dim_u(self) -> int:
        """As many as the hungriest of the path's techniques reads: the rest is v."""
        return _dim_u(self.paths)

    @property
    def support(self) -> Corners:
        return self.paths.corners

    def forward(self, u: Float[Array, " m"]) -> Forward:
        eye = walk_eye(self.paths, u, self.t)
        light = walk_light(self.paths, u, self.paths.edges + 1 - self.t)
        return _join(self.paths, self.t, eye, light, u)

    def inverse(self, x: Float[Array, " d"], v: Float[Array, " k"]) -> Inverse:
        g = self.paths.geometry(x)
        eye, light = _eye_numbers(self.paths, x, g, v), _light_numbers(self.paths, x, g, v)
        return _disjoin(self.paths, self.t, eye, light, v), self.log_prob(x)

    def log_prob(self, x: Float[Array, " d"]) -> Scalar:
        g = self.paths.geometry(x)
        return _log_density(self.t, g, self.paths.log_eye(g), self.paths.log_lamp(g))


# --- walking --------------------------------------------------------------------------------------------------------


def walk_eye(paths: Paths, u: Float[Array, " m"], vertices: int) -> Walk:
    """Up to so many vertices from the sensor, a pinhole counted but without a number of its own."""
    (walls, sensor), u = _of_one_kind((paths.walls, paths.sensor), u)
    place = sensor.place(walls, u[0])
    point, segment = sensor.point(walls, place)
    out = sensor.direction(u[sensor.places])
    direction, log_place = out.world(sensor.frame(walls, segment)), sensor.log_place(walls, segment)
    start = _Step(
        point, jnp.asarray(segment, jnp.int32), direction, sensor.log_density(out), jnp.zeros_like(place), log_place
    )
    walk = _walk(walls, start, u[1 + sensor.places :], vertices - 1)
    return _from(place, log_place, walk) if sensor.places else walk


def walk_light(paths: Paths, u: Float[Array, " m"], vertices: int) -> Walk:
    """Up to so many vertices from a lamp, chosen by its length; numbers are read from the back of u."""
    walls, u = _of_one_kind(paths.walls, u)
    numbers = u[::-1]
    segment, along = on_a_lamp(walls, numbers[0])
    place, log_place = walls.slot(segment, along), -jnp.log(lamps(walls)[-1])
    # A pinhole and a single edge leave no number for a direction, and none is needed.
    out = lambert_direction(numbers[1] if len(numbers) > 1 else numbers[0])
    log_direction = jnp.log(jnp.maximum(out.up / 2, jnp.finfo(u.dtype).tiny))
    point, direction = walls.point(segment, along), out.world(walls.frame(segment))
    start = _Step(point, jnp.asarray(segment, jnp.int32), direction, log_direction, jnp.zeros_like(place), log_place)
    return _from(place, log_place, _walk(walls, start, numbers[2:], vertices - 1))


def _of_one_kind(scene: Any, u: Array) -> tuple[Any, Array]:
    """Both in the wider precision of the two, so that a walk stays in one; a scene's first number is a float."""
    dtype = jnp.result_type(u, jnp.asarray(jax.tree.leaves(scene)[0]))
    return cast(scene, dtype), u.astype(dtype)


def _from(place: Scalar, log_place: Scalar, walk: Walk) -> Walk:
    """A walk with its first vertex, which was not met but chosen."""
    last, through = (jnp.concatenate([place[None], numbers]) for numbers in (walk.last, walk.through))
    return Walk(last, through, walk.v, jnp.concatenate([log_place[None], walk.log_last]))


def _walk(walls: Walls, start: _Step, numbers: Float[Array, " r"], count: int) -> Walk:
    """Follow a ray from wall to wall, so many times, with two numbers at each wall."""
    if count <= 0:
        nothing = jnp.zeros(0, start.log_p.dtype)
        return Walk(nothing, nothing, nothing, nothing)
    # The numbers of the last vertex, at which no direction is chosen, do not matter.
    pairs = jnp.resize(jnp.concatenate([numbers, jnp.full(2, 0.5, numbers.dtype)])[: 2 * count], (count, 2))
    return jax.lax.scan(lambda step, pair: _advance(walls, step, pair), start, pairs)[1]


def _advance(walls: Walls, step: _Step, pair: Float[Array, " 2"]) -> tuple[_Step, Walk]:
    """To the next wall, and the direction that is chosen there."""
    hit = walls.meet(step.point, step.direction, step.segment)
    point, frame = walls.point(hit.segment, hit.along), walls.frame(hit.segment)
    way = point - step.point
    distance = jnp.maximum(way.length(), jnp.finfo(walls.dtype).tiny ** 0.5)
    coming = local(frame, way * (-1 / distance))
    behind = step.behind + distance
    place = walls.slot(hit.segment, hit.along)
    cosine = jnp.maximum(jnp.abs(coming.up), jnp.finfo(walls.dtype).tiny)
    here = step.log_direction + jnp.log(cosine) - jnp.log(behind)
    turn = scatter(walls, hit.segment, coming, pair[0], pair[1])
    bounce = walls.bounce(hit.segment, pair[1])
    walked = Walk(place, jnp.where(turn.mirror, bounce, place), turn.v, step.log_p + here)
    onward = _Step(
        point,
        hit.segment,
        turn.out.world(frame),
        jnp.where(turn.mirror, step.log_direction, turn.log_p),
        jnp.where(turn.mirror, behind, 0),
        step.log_p + jnp.where(turn.mirror, turn.log_p, here),
    )
    return onward, walked


# --- joining --------------------------------------------------------------------------------------------------------


def _dim_u(paths: Paths) -> int:
    return 2 * paths.edges - 1 + paths.sensor.places


def _join(paths: Paths, t: int, eye: Walk, light: Walk, u: Float[Array, " m"]) -> Forward:
    s, places = paths.edges + 1 - t, paths.sensor.places
    eyes = t - 1 + places  # of the t vertices, those that have a number in x
    x, log_p = [], jnp.zeros((), u.dtype)
    for walk, count in ((eye, eyes), (light, s)):
        if count > 0:
            x.append(jnp.concatenate([walk.through[: count - 1], walk.last[count - 1 : count]]))
            log_p = log_p + walk.log_last[count - 1]
    if s > 0:
        x[-1] = x[-1][::-1]
    (eye_u, eye_v), (light_u, light_v) = reads(t, places), reads(s, 1)
    v = [eye.v[:eye_v], u[eye_u : len(u) - light_u], light.v[:light_v][::-1]]
    return jnp.concatenate(x), jnp.concatenate(v), -log_p


def _disjoin(paths: Paths, t: int, eye: Array, light: Array, v: Float[Array, " k"]) -> Float[Array, " m"]:
    s, places = paths.edges + 1 - t, paths.sensor.places
    (eye_u, eye_v), (light_u, light_v) = reads(t, places), reads(s, 1)
    return jnp.concatenate([eye[:eye_u], v[eye_v : len(v) - light_v], light[:light_u][::-1]])


def _eye_numbers(paths: Paths, x: Float[Array, " d"], g: Geometry, v: Float[Array, " k"]) -> Float[Array, " n"]:
    """The numbers of the longest walk from the sensor along a path, in the order in which they are read."""
    sensor, (segment, coming, out, mirror) = paths.sensor, g.between()
    first = [sensor.number(paths.walls, x[0])] * sensor.places
    first.append(sensor.direction_number(Local(g.out.along[0], g.out.up[0])))
    pairs = jax.vmap(partial(unscatter, paths.walls))(segment, coming, out, mirror, v, g.pad[1:-1])
    return jnp.concatenate([jnp.stack(first), jnp.stack(pairs, axis=-1).ravel()])


def _light_numbers(paths: Paths, x: Float[Array, " d"], g: Geometry, v: Float[Array, " k"]) -> Float[Array, " n"]:
    """The numbers of the longest walk from a lamp along a path."""
    walls, ends, (segment, coming, out, mirror) = paths.walls, lamps(paths.walls), g.between()
    inside = jnp.clip(walls.place(x[-1])[1] / walls.at(walls.length, g.segment[-1]), 0, 1)
    first = below_one(between(ends, g.segment[-1], inside) / ends[-1])
    direction = lambert_number(Local(g.coming.along[-1], g.coming.up[-1]))
    pairs = jax.vmap(partial(unscatter, walls))(segment, out, coming, mirror, v, g.pad[1:-1])
    return jnp.concatenate([jnp.stack([first, direction]), jnp.stack(pairs, axis=-1)[::-1].ravel()])


def _log_density(t: int, g: Geometry, eye: Float[Array, " vertices"], light: Float[Array, " vertices"]) -> Scalar:
    joined = g.mirror[max(t - 1, 0) : t + 1]
    return jnp.where(jnp.any(joined), -jnp.inf, jnp.sum(eye[:t]) + jnp.sum(light[t:]))


EXAMPLES = Examples(lambda: {"joined": Joined(LIT["light"].paths, 2)})
