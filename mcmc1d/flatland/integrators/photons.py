"""Photon density estimation: light that no two walks can be joined to make, by photons nearby (Jensen 1996)."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_whole
from mcmc1d.flatland.geometry import Vector, Walls
from mcmc1d.flatland.integrators.base import brightest, multiplexed
from mcmc1d.flatland.integrators.passes import Passes
from mcmc1d.flatland.paths import Paths, lamps, on_a_lamp
from mcmc1d.flatland.scattering import Local, brdf, lambert_direction, local, scatter
from mcmc1d.flatland.scene import Scene
from mcmc1d.numerics import parameter
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Bool, Float, Index, Scalar


class Landing(NamedTuple):
    """Where a walk has come to, and with what."""

    segment: Index
    along: Scalar
    coming: Local
    """To where it came from."""
    weight: Scalar
    """f / p of the way so far, the wall that it has come to left out."""
    specular: Bool[Array, "..."]
    """Whether every wall before was a mirror's bounce."""


class _Ray(NamedTuple):
    point: Vector
    way: Vector
    leaving: Index
    weight: Scalar
    specular: Bool[Array, "..."]


class PhotonDensity(Passes):
    """Photons from the lamps, and camera paths that end at the first wall which is no mirror's bounce (Jensen 1996).

    There the photons within `radius` along the wall count, each with its flux over the length of wall that lies within
    the radius: so the ends of a wall are not dark. A path of k edges is two walks whose ends are taken for one vertex,
    and needs no edge to join them: also what goes from mirror to wall to mirror is made, which of the techniques only
    a walk does that comes upon the lamp by itself. Of a wall sensor the camera path is a place on it.

    Biased: what is estimated is the image with the irradiance of its walls averaged over that radius, cut off at the
    walls' ends; where the irradiance is smooth the bias is E''(y) radius^2 / 6, and in a caustic of width under the
    radius all of it.
    """

    radius: Scalar = eqx.field(converter=parameter, default=0.05)
    photons: int = eqx.field(static=True, default=64)
    """Of a pass."""
    cameras: int = eqx.field(static=True, default=64)
    """Of a pass."""

    def __check_init__(self):
        require(
            bool(np.isfinite(self.radius) and self.radius > 0),
            f"PhotonDensity: radius must be positive and finite, not {self.radius}; a radius of 0 meets no photon",
        )
        require_whole(self.photons, "PhotonDensity: photons")
        require_whole(self.cameras, "PhotonDensity: cameras")

    def target(self, paths: Paths) -> Multiplexed:
        """The paths that photons make which come upon the sensor or, of a pinhole, are joined to it."""
        return multiplexed(paths, (paths.eye_lengths[0],), None)

    def numbers(self, paths: Paths) -> tuple[int, int]:
        return (1 if paths.sensor.places else 1 + 2 * paths.edges), self.photons * (2 + 2 * _landings(paths))

    def gather(self, paths: Paths, own: Float[Array, "n cameras"], shared: Float[Array, " m"]) -> Float[Array, " c"]:
        photons = jax.vmap(partial(_photon, paths), in_axes=-1)(shared.reshape(-1, self.photons))
        one = _irradiance if paths.sensor.places else _radiance
        return jax.vmap(lambda u: one(paths, jnp.asarray(self.radius), u, photons), in_axes=-1)(own)

    def most(self, scene: Scene, edges: int) -> float:
        paths, light = Paths(scene, edges), brightest(scene, edges)
        upon = 0.0 if paths.sensor.places else light  # a lamp that the camera comes upon
        if _landings(paths) == 0:
            return upon
        if scene.glossy:
            return np.inf  # at grazing angles f_r has no bound
        # A photon has twice the emission times all lamps' length, a Lambert wall sends on rho / 2 of what arrives.
        lengths = [segment.length for segment in scene.segments]
        flux = light * scene.lamp_length
        meetings = edges - 1 if paths.walls.mirrors and not paths.sensor.places else 1
        return upon + meetings * flux / min(float(self.radius), *lengths)

    def rays(self, paths: Paths) -> float:
        walked = 0 if paths.sensor.places else (paths.edges if paths.walls.mirrors else 1)
        return float(self.photons * _landings(paths) + self.cameras * walked)


def _landings(paths: Paths) -> int:
    """How many walls a photon comes to: as many edges as are left after one of the camera's."""
    return paths.edges - 1 + paths.sensor.places


