"""Photon density estimation: right where irradiance is even, and blurred as predicted where it is not.

False-alarm rate 1e-5 for each image, over its pixels; what each would have caught is asserted with it.
"""

from itertools import pairwise

import jax
import numpy as np
import pytest

from mcmc1d.flatland import Material, Paths, Pinhole, Scene, Segment, Wall
from mcmc1d.flatland.integrators import Image, PhotonDensity
from mcmc1d.flatland.integrators.base import multiplexed
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.sampling import bootstrap
from mcmc1d.flatland.scenes import scene

pytestmark = pytest.mark.slow

ALARM = 1e-5
RADIUS, FLOOR, MIRROR = 0.3, 0.8, 0.9


def held(layer, values, errors=None):
    return compare(Image([layer]), np.asarray(values)[None], None if errors is None else errors[None], level=ALARM)


def test_nothing_is_blurred_where_irradiance_is_even():
    """The furnace with its mirrors, of two edges: a half in each pixel. Detectable: 6 %.

    The walls' ends are in the picture, where a kernel that is not cut off would lose light. Twin: one photon of a
    pass is not counted.
    """
    photons = PhotonDensity(radius=0.2, photons=8, cameras=8)
    found = photons.render(jax.random.key(0), scene("furnace").with_pixels(4), 2, 2**20)
    result = held(found, np.full(4, 0.5))
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.06, result.detectable
    assert not held(found._replace(scale=found.scale * 8 / 7), np.full(4, 0.5)).agrees


def between_mirrors(sensor):
    """A lamp that looks up at a plane mirror over the floor: past the mirror's end, by x = 2/3, it is dark."""
    floor = Segment((0, 0), (4, 0), Material(lambert=FLOOR), "floor")
    mirror = Segment((4, 2), (0, 2), Material(mirror=MIRROR))
    lamp = Segment((-0.6, 0.5), (-0.4, 0.5), Material(emission=10))
    return Scene("between_mirrors", (floor, mirror, lamp), sensor)


def blurred(fine, low, high):
    """The mean over [low, high] of what boxes of the radius make of the floor's irradiance, in narrow pixels."""
    edges = np.linspace(0, 4, len(fine) + 1)
    mass = np.concatenate([[0], np.cumsum(fine * np.diff(edges))])
    places = low + (high - low) * (np.arange(2000) + 0.5) / 2000
    left, right = np.maximum(places - RADIUS, 0), np.minimum(places + RADIUS, 4)
    return np.mean((np.interp(right, edges, mass) - np.interp(left, edges, mass)) / (right - left))


def test_what_no_walks_can_be_joined_to_make_is_blurred_over_the_radius():
    """Lamp, mirror, floor, and again the mirror before a pinhole; the floor by itself. Detectable: 8 %.

    Four pixels see 0.4 of the floor each, from 1.867 on down, in its image at height 3: one of them just beyond the
    edge of the light. Prediction: exact irradiance in 1/128 of the floor, averaged. Twin: the exact image.
    """
    fine = image(between_mirrors(Wall("floor", 256)), 2).values[1]
    center = 2 / 3 + 0.4
    ends = center + 0.8 - 0.4 * np.arange(5)
    predicted = FLOOR / 2 * MIRROR * np.array([blurred(fine, b, a) for a, b in pairwise(ends)])
    of = between_mirrors(Pinhole((center, 1), (0, 1), float(np.arctan(0.8 / 3)), 4))
    exact = image(of, 4).values[3]
    paths = Paths(of, 4)
    assert bootstrap(jax.random.key(0), multiplexed(paths, (1, 2, 3, 4), None), 2**12, 1.0).total == 0
    found = PhotonDensity(radius=RADIUS, photons=8, cameras=8).render(jax.random.key(1), of, 4, 2**21)
    result = held(found, predicted)
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.08, result.detectable
    assert not held(found, exact).agrees
    # Where no edge is near, nothing is blurred.
    np.testing.assert_allclose(predicted[:1], exact[:1], rtol=0.02)


def test_a_floor_of_its_own_is_blurred_alike():
    """The same light on a wall sensor. Detectable: 8 %; twin: the exact image."""
    of = between_mirrors(Wall("floor", 6))
    fine, exact = image(of.with_pixels(384), 2).values[1], image(of, 2).values[1]
    ends = np.linspace(0, 4, 7)
    predicted = np.array([blurred(fine, a, b) for a, b in pairwise(ends)])
    found = PhotonDensity(radius=RADIUS, photons=8, cameras=12).render(jax.random.key(2), of, 2, 2**20)
    result = held(found, predicted)
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.08, result.detectable
    assert not held(found, exact).agrees


def test_errors_say_what_is_wrong():
    with pytest.raises(ValueError, match="radius must be positive"):
        PhotonDensity(radius=0.0)
    with pytest.raises(ValueError, match="photons must be a whole number, 1 at least, not 0"):
        PhotonDensity(photons=0)
