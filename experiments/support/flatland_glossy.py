"""A door with glossy walls, and which pixels of a scene see gloss."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mcmc1d.checks import require
from mcmc1d.flatland.plane import cross
from mcmc1d.flatland.scene import Material, Pinhole, Scene
from mcmc1d.flatland.scenes import catalogue, scene

GLOSSY_DOOR = "glossy_door"
_GLOSSY = (((3.0, 3.0), (0.0, 3.0)), ((3.2, 0.0), (6.2, 0.0)))
"""The ceiling of the camera's room and the floor of the lamp's."""
_THROUGH = 16
"""Directions in which one looks through a pixel."""


def with_glossy_door() -> dict[str, Callable[[], Scene]]:
    """The catalogue, and `glossy_door`."""
    return {**catalogue(), GLOSSY_DOOR: glossy_door}


def glossy_door() -> Scene:
    """`door` with two glossy walls."""
    door, glossy = scene("door"), Material(lambert=0.15, glossy=0.6, exponent=20)
    found = [segment for segment in door.segments if (segment.start, segment.end) in _GLOSSY]
    require(
        len(found) == len(_GLOSSY), f"the walls of scene door have moved: {GLOSSY_DOOR} finds {len(found)} of its own"
    )
    walls = (replace(segment, material=glossy) if segment in found else segment for segment in door.segments)
    return replace(door, name=GLOSSY_DOOR, segments=tuple(walls))


def marked(scene: Scene) -> dict[str, np.ndarray]:
    """Which pixels of a pinhole see glossy walls in all of their width, and which in none of it: (pixels,) each."""
    sensor = scene.sensor
    if not isinstance(sensor, Pinhole):
        raise ValueError(f"scene {scene.name} has a wall sensor, whose pixels see all walls: give one with a pinhole")
    film = (np.arange(sensor.pixels * _THROUGH) + 0.5) / (sensor.pixels * _THROUGH)
    glossy = np.array([segment.material.glossy > 0 for segment in scene.segments])
    seen = glossy[_first(scene, sensor, film)].reshape(sensor.pixels, _THROUGH)
    marks = {"glossy": np.asarray(seen.all(1)), "diffuse": np.asarray(~seen.any(1))}
    none = [part for part, pixels in marks.items() if not pixels.any()]
    require(not none, f"no pixel of scene {scene.name} sees {' or '.join(none)} walls alone: nothing to compare")
    return marks


def _first(scene: Scene, sensor: Pinhole, film: np.ndarray) -> np.ndarray:
    """The segment that is seen first at film coordinates in [0, 1)."""
    ahead = np.asarray(sensor.direction, np.float64) / np.hypot(*sensor.direction)
    beside = np.array([-ahead[1], ahead[0]])
    ways = (ahead + 2 * np.tan(sensor.half_angle) * (film[:, None] - 0.5) * beside)[:, None]
    start, along = scene.ends[:, 0] - np.asarray(sensor.position), scene.ends[:, 1] - scene.ends[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):  # of what is parallel
        distance, place = (cross(start, by) / cross(ways, along) for by in (along, ways))
    return np.where((distance > 0) & (place >= 0) & (place <= 1), distance, np.inf).argmin(1)


__all__ = ["GLOSSY_DOOR", "marked", "with_glossy_door"]