def _walk(walls: Walls, start: _Ray, numbers: Float[Array, " r"]) -> Landing:
    """From wall to wall, with two numbers at each: the landings, with a leading axis."""

    def advance(ray: _Ray, pair: Float[Array, " 2"]) -> tuple[_Ray, Landing]:
        hit = walls.meet(ray.point, ray.way, ray.leaving)
        point, frame = walls.point(hit.segment, hit.along), walls.frame(hit.segment)
        back = ray.point - point
        coming = local(frame, back * (1 / jnp.maximum(back.length(), jnp.finfo(walls.dtype).tiny ** 0.5)))
        arriving = jnp.where(coming.up > 0, ray.weight, 0)
        turn = scatter(walls, hit.segment, coming, pair[0], pair[1])
        scattered = brdf(walls, hit.segment, coming, turn.out) * jnp.maximum(turn.out.up, 0)
        sent = jnp.where(turn.mirror, walls.at(walls.mirror, hit.segment), scattered)
        density = jnp.exp(turn.log_p)
        leaving = arriving * jnp.where(density > 0, sent / jnp.where(density > 0, density, 1), 0)
        segment = jnp.asarray(hit.segment, jnp.int32)
        onward = _Ray(point, turn.out.world(frame), segment, leaving, ray.specular & turn.mirror)
        return onward, Landing(segment, hit.along, coming, arriving, ray.specular)

    return jax.lax.scan(advance, start, numbers.reshape(-1, 2))[1]


def _photon(paths: Paths, u: Float[Array, " r"]) -> Landing:
    """A photon's landings: the lamp by its length, the direction with density cos / 2, so that its flux is 2 L_e l."""
    walls = paths.walls
    segment, along = on_a_lamp(walls, u[0])
    point = walls.point(segment, along)
    way = lambert_direction(u[1]).world(walls.frame(segment))
    weight = 2 * walls.at(walls.emission, segment) * lamps(walls)[-1]
    return _walk(walls, _Ray(point, way, jnp.asarray(segment, jnp.int32), weight, jnp.ones((), bool)), u[2:])


def _camera(paths: Paths, u: Float[Array, " r"]) -> Landing:
    """A camera path's landings, one for each edge: what a pinhole responds is what it is sampled with."""
    walls, sensor, nowhere = paths.walls, paths.sensor, jnp.asarray(-1, jnp.int32)
    point, _ = sensor.point(walls, u[0])
    way = sensor.direction(u[0]).world(sensor.frame(walls, nowhere))
    return _walk(walls, _Ray(point, way, nowhere, jnp.ones_like(u[0]), jnp.ones((), bool)), u[1:])


def _kernel(walls: Walls, radius: Scalar, segment: Index, along: Scalar, photon: Landing) -> Scalar:
    """One over the length of the wall within the radius of a place, for a photon there; else 0."""
    span = jnp.minimum(along + radius, walls.at(walls.length, segment)) - jnp.maximum(along - radius, 0)
    near = (segment == photon.segment) & (jnp.abs(along - photon.along) <= radius)
    return jnp.where(near, 1 / span, 0)


def _irradiance(paths: Paths, radius: Scalar, u: Float[Array, " 1"], photons: Landing) -> Scalar:
    """At a place on a wall sensor: the photons that land there by their k-th edge."""
    walls = paths.walls
    segment, along = walls.place(paths.sensor.place(walls, u[0]))
    last: Landing = jax.tree.map(lambda leaf: leaf[:, paths.edges - 1], photons)
    return (last.weight * jax.vmap(partial(_kernel, walls, radius, segment, along))(last)).mean()


def _radiance(paths: Paths, radius: Scalar, u: Float[Array, " r"], photons: Landing) -> Scalar:
    """Along a camera path: the lamp that it comes upon by mirrors alone, and the photons where it may end."""
    walls, k = paths.walls, paths.edges
    eye = _camera(paths, u)
    last: Landing = jax.tree.map(lambda leaf: leaf[-1], eye)
    total = jnp.where(last.specular, last.weight * walls.at(walls.emission, last.segment), 0)
    for c in range(1, k if walls.mirrors else min(k, 2)):  # the camera's c-th wall; the photons' by their k - c edges
        here: Landing = jax.tree.map(lambda leaf, c=c: leaf[c - 1], eye)
        there: Landing = jax.tree.map(lambda leaf, c=c: leaf[:, k - c - 1], photons)

        def brought(photon: Landing, here: Landing = here) -> Scalar:
            sent = photon.weight * brdf(walls, here.segment, photon.coming, here.coming)
            return sent * _kernel(walls, radius, here.segment, here.along, photon)

        total = total + jnp.where(here.specular, here.weight * jax.vmap(brought)(there).mean(), 0)
    return total


__all__ = ["Landing", "PhotonDensity"]
