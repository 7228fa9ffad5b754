"""What flatland is made of: segments that emit and scatter, and a sensor; checked here, so that nothing else need.

Plain numbers on the host: the tracer and the references, which share no code, both read a scene.
"""

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.flatland.plane import crossing, distance, gaps, near

Point = tuple[float, float]


def _is_number(value: Any) -> bool:
    """Whether it is a real number that a float holds; true and false are none."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    return not isinstance(value, int) or abs(value) <= sys.float_info.max


def _require_pixels(pixels: Any, who: str) -> None:
    require_whole(pixels, f"{who}: pixels")
    require(pixels <= _MOST_PIXELS, f"{who}: pixels must be {_MOST_PIXELS} at most, not {pixels}")


_MOST_PIXELS = 10**6
_FINEST = 1e-9
"""Radians of a pixel; the exact image leaves out what is narrower than a thousandth of that."""


@dataclass(frozen=True)
class Material:
    """How a segment's front emits and scatters; its back is black.

    Radiance is per length and per radian (light in the plane); reflectances are shares of what arrives, and sum to 1
    at most. A glossy lobe returns less than its reflectance: `glossy cos^n(alpha) / (I_n max(cos_i, cos_o))`.
    """

    emission: float = 0.0
    """Radiance L_e, the same in all directions."""
    lambert: float = 0.0
    """rho of the diffuse lobe, f_r = rho / 2."""
    glossy: float = 0.0
    """rho of the lobe about the mirror direction."""
    exponent: int = 20
    """n of the glossy lobe."""
    mirror: float = 0.0
    """rho of the perfect mirror."""

    def __post_init__(self):
        for name in ("emission", "lambert", "glossy", "mirror"):
            value = getattr(self, name)
            require(_is_number(value), f"Material: {name} is a number, not {value!r}")
            require(np.isfinite(value) and value >= 0, f"Material: {name} must be finite and not negative: {value}")
        require(
            self.emission == 0 or 1e-9 <= self.emission <= 1e9,
            f"Material: emission must be 0, or from 1e-9 to 1e9 (single precision squares it), not {self.emission}",
        )
        require(
            _is_number(self.exponent) and self.exponent in range(1, 201),
            f"Material: exponent must be a whole number from 1 to 200, not {self.exponent!r}",
        )
        object.__setattr__(self, "exponent", int(self.exponent))
        require(
            self.reflectance <= 1 + 1e-12,
            f"Material: the reflectances lambert + glossy + mirror must sum to 1 at most, not {self.reflectance}",
        )

    @property
    def reflectance(self) -> float:
        """The sum of the lobes' reflectances."""
        return self.lambert + self.glossy + self.mirror


@dataclass(frozen=True)
class Segment:
    """A wall, a lamp or a screen; its front is to the left of the way from `start` to `end`."""

    start: Point
    end: Point
    material: Material = Material()
    name: str = ""

    def __post_init__(self):
        for end in ("start", "end"):
            object.__setattr__(self, end, _point(getattr(self, end), f"Segment: {end}"))
        require_instance(self.material, Material, "Segment: the material")
        require_instance(self.name, str, "Segment: the name")

    @property
    def length(self) -> float:
        """Its length."""
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))


@dataclass(frozen=True)
class Pinhole:
    """A camera at a point; a pixel is the mean radiance over its part of the film, x = tan(phi).

    phi is the angle from `direction`, |phi| < `half_angle`; film coordinates grow with phi, counter-clockwise. A path
    can start at a pinhole, and none can hit it.
    """

    position: Point
    direction: Point
    """Where it looks; of any length."""
    half_angle: float = 0.6
    """Half the field of view, in radians; under 1.57."""
    pixels: int = 16

    def __post_init__(self):
        _require_pixels(self.pixels, "Pinhole")
        for name in ("position", "direction"):
            object.__setattr__(self, name, _point(getattr(self, name), f"Pinhole: {name}"))
        require(
            bool(np.isfinite(self.direction).all()) and np.hypot(*self.direction) > 0,
            f"Pinhole: direction must be finite and not zero, not {self.direction}",
        )
        require(_is_number(self.half_angle), f"Pinhole: half_angle is a number, in radians, not {self.half_angle!r}")
        require(
            0 < self.half_angle < 1.57,
            f"Pinhole: half_angle is in radians, over 0 and under 1.57, not {self.half_angle}",
        )
        require(
            2 * self.half_angle >= _FINEST * self.pixels,
            f"Pinhole: {self.pixels} pixels in a half_angle of {self.half_angle} are narrower than {_FINEST:g} "
            "radians, which rounding does not resolve; widen it",
        )


