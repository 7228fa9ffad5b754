"""What the importance experiments render: a lit room over the square, and a line of pixels with hidden glints."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.moves import LargeStep, Mixture, SmallStep
from mcmc1d.pixels import Pixels
from mcmc1d.rendering import Scene
from mcmc1d.targets import Target
from mcmc1d.techniques import Technique, within
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.types import Array, Corners, Float, Scalar


class Cube(Technique):
    """x = u on the unit cube of d dimensions: density 1."""

    dim: int = eqx.field(static=True, default=2)

    @property
    def dim_u(self) -> int:
        return self.dim

    @property
    def support(self) -> Corners:
        return np.zeros(self.dim), np.ones(self.dim)

    def forward(self, u: Float[Array, " m"]) -> Forward:
        return u, u[self.dim :], jnp.zeros((), u.dtype)

    def inverse(self, x: Float[Array, " d"], v: Float[Array, " 0"]) -> Inverse:
        return x, self.log_prob(x)

    def log_prob(self, x: Float[Array, " d"]) -> Scalar:
        return within(x, jnp.zeros_like(x)).min()


class Room(Target):
    """A lamp of 20, a glow of 0.4 on a wall of 0.02, and a hard shadow, 0.3 of it, below: 3300 to 1 on the square."""

    @property
    def domain(self) -> Corners:
        return np.zeros(2), np.ones(2)

    def log_f(self, x: Float[Array, " 2"]) -> Scalar:
        lamp = (jnp.abs(x[0] - 0.25) < 0.0625) & (jnp.abs(x[1] - 0.75) < 0.0625)
        glow = 0.4 * jnp.exp(-((x[0] - 0.3) ** 2 + (x[1] - 0.7) ** 2) / (2 * 0.15**2))
        f = jnp.where(lamp, 20.0, jnp.where(x[1] < 0.375, 0.3, 1.0) * (0.02 + glow))
        return within(x, jnp.log(f)).min()

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        raise ValueError("Room has points of two coordinates: pixels.masses integrates it over a grid")


ROOM_CUTS = (np.linspace(0, 1, 33),) * 2
"""Its jumps lie on thirty-seconds, between which its glow is smooth."""


def room(side: int = 32) -> Scene:
    """The room on side x side pixels."""
    return Scene(Room(), Cube(), Pixels(side, 2), ROOM_CUTS)


class Glints(Target):
    """A line of pixels, x[0], with a hidden x[1]: smooth on the left half, on the right a narrow band of paths.

    Given x[0], f is L(x[0]) times a density of x[1] that is cut to [0, 1] and hardly loses by it; the band is 0.01
    wide and wanders. L is 20 in a lamp of four pixels, 0.05 to 1 elsewhere.
    """

    @property
    def domain(self) -> Corners:
        return np.zeros(2), np.ones(2)

    def log_f(self, x: Float[Array, " 2"]) -> Scalar:
        left = x[0] < 0.5
        lamp = (x[0] >= 0.125) & (x[0] < 0.1875)
        light = jnp.where(lamp, 20.0, 0.05 + 0.95 * jnp.where(left, x[0] * 2, x[0] - 0.5) ** 2)
        width = jnp.where(left, 0.25, 0.01)
        centre = jnp.where(left, 0.5, 0.5 + 0.2 * jnp.sin(2 * jnp.pi * x[0]))
        log_g = -0.5 * ((x[1] - centre) / width) ** 2 - jnp.log(width * np.sqrt(2 * np.pi))
        return within(x, jnp.log(light) + log_g).min()

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        raise ValueError("Glints has points of two coordinates: pixels.masses integrates it over a grid")


GLINTS_CUTS = (np.linspace(0, 1, 65), np.linspace(0, 1, 51))
"""Fine enough for the band, on which Gauss-Legendre's rule then is exact to 1e-9."""


def glints(side: int = 64, importance: Target | None = None) -> Scene:
    """The glints on a line of pixels, sampled by f unless another importance is given."""
    return Scene(Glints(), Cube(), Pixels(side), GLINTS_CUTS, importance)


def walk(large: float = 0.1, sigma: float = 0.03) -> Mixture:
    """Large steps with that probability, else small ones (Kelemen et al. 2002)."""
    return Mixture({"large": (large, LargeStep()), "small": (1 - large, SmallStep(sigma))})
