"""Techniques in the plane, uniform or not: disks in two parametrisations, a triangle, a table, a projected cap."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import density_table
from mcmc1d.numerics import (
    below_one,
    choose,
    cos_turns,
    is_concrete,
    limit,
    parameter,
    require,
    require_positive,
    sin_turns,
    unchoose,
    width,
    wrap,
)
from mcmc1d.quadrature import Outline
from mcmc1d.techniques.base import Forward, Inverse, Technique
from mcmc1d.techniques.mixture import Mixture
from mcmc1d.types import Array, Corners, Float, Index, Real, Scalar

_ROUNDINGS = 8  # of the coordinates, by which a sample on the rim may lie beyond it


class Planar(Technique):
    """A technique u in [0, 1)^2 <-> x in the plane, which forgets nothing: its determinant is -log p(x)."""

    @property
    def dim_u(self) -> int:
        return 2

    @property
    @abc.abstractmethod
    def outline(self) -> Outline:
        """Where the density jumps or bends: exact quadrature is split there."""


def outlines(technique: Technique) -> list[Outline]:
    """All curves along which a planar technique's density may jump; of the corners of its support if it says none."""
    if isinstance(technique, Mixture):
        return [outline for lobe in technique.lobes for outline in outlines(lobe)]
    return [technique.outline if isinstance(technique, Planar) else Outline.box(*technique.support)]


class Rectangle(Planar):
    """Uniform on a box: x = lower + u (upper - lower)."""

    lower: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    upper: Float[Real, " 2"] = eqx.field(converter=parameter, default=(1.0, 1.0))

    def __check_init__(self):
        require_box(self, self.lower, self.upper)

    @property
    def support(self) -> Corners:
        return self.lower, self.upper

    @property
    def outline(self) -> Outline:
        return Outline.box(self.lower, self.upper)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        x = limit(self.lower + u * (self.upper - self.lower), self.lower, self.upper)
        return x, u[2:], jnp.log(self.upper - self.lower).sum()

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        return below_one((x - self.lower) / (self.upper - self.lower)), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        inside = jnp.all((x >= self.lower) & (x <= self.upper))
        return jnp.where(inside, -jnp.log(self.upper - self.lower).sum(), -jnp.inf)


class PolarDisk(Planar):
    """Uniform on a disk in polar coordinates: r = sqrt(u0), phi = 2 pi u1; the root is the Jacobian's r.

    Singular at the centre; u1 = 0 and u1 -> 1 meet, so that a wrapped step of the angle is none at a seam.
    """

    centre: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    radius: Scalar = eqx.field(converter=parameter, default=1.0)

    def __check_init__(self):
        require_disk(self, self.centre, self.radius)

    @property
    def support(self) -> Corners:
        return self.centre - self.radius, self.centre + self.radius

    @property
    def outline(self) -> Outline:
        return Outline.circle(self.centre, self.radius)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        z = jnp.sqrt(u[0]) * jnp.stack([cos_turns(u[1]), sin_turns(u[1])])
        return limit(self.centre + self.radius * z, *self.support), u[2:], _log_area(self.radius)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        z = (x - self.centre) / self.radius
        return jnp.stack([below_one(z @ z), _turns(z)]), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        return jnp.where(_in_disk(x, self.centre, self.radius), -_log_area(self.radius), -jnp.inf)


