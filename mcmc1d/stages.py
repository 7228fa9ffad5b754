"""Importance functions that adapt in stages (Hoberock and Hart 2010, sections 4.2 and 4.3)."""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from mcmc1d.checks import require, require_positive, require_whole
from mcmc1d.image import Film
from mcmc1d.perception import noise_target
from mcmc1d.pixels import Pixels, resample


class Stage(NamedTuple):
    """One run of Metropolis: the regions a side of its importance function, and its samples."""

    regions: int
    samples: int


def plan(side: int, samples: int, scheme: str = "text", linear: int = 10) -> list[Stage]:
    """The stages of Algorithm 2: k doubles to half of `side`, then grows linearly to `side`, with k M samples each.

    The text and the listing differ. `"text"`: a quarter of the samples goes to the doubling, the rest to `linear`
    (10) stages above half. `"listing"`: k M throughout, and half the side comes again: eleven stages, and about
    10.8 % for the doubling. Sides that are not whole are rounded.

    Raises `ValueError` unless the numbers are whole and positive, `side` 2 at least, and there is such a scheme.
    """
    for name, value in {"side": side, "samples": samples, "linear": linear}.items():
        require_whole(value, f"plan: {name}")
    require(side >= 2, f"plan: an image of {side} pixel a side has no stages; give 2 at least")
    require(scheme in ("text", "listing"), f'plan: scheme must be "text" or "listing", not {scheme!r}')
    doubling = [2**j for j in range(side.bit_length()) if 2**j <= side / 2]
    first = 0 if scheme == "listing" else 1
    growing = [side / 2 + j * side / (2 * linear) for j in range(first, linear + 1)]
    if scheme == "listing":
        shares = np.array([*doubling, *growing]) / (sum(doubling) + sum(growing))
    else:
        shares = np.concatenate([0.25 * np.array(doubling) / sum(doubling), 0.75 * np.array(growing) / sum(growing)])
    counts = np.maximum(np.round(shares * samples).astype(int), 1)
    return [Stage(round(k), int(n)) for k, n in zip([*doubling, *growing], counts, strict=True)]


class MultiStage(eqx.Module):
    """f over the region's share of the image so far (section 4.2); f itself while there is none.

    I = f / (I_k / mean I_k), so that its integral is the whole image's where I_k is right. A region that has got less
    than `floor` of the mean counts as that much: the paper does not say what becomes of a region without a sample,
    over which f / I_k is infinite. Ours, and a guard against rare samples with enormous weights.
    """

    pixels: Pixels
    floor: float = 0.01

    def __check_init__(self):
        require_positive(self, floor=self.floor)

    def __call__(self, film: Film | None, regions: int) -> np.ndarray:
        if film is None:
            return np.ones((1,) + (regions,) * self.pixels.dim)
        return 1 / self.relative(film.image(), regions)

    def relative(self, image: np.ndarray, regions: int) -> np.ndarray:
        """The image's regions over their mean, floored."""
        square = image.reshape(image.shape[:-1] + (self.pixels.side,) * self.pixels.dim)
        coarse = resample(square, regions, self.pixels.dim)
        mean = coarse.mean(tuple(range(-self.pixels.dim, 0)), keepdims=True)
        return np.maximum(coarse / np.where(mean > 0, mean, 1), self.floor)


class NoiseAware(eqx.Module):
    """The visible noise (`perception.noise_target`) times what `MultiStage` has (section 4.3.5)."""

    base: MultiStage
    exposure: float
    variance: str = "integral"

    def __check_init__(self):
        require_positive(self, exposure=self.exposure)

    def __call__(self, film: Film | None, regions: int) -> np.ndarray:
        base = self.base(film, regions)
        if film is None:
            return base
        axes, side = self.base.pixels.dim, self.base.pixels.side
        mean, variance = (
            resample(a.reshape(a.shape[:-1] + (side,) * axes), regions, axes)
            for a in (film.image(), film.variance(self.variance))
        )
        return base * noise_target(mean, variance, axes, exposure=self.exposure)
