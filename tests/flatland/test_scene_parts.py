"""What scenes are made of: which way they face, what is refused, and that neither place nor unit of length matters."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.flatland.integrators import integrate
from mcmc1d.flatland.integrators.base import multiplexed
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.reference.rays import Geometry
from mcmc1d.flatland.scattering import Local
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall
from mcmc1d.flatland.scenes import block, catalogue, polygon, scene
from mcmc1d.weights import Power


def heights(of, point):
    """How far in front of each segment a point is."""
    return np.sum((np.array(point) - of.ends[:, 0]) * Geometry.of(of).normal, -1)


def test_a_polygon_and_a_block_face_the_right_way():
    grey, lamp = Material(lambert=0.5), Material(1.0)
    inside = polygon([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], [grey, grey, lamp])
    assert [s.material for s in inside] == [grey, grey, lamp]
    room = Scene("triangle", tuple(inside), Pinhole((0.2, 0.2), (1.0, 1.0)))
    assert np.all(heights(room, (0.2, 0.2)) > 0)
    for turns in range(4):
        outside = block((5.0, 5.0), (2.0, 1.0), [lamp, grey, grey, grey], turns)
        solid = Scene("block", tuple(outside), Pinhole((0.2, 0.2), (1.0, 1.0)))
        assert np.all(heights(solid, (5.0, 5.0)) < 0)
        expected = [(-1, 0), (0, -1), (1, 0), (0, 1)][turns]  # the lamp's front, at first on the left
        assert np.allclose(Geometry.of(solid).normal[0], expected)


def test_bad_names_and_bad_parts_are_refused():
    with pytest.raises(ValueError, match=r"no scene 'ofice'; did you mean 'office'\? known: box, door"):
        scene("ofice")
    with pytest.raises(ValueError, match="3 sides need as many materials, not 2"):
        polygon([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], [Material()] * 2)
    assert scene("box") == catalogue()["box"]()


FLOOR = Segment((0.0, 0.0), (4.0, 0.0), Material(1.0))
EYE = Pinhole((1.0, 1.0), (0.0, -1.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Material(1e20), "from 1e-9 to 1e9"),
        (lambda: Wall("floor", pixels=0), "pixels must be a whole number"),
        (
            lambda: Scene("near", (FLOOR, Segment((1.0, 0.0), (1.00001, 1e-5))), EYE),
            "has no length.*lost in single precision",
        ),
        (lambda: Scene("eye", (FLOOR,), replace(EYE, position=(2.0, 1e-8))), "stands in segment 0"),
        (lambda: Paths(Scene("far", (FLOOR,), replace(EYE, position=(2.0, 1e4))), 1), "100 times the walls' 4 away"),
        (
            lambda: Paths(Scene("thin", (FLOOR,), replace(EYE, half_angle=1e-5)), 1),
            "a pixel of the pinhole is .* wide .*, which single precision does not see well",
        ),
        (lambda: Scene("laid", (moved(FLOOR, 0.3), Segment((1.0, 0.1 + 0.2), (2.0, 0.1 + 0.2))), EYE), "overlap"),
        (
            lambda: Scene("gap", (FLOOR, Segment((2.0, 1e-7), (1.0, 1e-7), Material(1.0))), EYE),
            "segment 1 and segment 0 are 1e-07 apart at .*which single precision does not see",
        ),
        (lambda: Scene("far", (moved(FLOOR, 1e5),), EYE), "from the origin; for single precision"),
        (lambda: integrate(jax.random.key(0), "pt", scene("box"), lengths=[2, 2], samples=4), "different numbers"),
        (lambda: multiplexed(Paths(scene("box"), 2), None, Power(0.5)), "beta must be 1 at least"),
    ],
)
def test_what_single_precision_or_sense_does_not_take_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def moved(segment, up):
    (a, b), (c, d) = segment.start, segment.end
    return replace(segment, start=(a, b + up), end=(c, d + up))


@pytest.mark.parametrize("name", ["box", "mirror_caustic"])
def test_a_scene_far_from_the_origin_has_the_same_walls(name):
    """To a millionth of what single precision would leave of them there."""
    near, by = scene(name), np.array([250.0, -170.0])
    segments = tuple(replace(s, start=tuple(by + s.start), end=tuple(by + s.end)) for s in near.segments)
    sensor = near.sensor
    if isinstance(sensor, Pinhole):
        sensor = replace(sensor, position=tuple(by + sensor.position))
    here, there = (Paths(one, 3) for one in (near, Scene("far", segments, sensor)))
    both = (jax.tree.leaves((paths.walls, paths.sensor)) for paths in (here, there))
    for a, b in zip(*both, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-11)
    x = jnp.full(here.dim, 0.3)
    np.testing.assert_allclose(there.vertices(x) - here.vertices(x), np.broadcast_to(by, (4, 2)), atol=1e-4)


def test_what_a_wide_pinhole_sees_at_one_end_is_not_at_the_other():
    """Over 179.9 degrees a direction is rounded by more than a pixel: it was taken for one beside the film, at 0."""
    camera = Paths(Scene("wide", (FLOOR,), replace(EYE, half_angle=1.5698)), 1).sensor
    for end in (-1.0, 1.0):
        for up in (1e-5, 0.0, -1e-5):
            beyond = Local(jnp.float32(end * np.sqrt(1 - up * up)), jnp.float32(up))
            assert camera.direction_number(beyond) == pytest.approx((1 + end) / 2, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-2, 1e3])
def test_a_scene_looks_the_same_in_another_unit_of_length(size):
    """Of nine edges, whose products of densities would leave float32: the same numbers make the same paths."""
    box = scene("box")
    large = tuple(
        replace(s, start=tuple(size * np.array(s.start)), end=tuple(size * np.array(s.end))) for s in box.segments
    )
    other = Scene("other", large, replace(box.sensor, position=tuple(size * np.array(box.sensor.position))))
    means = [integrate(jax.random.key(0), "bdpt", of, lengths=[9], samples=4096).total.mean() for of in (box, other)]
    assert means[1] == pytest.approx(means[0], rel=0.02)
    assert means[0] > 0


def test_walls_that_lie_on_each_other_but_for_rounding_overlap():
    """Parallel to 5e-11, and 2e-10 apart at most: they passed for touching."""
    lamp = Segment((0.0, 2.0), (4.0, 2.0), Material(1.0))
    walls = Segment((0.0, 0.0), (4.0, 0.0)), Segment((1.0, 1e-10), (3.0, 2e-10))
    with pytest.raises(ValueError, match="segment 0 and segment 1 cross or overlap"):
        Scene("room", (*walls, lamp), Pinhole((2.0, 1.0), (0.0, 1.0)))
