"""Images of flatland: what chains and independent samples put on the film, in absolute scale."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.chain import Run
from mcmc1d.checks import require, require_instance, require_key, require_whole
from mcmc1d.estimators import Estimator, add_deposits
from mcmc1d.examples import Examples
from mcmc1d.flatland.paths import EXAMPLES as LIT
from mcmc1d.flatland.paths import Light, Paths
from mcmc1d.flatland.sampling import exposed
from mcmc1d.metropolis import Kernel, Step
from mcmc1d.numerics import cast
from mcmc1d.starts import Normalisation, require_multiplexed
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Float, Key


class Picture(NamedTuple):
    """An image and its standard error, each of shape (pixels,): mean radiance of a pinhole, irradiance of a wall."""

    value: np.ndarray
    error: np.ndarray

    def plus(self, other: "Picture") -> "Picture":
        """The sum of two that are independent, such as those of two path lengths."""
        return Picture(self.value + other.value, np.hypot(self.error, other.error))


class Exposure(Estimator):
    """The deposits' weight in each pixel: sums of shape (pixels,); times b and the pixels, per step, the image."""

    paths: Paths

    def __check_init__(self):
        require_instance(self.paths, Paths, "Exposure: the paths")

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, " n"]:
        shape = np.shape(target.target.domain[0])
        require(
            shape == (self.paths.dim,),
            f"Exposure: for paths of {self.paths.dim} numbers, not for points of shape {shape}",
        )
        return jnp.zeros(self.paths.sensor.pixels, dtype)

    def update(self, sums: Float[Array, " n"], steps: Step) -> Float[Array, " n"]:
        pixel = jax.vmap(cast(self.paths, steps.deposits.x.dtype).pixel, in_axes=-1)
        return add_deposits(sums, steps.deposits, pixel, joint=False)


def picture(run: Run, name: str, b: float | Normalisation) -> Picture:
    """The image of an `Exposure` called `name` in a run of two blocks or more; b: the integral of what was sampled.

    Known, or as `normalisation` estimates it: then its error is part of the image's.
    """
    value, error = b if isinstance(b, Normalisation) else (b, 0.0)
    number = np.ndim(value) == 0 and np.asarray(value).dtype.kind in "iuf"
    require(number, f"picture: b is a number, or a Normalisation, not {b!r}")
    deposits = require_instance(run, Run, "picture: the run").mean(name)
    pixels = deposits.shape[-1]
    return Picture(
        float(value) * pixels * deposits, pixels * np.hypot(float(value) * run.standard_error(name), error * deposits)
    )


def independent(key: Key, target: Multiplexed, samples: int) -> Picture:
    """Monte Carlo with `target`'s techniques and weights: independent samples (i, u) of its states.

    Bidirectional path tracing where the techniques are all of `Bidirectional`; path or light tracing with some.
    `samples`: rounded up to a multiple of 4096, which are drawn at once.
    """
    require_multiplexed(target, "independent")
    light = require_instance(target.target, Light, "independent: what is multiplexed")
    require_key(key, "independent")
    require_whole(samples, "independent: samples")
    found = exposed(key, target, light.paths, samples, np.inf)
    pixels = light.paths.sensor.pixels
    return Picture(pixels * found.mean, pixels * found.error)


EXAMPLES = Examples(lambda: {"exposure": Exposure(LIT["light"].paths)})