class ConcentricDisk(Planar):
    """Uniform on a disk by concentric squares (Shirley and Chiu 1997): neighbours in u stay neighbours in x.

    The square [-1, 1]^2 is cut along its diagonals; in each quarter the longer coordinate is the radius and the
    quotient of the two the angle. The determinant is pi everywhere; only the centre is singular. Unlike the polar
    map it is bounded in both ways, but its four sides do not meet: a step that wraps around lands across the disk.
    """

    centre: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    radius: Scalar = eqx.field(converter=parameter, default=1.0)

    def __check_init__(self):
        require_disk(self, self.centre, self.radius)

    @property
    def support(self) -> Corners:
        return self.centre - self.radius, self.centre + self.radius

    @property
    def outline(self) -> Outline:
        return Outline.circle(self.centre, self.radius)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        a, b = 2 * u[0] - 1, 2 * u[1] - 1
        wide = jnp.abs(a) > jnp.abs(b)
        long, short = jnp.where(wide, a, b), jnp.where(wide, b, a)
        turns = short / jnp.where(long == 0, 1, long) / 8  # up to an eighth, on either side of the longer axis
        # long sin(2 pi turns) as a multiple of short: so the derivative at the centre, where the map has none, is the
        # limit from one side, and its determinant right.
        sinc = jnp.where(turns == 0, np.pi / 4, sin_turns(turns) / jnp.where(turns == 0, 1, 8 * turns))
        along, across = long * cos_turns(turns), short * sinc
        z = jnp.stack([jnp.where(wide, along, across), jnp.where(wide, across, along)])
        return limit(self.centre + self.radius * z, *self.support), u[2:], _log_area(self.radius)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        z = (x - self.centre) / self.radius
        wide = jnp.abs(z[0]) > jnp.abs(z[1])
        along, across = jnp.where(wide, z[0], z[1]), jnp.where(wide, z[1], z[0])
        long = jnp.copysign(jnp.sqrt(z @ z), along)
        short = long * (4 / np.pi) * jnp.arctan(across / jnp.where(along == 0, 1, along))
        ab = jnp.stack([jnp.where(wide, long, short), jnp.where(wide, short, long)])
        return below_one((ab + 1) / 2), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        return jnp.where(_in_disk(x, self.centre, self.radius), -_log_area(self.radius), -jnp.inf)


class ProjectedCap(Planar):
    """Uniform directions in a spherical cap, projected along its axis: a disk, denser towards the rim.

    The cosine of the angle to the axis is 1 - u0 (1 - `cosine`), where `cosine` in (0, 1) is that of the half-angle;
    p(x) = (1 + cosine) / (2 pi radius^2 cos(theta)), for the disk scaled to `radius`. With respect to the solid angle
    it is constant; the cosine is what projection does to an area.
    """

    cosine: Scalar = eqx.field(converter=parameter, default=0.5)
    centre: Float[Real, " 2"] = eqx.field(converter=parameter, default=(0.0, 0.0))
    radius: Scalar = eqx.field(converter=parameter, default=1.0)

    def __check_init__(self):
        require_disk(self, self.centre, self.radius)
        if is_concrete(self.cosine):
            require(
                bool(0 < self.cosine < 1),
                f"ProjectedCap: the cosine of the half-angle must lie strictly between 0 and 1, not {self.cosine}: "
                "at 0 the density is infinite on the rim",
            )

    @property
    def support(self) -> Corners:
        return self.centre - self.radius, self.centre + self.radius

    @property
    def outline(self) -> Outline:
        return Outline.circle(self.centre, self.radius)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        c = jnp.asarray(self.cosine)
        q = u[0] * (1 - c)  # 1 - cos(theta), so that nothing cancels near the axis
        r = jnp.sqrt(u[0] * (2 - q) / (1 + c))  # sin(theta) over its largest value
        z = r * jnp.stack([cos_turns(u[1]), sin_turns(u[1])])
        x = limit(self.centre + self.radius * z, *self.support)
        return x, u[2:], _log_area(self.radius) + jnp.log(2 * (1 - q) / (1 + c))

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        z, c = (x - self.centre) / self.radius, jnp.asarray(self.cosine)
        u0 = (z @ z) * (1 + c) / (1 + self._cos_theta(x))
        return jnp.stack([below_one(u0), _turns(z)]), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        log_p = jnp.log((1 + self.cosine) / (2 * self._cos_theta(x))) - _log_area(self.radius)
        return jnp.where(_in_disk(x, self.centre, self.radius), log_p, -jnp.inf)

    def _cos_theta(self, x: Float[Array, " 2"]) -> Scalar:
        """Of the direction that is projected to x; outside of the disk, of one on the rim."""
        z, c = (x - self.centre) / self.radius, jnp.asarray(self.cosine)
        return jnp.sqrt(1 - (1 - c * c) * jnp.minimum(z @ z, 1))


