"""A caustic that a pinhole sees twice, directly and in a mirror; and what a kernel of photons makes of it, exactly."""

from itertools import pairwise

import numpy as np

from mcmc1d.flatland import Material, Pinhole, Scene, Segment
from mcmc1d.flatland.reference import Reference, Resolution, image

FLOOR, MIRROR, FLUX = 0.8, 0.9, 1.0
"""Reflectances; and a lamp's emission times its width."""
_LENGTH = 3.7
"""Of the floor; at its right end stands the plane mirror."""
_EYE, _DOWN, _HALF = (2.2, 1.2), np.radians(42), np.radians(22)
"""Where the pinhole is, how far under the horizon it looks to the right, and half its angle."""
_PARTS = 2**14
"""Of the floor, in which its irradiance is summed."""
_RESOLUTION = Resolution(longest=0.02, points=8)
"""Panels of 0.01 of the scene in the end: the penumbras of a narrow lamp, by way of facets, are not found by a mesh."""


def caustic(width: float, pixels: int) -> Scene:
    """A lamp of that width under six facets on an ellipse, whose foci are the lamp and (3.2, 0), and a plane mirror.

    The floor is lit by way of the ellipse only: of 3 edges from the pinhole, and of 4, from mirror to floor to mirror.
    """
    lamp, focus, longer, facets = np.array([1.0, 0.6]), np.array([3.2, 0.0]), 1.9, 6
    middle, along = (lamp + focus) / 2, (focus - lamp) / 2
    half = float(np.hypot(*along))
    along, shorter = along / half, np.sqrt(longer**2 - half**2)
    up = np.array([-along[1], along[0]])
    angles = np.radians(np.linspace(80, 120, facets + 1))
    corners = middle + longer * np.cos(angles)[:, None] * along + shorter * np.sin(angles)[:, None] * up
    points = [(float(x), float(y)) for x, y in corners.round(6)]
    mirror = Material(mirror=MIRROR)
    segments = (
        Segment((0.0, 0.0), (_LENGTH, 0.0), Material(lambert=FLOOR), "floor"),
        Segment((_LENGTH, 0.0), (_LENGTH, 1.5), mirror, "plane"),
        *(Segment(a, b, mirror) for a, b in pairwise(points)),
        Segment((1 - width / 2, 0.6), (1 + width / 2, 0.6), Material(emission=FLUX / width), "lamp"),
    )
    pinhole = Pinhole(_EYE, (float(np.cos(_DOWN)), -float(np.sin(_DOWN))), float(_HALF), pixels)
    return Scene("caustic", segments, pinhole)


def exact(scene: Scene) -> Reference:
    """Its images of up to 4 edges."""
    return image(scene, 4, _RESOLUTION)


def irradiance(scene: Scene, places: np.ndarray) -> np.ndarray:
    """The floor's at these places, by way of the ellipse: of each facet the lamp's image, as far as the facet shows it.

    In closed form: E = rho L_e (sin b - sin a), and nothing stands in between.
    """
    total, lamp = np.zeros_like(places), scene.segments[-1]
    for facet in scene.segments[2:-1]:
        start, end = np.array(facet.start), np.array(facet.end)
        along = (end - start) / facet.length
        images = [start + 2 * along * (along @ (np.array(p) - start)) - (np.array(p) - start) for p in _ends(lamp)]
        shown = np.sort([_sine(at, places) for at in images], axis=0)
        through = np.sort([_sine(at, places) for at in _ends(facet)], axis=0)
        seen = np.minimum(shown[1], through[1]) - np.maximum(shown[0], through[0])
        total += MIRROR * lamp.material.emission * np.maximum(seen, 0)
    return total


def _ends(segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    return np.array(segment.start), np.array(segment.end)


def _sine(point: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Of the angle from the floor's normal under which a point is seen."""
    away = point[0] - places
    return away / np.hypot(away, point[1])


def blurred(scene: Scene, radius: float, edges: int) -> np.ndarray:
    """The image of 3 or 4 edges with the floor's irradiance averaged over the radius, cut off at its ends.

    That is what `PhotonDensity` estimates; each pixel by 200 places on its part of the film.
    """
    pixels, places = scene.sensor.pixels, 200
    film = np.tan(_HALF) * (2 * (np.arange(pixels * places) + 0.5) / (pixels * places) - 1)
    seen = _EYE[0] + _EYE[1] / np.tan(_DOWN - np.arctan(film))  # on the floor, which the mirror shows beyond its end
    direct = seen < _LENGTH
    at = np.where(direct, seen, 2 * _LENGTH - seen)
    ends = np.linspace(0, _LENGTH, _PARTS + 1)
    middles = (ends[1:] + ends[:-1]) / 2
    mass = np.concatenate([[0], np.cumsum(irradiance(scene, middles)) * _LENGTH / _PARTS])
    low, high = np.maximum(at - radius, 0), np.minimum(at + radius, _LENGTH)
    mean = (np.interp(high, ends, mass) - np.interp(low, ends, mass)) / (high - low)
    shown = direct if edges == 3 else ~direct & (at > 0)
    radiance = FLOOR / 2 * mean * (1.0 if edges == 3 else MIRROR)
    return np.where(shown, radiance, 0).reshape(pixels, places).mean(1)


def found(b: float, width: float) -> float:
    """The share of samples from the pinhole of 4 edges that come upon the lamp, of which each brings the same light."""
    return b * width / (FLOOR * MIRROR**2 * FLUX)


__all__ = ["FLOOR", "FLUX", "MIRROR", "blurred", "caustic", "exact", "found", "irradiance"]
