"""Importance functions of flatland (Hoberock and Hart 2010): what a chain samples in place of the light."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance, require_positive
from mcmc1d.examples import Examples
from mcmc1d.flatland.paths import EXAMPLES as LIT
from mcmc1d.flatland.paths import Light, LightTimes, Paths
from mcmc1d.flatland.scene import Scene
from mcmc1d.numerics import is_concrete, parameter
from mcmc1d.types import Array, Bool, Float, Real, Scalar


class Shader(eqx.Module):
    """A factor on the paths for which a predicate holds: an importance shader (section 4.1, which has 10)."""

    predicate: Callable[[Paths, Float[Array, " d"]], Bool[Array, ""]]
    """Of the space of paths and a path; see `Touches`."""
    factor: Scalar = eqx.field(converter=parameter, default=10.0)

    def __check_init__(self):
        require_positive(self, factor=self.factor)  # 0 would lose the light that it hides

    def log_factor(self, paths: Paths, x: Float[Array, " d"]) -> Scalar:
        """Log of the factor of a path."""
        return jnp.where(self.predicate(paths, x), jnp.log(jnp.asarray(self.factor)), 0)


class Touches(eqx.Module):
    """Whether a path is scattered on one of the segments whose names start so, as the paper's paths by the head."""

    segments: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, scene: Scene, name: str):
        """`ValueError` where no segment's name starts with `name`."""
        self.segments = tuple(k for k, segment in enumerate(scene.segments) if segment.name.startswith(name))
        known = ", ".join(sorted({segment.name for segment in scene.segments}))
        require(bool(self.segments), f"Touches: scene {scene.name} has no segment {name!r}; known: {known}")

    def __call__(self, paths: Paths, x: Float[Array, " d"]) -> Bool[Array, ""]:
        between = paths.segments(x)[1:-1]
        return jnp.any(between[:, None] == jnp.asarray(self.segments)[None])


class OverPixels(LightTimes):
    """I = f times a number for each pixel, which may be traced, and times a shader's factor.

    Within a pixel it is in proportion to f, as the paper's appendix asks, but for the shader.
    """

    light: Light
    values: Float[Real, " pixels"] = eqx.field(converter=parameter)
    shader: Shader | None = None

    def __check_init__(self):
        shape = (self.light.paths.sensor.pixels,)
        require(
            np.shape(self.values) == shape,
            f"OverPixels: values are one number for each of {shape[0]} pixels, not of shape {np.shape(self.values)}",
        )
        if is_concrete(self.values):
            values = np.asarray(self.values)
            require(
                bool(np.all(np.isfinite(values) & (values > 0))),
                f"OverPixels: values must be positive and finite, or a pixel's light is lost, not {values}",
            )
        if self.shader is not None:
            require_instance(self.shader, Shader, "OverPixels: the shader")

    def log_factor(self, x: Float[Array, " d"]) -> Scalar:
        value = jnp.log(jnp.asarray(self.values))[self.light.paths.pixel(x)]
        return value if self.shader is None else value + self.shader.log_factor(self.light.paths, x)


EXAMPLES = Examples(
    lambda: {"over_pixels": OverPixels(LIT["light"], np.linspace(1, 2, LIT["light"].paths.sensor.pixels))}
)

__all__ = ["EXAMPLES", "OverPixels", "Shader", "Touches"]