class Triangle(Planar):
    """Uniform on a triangle: x = v0 + sqrt(u0) ((1 - u1) (v1 - v0) + u1 (v2 - v0)); singular at v0."""

    vertices: Float[Real, "3 2"] = eqx.field(converter=parameter, default=((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))

    def __check_init__(self):
        require(
            np.shape(self.vertices) == (3, 2),
            f"Triangle: give three vertices in the plane, shape (3, 2), not {np.shape(self.vertices)}",
        )
        if is_concrete(self.vertices):
            v = np.asarray(self.vertices)
            area, size = abs(np.linalg.det(v[1:] - v[0])), np.ptp(v, axis=0).max()
            require(
                bool(np.isfinite(v).all() and area > 1e-6 * size**2),
                f"Triangle: the vertices must be finite and not on one line: {v.tolist()}",
            )

    @property
    def support(self) -> Corners:
        a, b, c = (self.vertices[k] for k in range(3))
        most, least = (jnp.maximum, jnp.minimum) if isinstance(a, jnp.ndarray) else (np.maximum, np.minimum)
        return least(least(a, b), c), most(most(a, b), c)

    @property
    def outline(self) -> Outline:
        return Outline.polygon(np.asarray(self.vertices))

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        one, two = self._sides()
        x = self.vertices[0] + jnp.sqrt(u[0]) * ((1 - u[1]) * one + u[1] * two)
        return limit(x, *self.support), u[2:], jnp.log(jnp.abs(_cross(one, two)) / 2)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        b, c = (jnp.maximum(part, 0) for part in self._barycentric(x))
        s = b + c
        return jnp.stack([below_one(s * s), below_one(c / jnp.where(s > 0, s, 1))]), self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        b, c = self._barycentric(x)
        one, two = self._sides()
        area = jnp.abs(_cross(one, two))
        size = jnp.abs(jnp.asarray(self.vertices)).max() * jnp.maximum(jnp.abs(one).max(), jnp.abs(two).max())
        slack = _ROUNDINGS * jnp.finfo(x.dtype).eps.astype(x.dtype) * (1 + size / area)
        inside = jnp.minimum(jnp.minimum(b, c), 1 - b - c) >= -slack
        return jnp.where(inside, -jnp.log(area / 2), -jnp.inf)

    def _sides(self) -> tuple[Array, Array]:
        v = jnp.asarray(self.vertices)
        return v[1] - v[0], v[2] - v[0]

    def _barycentric(self, x: Float[Array, " 2"]) -> tuple[Scalar, Scalar]:
        """The shares of the second and third vertex in x."""
        one, two = self._sides()
        d = x - self.vertices[0]
        return _cross(d, two) / _cross(one, two), _cross(one, d) / _cross(one, two)


class MarginalConditional(Planar):
    """A table of masses on equal cells of a box: the column by its marginal, then the row by its conditional.

    The 2D importance map of renderers: u0 chooses the column and the place in it, u1 the row and the place in that. A
    cell of mass zero is never made.
    """

    marginal: Float[Real, " nx+1"]
    conditional: Float[Real, "nx ny+1"]
    lower: Float[Real, " 2"]
    upper: Float[Real, " 2"]

    def __init__(self, masses: ArrayLike, lower: ArrayLike = (0.0, 0.0), upper: ArrayLike = (1.0, 1.0)):
        """`masses`: (nx, ny) relative masses, none negative, one positive at least; `lower`, `upper`: the corners."""
        table = np.asarray(masses, np.float64)
        require(
            table.ndim == 2,
            f"MarginalConditional: the masses must be a table of shape (nx, ny), not of {table.ndim} dimensions",
        )
        density_table("MarginalConditional", np.arange(table.size + 1), table.ravel(), cells=True)
        columns = table.sum(1)
        # An empty column is never chosen; equal rows stand in it, so that nothing divides by zero.
        rows = np.where(columns[:, None] > 0, table, 1)
        self.marginal = np.concatenate([[0.0], np.cumsum(columns)]) / columns.sum()
        self.conditional = np.pad(np.cumsum(rows, axis=1), ((0, 0), (1, 0))) / rows.sum(1, keepdims=True)
        self.lower, self.upper = parameter(lower), parameter(upper)
        require_box(self, self.lower, self.upper)

    @property
    def support(self) -> Corners:
        return self.lower, self.upper

    @property
    def outline(self) -> Outline:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        x, y = (np.linspace(lower[k], upper[k], n + 1) for k, n in enumerate(self._shape))
        return Outline.lines(x, y)

    def forward(self, u: Float[Array, " 2"]) -> Forward:
        nx, ny = self._shape
        column, place = choose(self.marginal, u[0])
        rows = jnp.asarray(self.conditional)[column]
        row, height = choose(rows, u[1])
        z = jnp.stack([(column + place) / nx, (row + height) / ny])
        x = limit(self.lower + z * (self.upper - self.lower), self.lower, self.upper)
        return x, u[2:], -self._log_density(column, row)

    def inverse(self, x: Float[Array, " 2"], v: Float[Array, " 0"]) -> Inverse:
        (column, row), place = self._cell(x)
        rows = jnp.asarray(self.conditional)[column]
        u = jnp.stack([unchoose(self.marginal, column, place[0]), unchoose(rows, row, place[1])])
        return u, self.log_prob(x)

    def log_prob(self, x: Float[Array, " 2"]) -> Scalar:
        inside = jnp.all((x >= self.lower) & (x <= self.upper))
        return jnp.where(inside, self._log_density(*self._cell(x)[0]), -jnp.inf)

    @property
    def _shape(self) -> tuple[int, int]:
        return self.conditional.shape[0], self.conditional.shape[1] - 1

    def _cell(self, x: Float[Array, " 2"]) -> tuple[tuple[Index, Index], Float[Array, " 2"]]:
        """The column and row that hold x, and the place inside the cell."""
        n = np.array(self._shape, np.float64).astype(x.dtype)
        z = (x - self.lower) / (self.upper - self.lower) * n
        cell = jnp.clip(jnp.floor(z), 0, n - 1)
        return (cell[0].astype(jnp.int32), cell[1].astype(jnp.int32)), below_one(z - cell)

    def _log_density(self, column: Index, row: Index) -> Scalar:
        nx, ny = self._shape
        mass = width(self.marginal, column) * width(jnp.asarray(self.conditional)[column], row)
        return jnp.log(mass * (nx * ny)) - jnp.log(self.upper - self.lower).sum()


def require_box(owner: eqx.Module, lower: Float[Real, "..."], upper: Float[Real, "..."]) -> None:
    """Raise `ValueError` unless the corners are those of a box in the plane."""
    name = type(owner).__name__
    require(
        np.shape(lower) == np.shape(upper) == (2,),
        f"{name}: the corners must be points of the plane, not of shapes {np.shape(lower)} and {np.shape(upper)}",
    )
    if is_concrete(lower, upper):
        a, b = np.asarray(lower), np.asarray(upper)
        require(
            bool(np.all(np.isfinite(a) & np.isfinite(b) & (a < b))),
            f"{name}: the lower corner must lie under the upper one, both finite, not {a.tolist()} and {b.tolist()}",
        )


def require_disk(owner: eqx.Module, centre: Float[Real, "..."], radius: Scalar) -> None:
    """Raise `ValueError` unless the centre is a point of the plane and the radius positive."""
    require(np.shape(centre) == (2,), f"{type(owner).__name__}: the centre must be a point of the plane, not {centre}")
    if is_concrete(centre):
        require(bool(np.isfinite(centre).all()), f"{type(owner).__name__}: the centre must be finite, not {centre}")
    require_positive(owner, radius=radius)


def _cross(a: Float[Real, " 2"], b: Float[Real, " 2"]) -> Scalar:
    return a[0] * b[1] - a[1] * b[0]


def _log_area(radius: Scalar) -> Scalar:
    return jnp.log(np.pi) + 2 * jnp.log(radius)


def _turns(z: Float[Array, " 2"]) -> Scalar:
    """The angle of z in turns, in [0, 1)."""
    return wrap(jnp.arctan2(z[1], z[0]) / (2 * np.pi))


def _in_disk(x: Float[Array, " 2"], centre: Float[Real, " 2"], radius: Scalar) -> Array:
    """Whether x lies in the disk, or beyond its rim by no more than rounding."""
    z = (x - centre) / radius
    slack = _ROUNDINGS * jnp.finfo(x.dtype).eps.astype(x.dtype) * (1 + jnp.abs(jnp.asarray(centre)).max() / radius)
    return z @ z <= 1 + slack


_LEANING = Triangle([[0.1, 0.2], [0.9, 0.1], [0.3, 0.95]])

EXAMPLES = {
    "rectangle": Rectangle((-1, 0.5), (2, 1)),
    "polar_disk": PolarDisk(),
    "concentric_disk": ConcentricDisk((0.5, 0.4), 0.3),
    "projected_cap": ProjectedCap(0.3, (0.4, 0.6), 0.35),
    "triangle": _LEANING,
    "marginal_conditional": MarginalConditional([[1, 2, 0.5], [0, 0, 0], [4, 0, 1], [0.2, 3, 3]], (-1, 0), (1, 3)),
    "planar_mixture": Mixture(
        (_LEANING, Mixture((Rectangle(), ConcentricDisk((0.6, 0.5), 0.4)), (0.6, 0.4))), (0.3, 0.7)
    ),
}
