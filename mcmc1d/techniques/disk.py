"""Techniques onto a disk: uniform in two parametrisations, and a spherical cap projected along its axis."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_positive
from mcmc1d.examples import Examples
from mcmc1d.numerics import below_one, is_concrete, limit, number, parameter, wrap
from mcmc1d.quadrature import Outline
from mcmc1d.special import cos_turns, sin_turns
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.techniques.planar import ROUNDINGS, Planar
from mcmc1d.types import Array, Corners, Float, Real, Scalar


class OntoDisk(Planar):
    """A technique whose samples lie in a disk."""

    @property
    @abc.abstractmethod
    def circle(self) -> tuple[Float[Real, "..."], Float[Real, "..."]]:
        """The disk's centre and radius."""

    def __check_init__(self):
        centre, radius = self.circle
        name = type(self).__name__
        require(np.shape(centre) == (2,), f"{name}: the centre must be a point of the plane, not {centre}")
        if is_concrete(centre):
            require(bool(np.isfinite(centre).all()), f"{name}: the centre must be finite, not {centre}")
        require_positive(self, radius=radius)

    @property
    def support(self) -> Corners:
        centre, radius = self.circle
        return centre - radius, centre + radius

    @property
    def outline(self) -> Outline:
        return Outline.circle(*self.circle)

    def place(self, z: Float[Array, " 2"]) -> Float[Array, " 2"]:
        """The point of the disk that is z in the unit disk."""
        centre, radius = self.circle
        return limit(centre + radius * z, *self.support)

    def unplace(self, x: Float[Array, " 2"]) -> Float[Array, " 2"]:
        """Where x lies in the unit disk."""
        centre, radius = self.circle
        return (x - centre) / radius

    def log_area(self) -> Scalar:
        """Log of the disk's area."""
        return jnp.log(np.pi) + 2 * jnp.log(self.circle[1])

    def inside(self, x: Float[Array, " 2"]) -> Array:
        """Whether x lies in the disk, or beyond its rim by no more than rounding."""
        centre, radius = self.circle
        z = self.unplace(x)
        slack = ROUNDINGS * jnp.finfo(x.dtype).eps.astype(x.dtype) * (1 + jnp.abs(jnp.asarray(centre)).max() / radius)
        return z @ z <= 1 + slack


class UniformDisk(OntoDisk):
    """Uniform on a disk: a subclass is a map of the unit square onto the unit disk, of determinant pi everywhere."""

    centre: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    radius: Scalar = eqx.field(converter=number, default=1.0)

    @property
    def circle(self) -> tuple[Float[Real, "..."], Float[Real, "..."]]:
        return self.centre, self.radius

    @abc.abstractmethod
    def to_disk(self, u: Float[Array, " 2"]) -> Float[Array, " 2"]:
        """The point of the unit disk that u makes."""

    @abc.abstractmethod
    def to_square(self, z: Float[Array, " 2"]) -> Float[Array, " 2"]:
        """The u that makes a point of the unit disk; 1 where rounding says so."""

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        return self.place(self.to_disk(u)), u[2:], self.log_area()

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        return below_one(self.to_square(self.unplace(x))), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        return jnp.where(self.inside(x), -self.log_area(), -jnp.inf)


class PolarDisk(UniformDisk):
    """Uniform on a disk in polar coordinates: r = sqrt(u0), phi = 2 pi u1; the root is the Jacobian's r.

    Singular at the centre; u1 = 0 and u1 -> 1 meet, so that a wrapped step of the angle is none at a seam.
    """

    def to_disk(self, u: Float[Array, " 2"]) -> Float[Array, " 2"]:
        return jnp.sqrt(u[0]) * jnp.stack([cos_turns(u[1]), sin_turns(u[1])])

    def to_square(self, z: Float[Array, " 2"]) -> Float[Array, " 2"]:
        return jnp.stack([z @ z, _turns(z)])


