"""Where eye paths begin: at a pinhole, or on a wall; for one event."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require
from mcmc1d.flatland.geometry import Frame, Vector, Walls
from mcmc1d.flatland.scattering import Local, lambert_direction, lambert_number
from mcmc1d.flatland.scene import Pinhole, Scene
from mcmc1d.numerics import below_one
from mcmc1d.types import Array, Bool, Float, Index, Real, Scalar


class Sensor(eqx.Module):
    """The first vertex of a path, vertex 0, and the directions in which paths leave it.

    Directions are in the sensor's own frame. The image is the mean of its response over the film, [0, 1).
    """

    pixels: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def places(self) -> int:
        """How many numbers say where on the sensor a path begins: 0 for a point, which no path can hit, else 1."""

    @abc.abstractmethod
    def place(self, walls: Walls, u: Scalar) -> Scalar:
        """A place on the walls' line, uniform on the sensor."""

    @abc.abstractmethod
    def number(self, walls: Walls, place: Scalar) -> Scalar:
        """The inverse of `place`: also the film coordinate where the film lies along a wall."""

    @abc.abstractmethod
    def log_place(self, walls: Walls, segment: Index) -> Scalar:
        """Log of the density of a place on that segment, with respect to length; -inf off the sensor."""

    @abc.abstractmethod
    def point(self, walls: Walls, place: Scalar) -> tuple[Vector, Index]:
        """The point in the plane, and the segment it is on; -1 for none."""

    @abc.abstractmethod
    def frame(self, walls: Walls, segment: Index) -> Frame:
        """That of vertex 0: which way the sensor looks, or the frame of whatever segment light has come to."""

    @abc.abstractmethod
    def direction(self, u: Scalar) -> Local:
        """A direction by one number."""

    @abc.abstractmethod
    def direction_number(self, out: Local) -> Scalar:
        """The inverse of `direction`; limited to [0, 1) for one that the sensor does not see."""

    @abc.abstractmethod
    def log_density(self, out: Local) -> Scalar:
        """Log of the density of a direction with respect to d theta; -inf out of sight."""

    @abc.abstractmethod
    def log_response(self, out: Local) -> Scalar:
        """Log of the response to radiance from a direction, per d theta (and per place, uniform on the sensor)."""

    @abc.abstractmethod
    def film(self, walls: Walls, place: Scalar, out: Local) -> Scalar:
        """The film coordinate of a path, in [0, 1)."""


class Camera(Sensor):
    """A pinhole: the mean radiance over a film with x = tan(phi), so p(phi) = 1 / (A cos^2 phi), A = 2 tan(half_angle).

    The response is that density: there is no cosine at a pinhole.
    """

    position: Float[Real, " 2"]
    ahead: Float[Real, " 2"]
    width: Scalar
    """A."""
    pixels: int = eqx.field(static=True)

    def __init__(self, pinhole: Pinhole, centre: np.ndarray):
        """`pinhole`: as a scene describes it, whose `centre` is where the walls' points are relative to."""
        self.position = np.asarray(pinhole.position, np.float64) - centre
        self.ahead = np.asarray(pinhole.direction, np.float64) / math.hypot(*pinhole.direction)
        self.width = np.asarray(2 * math.tan(pinhole.half_angle))
        self.pixels = pinhole.pixels

    @property
    def places(self) -> int:
        return 0

    def place(self, walls: Walls, u: Scalar) -> Scalar:
        return u

    def number(self, walls: Walls, place: Scalar) -> Scalar:
        return place

    def log_place(self, walls: Walls, segment: Index) -> Scalar:
        return jnp.zeros((), walls.dtype)

    def point(self, walls: Walls, place: Scalar) -> tuple[Vector, Index]:
        return Vector(jnp.asarray(self.position[0]), jnp.asarray(self.position[1])), jnp.asarray(-1, jnp.int32)

    def frame(self, walls: Walls, segment: Index) -> Frame:
        x, y = jnp.asarray(self.ahead[0]), jnp.asarray(self.ahead[1])
        return Frame(Vector(x, y), Vector(-y, x))

    def direction(self, u: Scalar) -> Local:
        tangent = self.width * (u - 0.5)
        up = 1 / jnp.sqrt(1 + tangent * tangent)
        return Local(tangent * up, up)

    def direction_number(self, out: Local) -> Scalar:
        # The nearer end: where the film is nearly the whole half-plane, a direction is rounded by more than a pixel.
        film = jnp.where(out.up > 0, self._film(out), jnp.where(out.along > 0, 1, 0))
        return below_one(jnp.maximum(film, 0))

    def log_density(self, out: Local) -> Scalar:
        sees = self._sees(out)
        return jnp.where(sees, -jnp.log(self.width) - 2 * jnp.log(jnp.where(sees, out.up, 1)), -jnp.inf)

    def log_response(self, out: Local) -> Scalar:
        return self.log_density(out)

    def film(self, walls: Walls, place: Scalar, out: Local) -> Scalar:
        return self.direction_number(out)

    def _film(self, out: Local) -> Scalar:
        return out.along / (jnp.where(out.up > 0, out.up, 1) * self.width) + 0.5

    def _sees(self, out: Local) -> Bool[Array, ""]:
        # A direction that was made from u = 0 may come back a few roundings under it.
        tiny = 8 * jnp.finfo(jnp.asarray(self.width).dtype).eps
        film = self._film(out)
        return (out.up > 0) & (film >= -tiny) & (film <= 1 + tiny)


