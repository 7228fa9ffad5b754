"""Beams of light that are narrower than a mesh's nodes are apart: found along a wall sensor, told of elsewhere."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad

from mcmc1d.flatland import reference
from mcmc1d.flatland.reference import shadows
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall

BLACK, GREY = Material(), Material(lambert=0.5)


def slit(x, wall, sensor, pieces=1):
    """A floor under a black screen of two parts, 0.002 apart at x, and a lamp of 0.05 under a ceiling in pieces."""
    ends = [4 * (1 - k / pieces) for k in range(pieces + 1)]
    lamp = Segment((2.05, 1.9), (2.0, 1.9), Material(emission=100.0))
    screens = Segment((0.01, 0.05), (x, 0.05)), Segment((x + 0.002, 0.05), (3.99, 0.05))
    ceiling = [Segment((a, 2), (b, 2)) for a, b in itertools.pairwise(ends)]
    return Scene("slit", (Segment((0, 0), (4, 0), wall, "floor"), lamp, *screens, *ceiling), sensor)


def through(x):
    """The irradiance of the whole floor of that beam: from each point of the lamp the angle of the slit, by cosine."""

    def flux(at):
        near, far = (np.arctan((end - at) / 1.85) for end in (x, x + 0.002))
        return 100 * (np.sin(far) - np.sin(near))

    return quad(flux, 2.0, 2.05, epsabs=1e-14)[0]


@pytest.mark.parametrize("x", [0.5003, 1.3217, 2.3])
@pytest.mark.parametrize("pieces", [1, 62])
def test_a_beam_between_the_nodes_lights_a_wall_sensor(x, pieces):
    """From 60 segments on, of these beams some fell between all nodes: the image was zero, its error too."""
    found = reference.image(slit(x, BLACK, Wall("floor", 4), pieces), 1)
    assert abs(4 * found.values.mean() / through(x) - 1) < 1e-9
    assert found.errors.max() < 1e-9 * found.values.max()


@pytest.mark.parametrize("x", [0.5003, 1.3217, 2.3])
def test_a_beam_between_the_nodes_of_a_diffuse_wall_is_in_the_errors(x):
    eye = Pinhole((x - 0.01, 0.03), (0.2, -1), 1.2, 4)
    right, large = (reference.image(slit(x, GREY, eye, pieces), 2) for pieces in (1, 62))
    wrong = np.abs(large.values - right.values).max(1)
    assert wrong[1] > 0.01 * right.values[1].max()  # the nodes do miss it, or the test has nothing to find
    assert np.all(wrong <= large.errors[:, 0] + right.errors[:, 0])
    assert large.errors[1, 0] < 10 * right.values[1].max()


def test_a_beam_by_way_of_mirrors_lights_a_wall_sensor():
    """Its shadow lines by way of many mirrors were dropped; each image of 4 pixels is the mean of 64 narrow ones'."""

    def scene(pixels):
        walls = [
            Segment((0, 0), (3, 0), Material(mirror=0.9)),
            Segment((3, 0), (3, 1), BLACK, "seen"),
            Segment((3, 1), (0, 1), Material(mirror=0.8)),
            Segment((0, 0.42), (0, 0.4), Material(emission=5.0)),
            *(Segment((2.8, a), (2.8, b)) for a, b in ((0, 0.317), (0.318, 1))),
        ]
        return Scene("mirrors", tuple(walls), Wall("seen", pixels))

    few, many = reference.image(scene(4), 6), reference.image(scene(256), 6)
    narrow = many.values.reshape(6, 4, 64).mean(2)
    assert narrow[5].mean() == pytest.approx(2.2052e-6, rel=1e-4)
    assert np.all(np.abs(few.values - narrow) <= few.errors + many.errors[:, :1])
    assert np.all(few.errors[:, 0] < 1e-9 * few.values.max(1))


def test_where_shadow_lines_are_too_many_the_errors_hold_all_the_light_there_may_be(monkeypatch):
    """On a wall sensor, and on a diffuse wall that is looked at."""
    eye = Pinhole((1.3117, 0.03), (0.2, -1), 1.2, 4)
    scenes = slit(1.3217, BLACK, Wall("floor", 4)), slit(1.3217, GREY, eye, 62)
    all_of_them = [reference.image(scene, 2).errors.max() for scene in scenes]
    monkeypatch.setattr(shadows, "MOST", 4)
    few = [reference.image(scene, 2).errors.max() for scene in scenes]
    assert few[0] > 1e3 * all_of_them[0]
    assert few[1] > 2 * all_of_them[1]
