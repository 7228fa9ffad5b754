"""Integrators in independent passes: what is walked from the lamps once in each, many camera paths have in common."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.compiling import wide_jit
from mcmc1d.flatland.integrators.base import Integrator
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.sampling import Sums
from mcmc1d.flatland.scene import Scene
from mcmc1d.numerics import below_one, cast, stratum
from mcmc1d.random import uniforms
from mcmc1d.types import Array, Float, Key

_LANES = 2**5
"""Passes at once."""


class Passes(Integrator):
    """Passes of `cameras` camera paths each, stratified over the film; `samples` counts the camera paths.

    Paths of one pass depend on one another; passes do not, and the standard error is theirs.
    """

    cameras: eqx.AbstractVar[int]

    @abc.abstractmethod
    def numbers(self, paths: Paths) -> tuple[int, int]:
        """How many numbers each camera path reads, first that of the film; and how many a pass reads beside them."""

    @abc.abstractmethod
    def gather(self, paths: Paths, own: Float[Array, "n cameras"], shared: Float[Array, " m"]) -> Float[Array, " c"]:
        """What each camera path of a pass brings to its pixel."""

    @abc.abstractmethod
    def most(self, scene: Scene, edges: int) -> float:
        """What no camera path exceeds; inf where that is not known, or where there is no such number."""

    @abc.abstractmethod
    def rays(self, paths: Paths) -> float:
        """Of a pass."""

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        self.check(scene, edges)
        paths, pixels = Paths(scene, edges), scene.sensor.pixels
        steps = max(2, -(-samples // (self.cameras * _LANES)))
        lanes = _summed(key, self, paths, jnp.asarray(steps))
        total, squares = (np.asarray(part, np.float64).sum(-1) for part in lanes)
        if not np.all(np.isfinite(squares)):
            name = type(self).__name__
            raise ValueError(f"{name}: scene {scene.name}: the light of a path is NaN or infinite; look at its lamps")
        # Strata that a pixel has a part in; where they do not fill it, two at its ends are shared with others.
        strata = self.cameras // pixels + (0 if self.cameras % pixels == 0 else 2)
        bound = min(1.0, strata / self.cameras) * self.most(scene, edges)
        passes = steps * _LANES
        return Layer(edges, float(pixels), Sums(passes, total, squares, bound), None, passes * self.rays(paths))


@wide_jit
def _summed(key: Key, integrator: Passes, paths: Paths, steps: Array) -> tuple[Array, Array]:
    """Of each pixel and lane the sum over `steps` passes of the mean over the cameras, and that of its square."""
    dtype = jnp.zeros(()).dtype
    integrator, paths = cast((integrator, paths), dtype)
    cameras, pixels = integrator.cameras, paths.sensor.pixels
    each, shared = integrator.numbers(paths)
    strata, row = jnp.arange(cameras, dtype=dtype), jnp.arange(pixels)[:, None]

    def one(numbers: Array) -> Array:
        own = numbers[: each * cameras].reshape(each, cameras)
        own = own.at[0].set(below_one((strata + own[0]) / cameras))
        pixel = stratum(own[0], pixels)
        light = integrator.gather(paths, own, numbers[each * cameras :])
        return jnp.where(pixel[None] == row, light[None], 0).sum(1) / cameras

    def body(step: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        numbers = uniforms(key, step, (each * cameras + shared, _LANES), dtype)
        value = jax.vmap(one, in_axes=-1, out_axes=-1)(numbers)
        return sums[0] + value, sums[1] + value * value

    zero = jnp.zeros((pixels, _LANES), dtype)
    return jax.lax.fori_loop(0, steps, body, (zero, zero))


__all__ = ["Passes"]
