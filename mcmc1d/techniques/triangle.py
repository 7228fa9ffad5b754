"""A triangle, uniformly."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require
from mcmc1d.examples import Examples
from mcmc1d.numerics import below_one, is_concrete, limit, parameter
from mcmc1d.quadrature import Outline
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.techniques.planar import ROUNDINGS, Planar
from mcmc1d.types import Array, Corners, Float, Real, Scalar


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
        slack = ROUNDINGS * jnp.finfo(x.dtype).eps.astype(x.dtype) * (1 + size / area)
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


def _cross(a: Float[Real, " 2"], b: Float[Real, " 2"]) -> Scalar:
    return a[0] * b[1] - a[1] * b[0]


EXAMPLES = Examples(lambda: {"triangle": Triangle([[0.1, 0.2], [0.9, 0.1], [0.3, 0.95]])})