class ConcentricDisk(UniformDisk):
    """Uniform on a disk by concentric squares (Shirley and Chiu 1997): neighbours in u stay neighbours in x.

    The square [-1, 1]^2 is cut along its diagonals; in each quarter the longer coordinate is the radius and the
    quotient of the two the angle. The determinant is pi everywhere; only the centre is singular. Unlike the polar
    map it is bounded in both ways, but its four sides do not meet: a step that wraps around lands across the disk.
    """

    def to_disk(self, u: Float[Array, " 2"]) -> Float[Array, " 2"]:
        a, b = 2 * u[0] - 1, 2 * u[1] - 1
        wide = jnp.abs(a) > jnp.abs(b)
        long, short = jnp.where(wide, a, b), jnp.where(wide, b, a)
        turns = short / jnp.where(long == 0, 1, long) / 8  # up to an eighth, on either side of the longer axis
        # long sin(2 pi turns) as a multiple of short: so the derivative at the centre, where the map has none, is the
        # limit from one side, and its determinant right.
        sinc = jnp.where(turns == 0, np.pi / 4, sin_turns(turns) / jnp.where(turns == 0, 1, 8 * turns))
        along, across = long * cos_turns(turns), short * sinc
        return jnp.stack([jnp.where(wide, along, across), jnp.where(wide, across, along)])

    def to_square(self, z: Float[Array, " 2"]) -> Float[Array, " 2"]:
        wide = jnp.abs(z[0]) > jnp.abs(z[1])
        along, across = jnp.where(wide, z[0], z[1]), jnp.where(wide, z[1], z[0])
        long = jnp.copysign(jnp.sqrt(z @ z), along)
        short = long * (4 / np.pi) * jnp.arctan(across / jnp.where(along == 0, 1, along))
        ab = jnp.stack([jnp.where(wide, long, short), jnp.where(wide, short, long)])
        return (ab + 1) / 2


class ProjectedCap(OntoDisk):
    """Uniform directions in a spherical cap, projected along its axis: a disk, denser towards the rim.

    The cosine of the angle to the axis is 1 - u0 (1 - `cosine`), where `cosine` in (0, 1) is that of the half-angle;
    p(x) = (1 + cosine) / (2 pi radius^2 cos(theta)), for the disk scaled to `radius`. With respect to the solid angle
    it is constant; the cosine is what projection does to an area.
    """

    cosine: Scalar = eqx.field(converter=number, default=0.5)
    centre: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    radius: Scalar = eqx.field(converter=number, default=1.0)

    @property
    def circle(self) -> tuple[Float[Real, "..."], Float[Real, "..."]]:
        return self.centre, self.radius

    def __check_init__(self):
        if is_concrete(self.cosine):
            require(
                bool(0 < self.cosine < 1),
                f"ProjectedCap: the cosine of the half-angle must lie strictly between 0 and 1, not {self.cosine}: "
                "at 0 the density is infinite on the rim",
            )

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        c = jnp.asarray(self.cosine)
        q = u[0] * (1 - c)  # 1 - cos(theta), so that nothing cancels near the axis
        r = jnp.sqrt(u[0] * (2 - q) / (1 + c))  # sin(theta) over its largest value
        z = r * jnp.stack([cos_turns(u[1]), sin_turns(u[1])])
        return self.place(z), u[2:], self.log_area() + jnp.log(2 * (1 - q) / (1 + c))

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        z, c = self.unplace(x), jnp.asarray(self.cosine)
        u0 = (z @ z) * (1 + c) / (1 + self._cos_theta(z))
        return jnp.stack([below_one(u0), _turns(z)]), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        log_p = jnp.log((1 + self.cosine) / (2 * self._cos_theta(self.unplace(x)))) - self.log_area()
        return jnp.where(self.inside(x), log_p, -jnp.inf)

    def _cos_theta(self, z: Float[Array, " 2"]) -> Scalar:
        """Of the direction that is projected to z; outside of the disk, of one on the rim."""
        c = jnp.asarray(self.cosine)
        return jnp.sqrt(1 - (1 - c * c) * jnp.minimum(z @ z, 1))


def _turns(z: Float[Array, " 2"]) -> Scalar:
    """The angle of z in turns, in [0, 1)."""
    return wrap(jnp.arctan2(z[1], z[0]) / (2 * np.pi))


EXAMPLES = Examples(
    lambda: {
        "polar_disk": PolarDisk(),
        "concentric_disk": ConcentricDisk((0.5, 0.4), 0.3),
        "projected_cap": ProjectedCap(0.3, (0.4, 0.6), 0.35),
    }
)