class WallSensor(Sensor):
    """A sensor along a segment: the irradiance on its front, the integral of L cos(theta) d theta."""

    segment: int = eqx.field(static=True)
    pixels: int = eqx.field(static=True)

    @property
    def places(self) -> int:
        return 1

    def place(self, walls: Walls, u: Scalar) -> Scalar:
        return walls.slot(self.segment, u * jnp.asarray(walls.length[self.segment]))

    def number(self, walls: Walls, place: Scalar) -> Scalar:
        return below_one((place - walls.offsets[self.segment]) / walls.length[self.segment])

    def log_place(self, walls: Walls, segment: Index) -> Scalar:
        return jnp.where(segment == self.segment, -jnp.log(jnp.asarray(walls.length[self.segment])), -jnp.inf)

    def point(self, walls: Walls, place: Scalar) -> tuple[Vector, Index]:
        segment, along = walls.place(place)
        return walls.point(segment, along), segment

    def frame(self, walls: Walls, segment: Index) -> Frame:
        return walls.frame(segment)

    def direction(self, u: Scalar) -> Local:
        return lambert_direction(u)

    def direction_number(self, out: Local) -> Scalar:
        return lambert_number(out)

    def log_density(self, out: Local) -> Scalar:
        front = out.up > 0
        return jnp.where(front, jnp.log(jnp.where(front, out.up / 2, 1)), -jnp.inf)

    def log_response(self, out: Local) -> Scalar:
        return self.log_density(out) + math.log(2)

    def film(self, walls: Walls, place: Scalar, out: Local) -> Scalar:
        return self.number(walls, place)


_NARROWEST_PIXEL = 4e-4
"""At the distance 1: where walls meet, one reaches over the other by a millionth of the scene, or less."""


def sensor_of(scene: Scene) -> Sensor:
    """The tracer's form of a scene's sensor; raises `ValueError` where single precision does not see through it."""
    if isinstance(scene.sensor, Pinhole):
        pinhole = scene.sensor
        wide = 2 * math.tan(pinhole.half_angle) / pinhole.pixels
        require(
            wide >= _NARROWEST_PIXEL,
            f"scene {scene.name}: a pixel of the pinhole is {wide:.2g} wide (2 tan(half_angle) / pixels), which single "
            f"precision does not see well; the exact image takes it, the tracer {_NARROWEST_PIXEL:g} at least",
        )
        away = float(np.abs(pinhole.position - scene.centre).max())
        require(
            away <= 100 * scene.extent,
            f"scene {scene.name}: the pinhole at {pinhole.position} is over 100 times the walls' {scene.extent:.3g} "
            "away, where single precision does not tell them well; bring it nearer",
        )
        return Camera(pinhole, scene.centre)
    segment = scene.sensor_segment
    assert segment is not None
    return WallSensor(segment, scene.sensor.pixels)
