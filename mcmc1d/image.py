"""The image that a chain makes which samples any importance function I: deposits of f / I, times the integral of I."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance
from mcmc1d.estimators import Estimator
from mcmc1d.examples import Examples
from mcmc1d.importance import require_importance, require_sampled
from mcmc1d.metropolis import Kernel, Step
from mcmc1d.numerics import is_concrete
from mcmc1d.pixels import Pixels
from mcmc1d.state import Multiplexed
from mcmc1d.targets import Target
from mcmc1d.types import Array, Float, Scalar


class Image(Estimator):
    """Algorithm 1 of Hoberock and Hart 2010, lines 6 and 7: f / I at each deposit, into the pixel that it falls in.

    The sums have the shape (pixels, 5): the weights alone (the sample density), times z = f / I, times z f, times
    1 / I, times z^2; `Film` turns them into an image once b_I is known. Raises `ValueError` where I is negative,
    infinite, NaN, or vanishes where f does not, which `allow_loss` permits.
    """

    f: Target
    importance: Target
    pixels: Pixels

    def __init__(self, f: Target, importance: Target, pixels: Pixels, *, allow_loss: bool = False):
        """`importance`: what the chain samples; `pixels`: over the first coordinates of x."""
        require_instance(f, Target, "Image: f")
        require_instance(pixels, Pixels, "Image: the pixels")
        if is_concrete(f, importance):
            pixels.require_under(f)
            require_importance(f, importance, allow_loss=allow_loss)
        self.f, self.importance, self.pixels = f, importance, pixels

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, "n 5"]:
        require(
            np.shape(target.target.domain[0]) == np.shape(self.f.domain[0]),
            f"Image: {type(self.f).__name__} and {type(target.target).__name__} have points of different shapes",
        )
        if is_concrete(target.target, self.importance):
            require_sampled(target.target, self.importance)
        return jnp.zeros((self.pixels.count, 5), dtype)

    def update(self, sums: Float[Array, "n 5"], steps: Step) -> Float[Array, "n 5"]:
        deposits = steps.deposits
        # The chains are the last axis of x, after its own.
        rows = jax.vmap(jax.vmap(self.row, in_axes=-1))(deposits.x, deposits.weight)
        cells = jax.vmap(jax.vmap(self.pixels.cell, in_axes=-1))(deposits.x)
        return sums.at[jnp.ravel(cells)].add(rows.reshape(-1, 5))

    def row(self, x: Float[Array, "..."], weight: Scalar) -> Float[Array, " 5"]:
        """What a point of that weight adds to its pixel."""
        log_f, log_i = self.f.log_f(x), self.importance.log_f(x)
        # No chain stands where I is zero; a deposit there, of weight zero, stands for nothing.
        z = jnp.where(jnp.isneginf(log_i), 0, jnp.exp(log_f - log_i))
        return weight * film_row(z, jnp.exp(log_f), reciprocal(log_i))


def reciprocal(log_i: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 / I, limited to e^80: its tail is heavy, of which `Film.variance` has more to say, and would overflow."""
    return jnp.exp(jnp.minimum(-log_i, 80))


def film_row(z: Float[Array, "..."], f: Float[Array, "..."], per: Float[Array, "..."]) -> Float[Array, "... 5"]:
    """The columns of `Film`, of samples of z = f / I, with `per` = 1 / I: 1, z, z f, 1 / I, z^2."""
    return jnp.stack([jnp.ones_like(z), z, z * f, per, z * z], -1)


class Film(eqx.Module):
    """What one or more runs put on an image, in absolute scale: float64 sums, of shape (..., pixels) each."""

    samples: float
    """Steps of all chains together, the work of a run."""
    density: np.ndarray
    """The deposits' weights: how often each pixel was sampled."""
    value: np.ndarray
    integral: np.ndarray
    """For Eq. 2: of f^2, integrated as f is."""
    area: np.ndarray
    """And of 1: the pixel's area, but for what no chain visits."""
    contribution: np.ndarray
    """Of (f / p)^2, for the variance of independent samples."""

    @staticmethod
    def of(sums: ArrayLike, b: ArrayLike, samples: float) -> "Film":
        """`sums`: of `Image`, over all steps; `b`: the integral of I, exact or estimated; one, or one for each."""
        rows = np.moveaxis(np.asarray(sums, np.float64), -1, 0)
        scale = np.asarray(b, np.float64)[..., None]
        return Film(float(samples), rows[0], scale * rows[1], scale * rows[2], scale * rows[3], scale**2 * rows[4])

    def plus(self, other: "Film") -> "Film":
        """Both together; a longer run weighs more."""
        return jax.tree.map(lambda a, b: a + b, self, other)

    def scaled(self, factor: ArrayLike) -> "Film":
        """The film of f times a factor: one, or one for each image."""
        scale = np.asarray(factor, np.float64)[..., None]
        moved = scale * self.value, scale**2 * self.integral, self.area, scale**2 * self.contribution
        return Film(self.samples, self.density, *moved)

    def image(self) -> np.ndarray:
        """The mean of f in each pixel, estimated."""
        return self.value * self.value.shape[-1] / self.samples

    def variance(self, kind: str = "integral") -> np.ndarray:
        """The running variance of each pixel: consistent, and biased as it uses the image's own mean.

        `"integral"`: Eq. 2 of Hoberock and Hart 2010, of f inside the pixel, as a sum of (f - I)^2 / p;
        `"contribution"`: of f / p, a sample's contribution to the pixel, which is that of the image if samples are
        independent (divide by `samples`). The paper's Eq. 3 prints 1 / p before (f / p - I)^2, which estimates neither.
        """
        require(kind in ("integral", "contribution"), f'variance: kind must be "integral" or "contribution": {kind!r}')
        n, mean = self.value.shape[-1], self.image()
        if kind == "contribution":
            return np.maximum(self.contribution * n**2 / self.samples - mean**2, 0)
        # The area is known, to be 1. Its estimate errs as the other sums do, so that a flat f gets next to no variance;
        # it is limited to 2, because 1 / p has no variance where f vanishes.
        squares, area = self.integral * n / self.samples, np.minimum(self.area * n / self.samples, 2)
        return np.maximum(squares - 2 * mean * mean + mean**2 * area, 0)


def _examples() -> dict[str, Image]:
    from mcmc1d.importance import EXAMPLES as FUNCTIONS
    from mcmc1d.targets import Sinusoid

    return {"image": Image(Sinusoid(), FUNCTIONS["product"], Pixels(10))}


EXAMPLES = Examples(_examples)