@dataclass(frozen=True)
class Wall:
    """A sensor that lies along a segment: a pixel is the mean irradiance on its part of the segment's front.

    Irradiance: the integral of L cos(theta) over the angles; film coordinates run from `start` to `end`. Paths can hit
    it.
    """

    segment: str
    """The segment's name."""
    pixels: int = 16

    def __post_init__(self):
        _require_pixels(self.pixels, "Wall")
        require(isinstance(self.segment, str), f"Wall: segment is a segment's name, not {self.segment!r}")


_NARROWEST = 1e-6
"""Of the scene's extent: a narrower gap is lost in single precision."""


@dataclass(frozen=True)
class Scene:
    """Segments and a sensor. Segments may touch, at ends or in a T; they must not cross or overlap.

    Raises `ValueError` that names the segments and the place: where a segment has no length, two cross or overlap,
    the sensor is no place in the scene or stands in a wall, nothing emits.
    """

    name: str
    segments: tuple[Segment, ...]
    sensor: Pinhole | Wall

    def __post_init__(self):
        require_instance(self.name, str, "Scene: the name")
        require(np.iterable(self.segments), f"scene {self.name}: segments are several, not {self.segments!r}")
        object.__setattr__(self, "segments", tuple(self.segments))
        require(len(self.segments) > 0, f"scene {self.name}: there is no segment")
        for k, segment in enumerate(self.segments):
            require_instance(segment, Segment, f"scene {self.name}: segment {k}")
        sensor = isinstance(self.sensor, Pinhole | Wall)
        require(sensor, f"scene {self.name}: the sensor must be a Pinhole or a Wall, not {self.sensor!r}")
        for k, segment in enumerate(self.segments):
            finite = bool(np.isfinite([*segment.start, *segment.end]).all())
            require(
                finite,
                f"scene {self.name}: {self.label(k)} has an end that is not finite: it runs from {segment.start} to "
                f"{segment.end}",
            )
        extent, far = self.extent, float(np.abs(self.ends).max())
        for k, segment in enumerate(self.segments):
            require(
                segment.length > 1e-4 * extent,
                f"scene {self.name}: {self.label(k)} has no length: it runs from {segment.start} to "
                f"{segment.end}; a segment under 1e-4 of the scene's extent is lost in single precision",
            )
        require(
            1e-6 <= extent <= 1e6 and far <= 100 * extent,
            f"scene {self.name}: it is {extent:.3g} across and reaches {far:.3g} from the origin; for single precision "
            "scale it to between 1e-6 and 1e6, and move it to the origin",
        )
        total = float(self.lengths.sum())
        require(
            not self.mirrors or total <= 1e5,
            f"scene {self.name}: its walls are {total:.3g} long; with mirrors 1e5 at most, or single precision takes "
            "one mirror for another: scale it down",
        )
        names = [segment.name for segment in self.segments if segment.name]
        twice = sorted({name for name in names if names.count(name) > 1})
        require(not twice, f"scene {self.name}: the name {', '.join(twice)} is taken twice")
        require(self.emission > 0, f"scene {self.name}: no segment emits; give one a material with emission > 0")
        self._check_crossings()
        self._check_sensor()

    def label(self, k: int) -> str:
        """What messages call the k-th segment."""
        name = self.segments[k].name
        return f"segment {k} ({name})" if name else f"segment {k}"

    @property
    def sensor_segment(self) -> int | None:
        """The index of the segment that a wall sensor lies along; None of a pinhole."""
        if isinstance(self.sensor, Pinhole):
            return None
        return next(k for k, segment in enumerate(self.segments) if segment.name == self.sensor.segment)

    @property
    def ends(self) -> np.ndarray:
        """Start and end of each segment, float64 of shape (segments, 2, 2)."""
        return np.array([(segment.start, segment.end) for segment in self.segments], np.float64)

    @property
    def lengths(self) -> np.ndarray:
        """Of each segment."""
        return np.hypot(*(self.ends[:, 1] - self.ends[:, 0]).T)

    @property
    def emission(self) -> float:
        """The largest radiance that a segment emits."""
        return max(segment.material.emission for segment in self.segments)

    @property
    def reflectance(self) -> float:
        """The largest share of the light that a segment sends on."""
        return max(segment.material.reflectance for segment in self.segments)

    @property
    def lamp_length(self) -> float:
        """Of all that emits, end to end."""
        return sum(segment.length for segment in self.segments if segment.material.emission > 0)

    @property
    def mirrors(self) -> bool:
        """Whether a segment reflects as a mirror."""
        return any(segment.material.mirror > 0 for segment in self.segments)

    @property
    def glossy(self) -> bool:
        """Whether a segment has a glossy lobe."""
        return any(segment.material.glossy > 0 for segment in self.segments)

    def with_pixels(self, pixels: int) -> "Scene":
        """The same scene, seen with another number of pixels."""
        return replace(self, sensor=replace(self.sensor, pixels=pixels))

    @property
    def extent(self) -> float:
        """The longer side of the box that holds all segments."""
        points = self.ends.reshape(-1, 2)
        return float(np.ptp(points, axis=0).max()) or 1.0

    @property
    def centre(self) -> np.ndarray:
        """The middle of that box, float64 of shape (2,)."""
        points = self.ends.reshape(-1, 2)
        return (points.min(0) + points.max(0)) / 2

    def _check_crossings(self) -> None:
        ends, tiny = self.ends, 1e-9 * self.extent
        for a in range(len(ends)):
            for b in near(ends, a, tiny):
                where = crossing(ends[a], ends[b], tiny)
                if where is not None:
                    raise ValueError(
                        f"scene {self.name}: {self.label(a)} and {self.label(b)} cross or overlap at "
                        f"({where[0]:.6g}, {where[1]:.6g}); split them there, or move one"
                    )
        self._check_gaps()

    @property
    def touching(self) -> np.ndarray:
        """Whether each end, (segments, 2), touches another segment."""
        return np.any(gaps(self.ends) <= 1e-9 * self.extent, axis=-1)

    def _check_gaps(self) -> None:
        """A gap that single precision does not see is none: light would leak there, or a lamp lie in a wall."""
        tiny = 1e-9 * self.extent
        seen = _NARROWEST * self.extent
        apart = gaps(self.ends)
        k, end, j = np.unravel_index(np.argmin(np.where(apart > tiny, apart, np.inf)), apart.shape)
        gap, (x, y) = apart[k, end, j], self.ends[k, end]
        require(
            not tiny < gap < seen,
            f"scene {self.name}: {self.label(int(k))} and {self.label(int(j))} are {gap:.2g} apart at ({x:.6g}, "
            f"{y:.6g}), which single precision does not see: let them touch, or leave {seen:.1g} or more",
        )

    def _check_sensor(self) -> None:
        sensor = self.sensor
        if isinstance(sensor, Wall):
            known = [segment.name for segment in self.segments if segment.name]
            require(
                sensor.segment in known,
                f"scene {self.name}: the sensor lies along {sensor.segment!r}, which is no segment; known: "
                f"{', '.join(known) or 'none has a name'}",
            )
            return
        position = np.asarray(sensor.position, np.float64)
        require(bool(np.isfinite(position).all()), f"scene {self.name}: the pinhole's position is not finite")
        distances = [distance(position, pair) for pair in self.ends]
        k = int(np.argmin(distances))
        require(
            distances[k] > 1e-5 * self.extent,
            f"scene {self.name}: the pinhole at {sensor.position} stands in {self.label(k)}; move it off the wall, by "
            "more than 1e-5 of the scene's extent",
        )


def require_scene(scene: Any, who: str) -> None:
    """Raise `ValueError` unless it is a scene; the name of one is a common slip."""
    fix = "; scenes.scene(name) is one of the catalogue, files.read(path) that of a file"
    require_instance(scene, Scene, who, fix if isinstance(scene, str) else "")


def _point(given: Any, who: str) -> Point:
    """The point as two floats, or `ValueError` unless it is one."""
    point = np.asarray(given, object)
    require(point.shape == (2,) and all(map(_is_number, point)), f"{who} is a point, two numbers, not {given!r}")
    return float(point[0]), float(point[1])


__all__ = ["Material", "Pinhole", "Point", "Scene", "Segment", "Wall", "require_scene"]
