"""Rays and what they meet, at the ends of walls; where a path arrives on the film by way of mirrors."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.flatland import Bidirectional, Light, Material, Paths, Pinhole, Scene, Segment, Wall
from mcmc1d.flatland.geometry import Vector, Walls
from mcmc1d.flatland.plane import cross
from mcmc1d.flatland.scenes import polygon
from mcmc1d.numerics import cast

LAMP = Material(1.0)
EYE = Pinhole((0.0, 1.0), (1.0, 0.0), 0.6)


def slit(width):
    """A lamp behind a wall with a slit, the wall's other ends touching nothing."""
    below, above = Segment((2, 0), (2, 1 - width / 2)), Segment((2, 1 + width / 2), (2, 2))
    return Scene("slit", (below, above, Segment((4, 0), (4, 2), LAMP)), EYE)


def looked(scene, aims, look):
    """Of each ray from the pinhole at (0, 1) to x = 2, y = `aims`, in float32, what `look` says of it."""
    (x, y), aims = scene.centre, np.asarray(aims)
    eye = Vector(jnp.float32(0 - x), jnp.float32(1 - y))
    ways = Vector(jnp.full(aims.shape, 2 - x, jnp.float32), jnp.asarray(aims - y, jnp.float32)) - eye
    return jax.tree.map(np.asarray, _looked(look, cast(Walls(scene), jnp.float32), eye, ways))


@eqx.filter_jit
def _looked(look, walls, eye, ways):
    return jax.vmap(lambda way: look(walls, eye, way))(ways)


def hit(walls, eye, way):
    """The segment that is met first."""
    return walls.meet(eye, way, -1).segment


def place_of_hit(walls, eye, way):
    """That segment, and where."""
    hit = walls.meet(eye, way, -1)
    return hit.segment, walls.point(hit.segment, hit.along)


def stopped(walls, eye, way):
    """Whether something stands between the eye and a point that is twice as far."""
    return walls.blocked(eye, eye + way * 2.0, -1, -1)


def met(scene, aims):
    """The segments that those rays meet first."""
    return looked(scene, aims, hit)


@pytest.mark.parametrize("width", [2e-2, 2e-3, 1e-4, 2e-5])
def test_what_stands_free_is_as_long_as_it_is(width):
    """A ray passes a slit that is a hundred-thousandth of the scene: walls were longer by half of that, at each end."""
    across = np.linspace(-0.45, 0.45, 91) * width
    assert (met(slit(width), 1 + across) == 2).all()
    assert (met(slit(width), 1 + np.array([-0.6, 0.6]) * width) == [0, 1]).all()


JOINTS = {
    "in line": [((-0.7, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.6, 0.0))],
    "corner": [((-0.7, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.1, 0.6))],
    "T": [((-0.7, 0.0), (0.6, 0.0)), ((0.0, 0.0), (0.1, 0.6))],
    "corner of three": [((-0.7, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.1, 0.6)), ((0.0, 0.0), (0.5, -0.4))],
}


def turned(pairs):
    """Scenes of walls that meet at (2, 1.1), turned by many angles, with a lamp beyond."""
    for angle in np.linspace(0.1, 0.1 + 2 * np.pi, 48, endpoint=False):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        ends = [[tuple(turn @ end + [2.0, 1.1]) for end in pair] for pair in pairs]
        walls = [Segment(start, end) for start, end in ends]
        yield Scene("joint", (*walls, Segment((5.0, 0.0), (5.0, 3.0), LAMP)), EYE)


AIMS = 1.1 + 1e-7 * np.arange(-3, 4)
"""At the joint, and roundings beside it."""


@pytest.mark.parametrize("name", JOINTS)
def test_nothing_passes_where_walls_touch(name):
    """At the very point where they do, and a rounding beside it, rays meet one of them, and none is looked past."""
    for scene in turned(JOINTS[name]):
        assert (scene.touching == np.isclose(scene.ends, [2.0, 1.1]).all(-1)).all()
        assert (met(scene, AIMS) < len(JOINTS[name])).all()
        assert looked(scene, AIMS, stopped).all()


def test_what_is_met_beside_a_joint_lies_clear_of_the_other_wall():
    """In a hollow of ten degrees a point that is rounded to lie behind the other wall would have left the room."""
    hits = 0
    for scene in turned([((-0.7, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.6, 0.1))]):
        segment, point = looked(scene, AIMS, place_of_hit)
        on = segment < 2  # where a ray grazes both, it may pass beside them
        other = 1 - segment[on]
        start, along = scene.ends[:, 0] - scene.centre, scene.ends[:, 1] - scene.ends[:, 0]
        assert (cross(along[other], np.stack([point.x, point.y], 1)[on] - start[other]) > 0).all()
        hits += on.sum()
    assert hits > 300


def test_what_touches_is_hardly_longer_than_it_is():
    """A block's face of a thousandth of the scene, against the far wall: 2e-6 of the scene beyond each end, it ends."""
    size = 1e-3
    corners = [(2.0, 1 - size), (2.0, 1 + size), (2.1, 1 + size), (2.1, 1 - size)]
    scene = Scene("lamp", (*polygon(corners, LAMP), Segment((4.0, 0.0), (4.0, 2.0), LAMP)), EYE)
    across = np.linspace(-0.999, 0.999, 101)
    assert (met(scene, 1 + size * across) == 0).all()
    beyond = 2 * 2e-6 * np.array([-1, 1])
    assert (met(scene, 1 + size * np.array([-1, 1]) + beyond) == 4).all()


@pytest.mark.parametrize("sensor", ["pinhole", "wall"])
def test_a_path_arrives_where_its_first_edge_leads(sensor):
    """By way of none, one and two mirrors: the film's coordinate is that of the direction in which the path leaves."""
    corners = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.5, 1.2), (1.5, 2.0), (0.0, 2.0)]
    sides = polygon(corners, [Material(1, lambert=0.3, mirror=0.6)] * 6)
    named = tuple(Segment(side.start, side.end, side.material, f"w{k}") for k, side in enumerate(sides))
    eye = Pinhole((0.5, 0.5), (1, 0.3), 0.7, 4) if sensor == "pinhole" else Wall("w1", 4)
    paths = Paths(Scene("room", named, eye), 4)
    with jax.enable_x64(True):
        paths = cast(paths, jnp.float64)
        family = Bidirectional(paths, (5,))
        u = jnp.asarray(np.random.default_rng(0).random((4096, family.dim_u)))
        x = jax.vmap(lambda u: family.forward(jnp.int32(0), u)[0])(u)
        lit = np.asarray(jax.vmap(Light(paths).log_f)(x)) > -np.inf
        film = np.asarray(jax.vmap(paths.film)(x))
        geometry = jax.vmap(paths.geometry)(x)
        first = jax.tree.map(lambda a: a[:, 0], geometry.out)
        expected = np.asarray(jax.vmap(lambda x, out: paths.sensor.film(paths.walls, x[0], out))(x, first))
    bounces = np.cumprod(np.asarray(geometry.mirror)[:, 1:], axis=1).sum(1)[lit]
    assert (np.bincount(bounces, minlength=3)[:3] > 50).all()
    np.testing.assert_allclose(film[lit], expected[lit], atol=1e-9)
