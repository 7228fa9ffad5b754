"""How an image's error looks: the eye's threshold, the errors and statistics of Hoberock and Hart 2010, Table 1."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require
from mcmc1d.pixels import resample

EXPOSURE = 50.0
"""Luminance in cd/m^2 of a pixel of value 1, or of an image's mean; ours: a display's middle, where the paper's scenes
are not said to lie."""


def tvi(luminance: ArrayLike) -> np.ndarray:
    """The threshold-versus-intensity function: the smallest difference seen on a background, both in cd/m^2.

    Ward, Rushmeier, Piatko 1997, section 4.1: rods and cones in five pieces of log10, from constant in the dark to
    Weber's law in the light.
    """
    with np.errstate(divide="ignore"):
        x = np.log10(np.asarray(luminance, np.float64))
    pieces = [
        np.full_like(x, -2.86),
        np.maximum(0.405 * x + 1.6, 0) ** 2.18 - 2.86,
        x - 0.395,
        np.maximum(0.249 * x + 0.65, 0) ** 2.7 - 0.72,
        x - 1.255,
    ]
    return np.asarray(10.0 ** np.select([x < -3.94, x < -1.44, x < -0.0184, x < 1.9], pieces[:4], pieces[4]))


class Density(NamedTuple):
    """Moments of the sample density over the pixels, its mean scaled to one (Eq. 4 and 5)."""

    variance: Any
    skew: Any
    kurtosis: Any


def density_statistics(density: np.ndarray) -> Density:
    """Variance, skew and excess kurtosis over the last axis; 0, 0 and -3 where all are equal, as in Table 1."""
    deviation = density / density.mean(-1, keepdims=True) - 1
    second, third, fourth = ((deviation**k).mean(-1) for k in (2, 3, 4))
    safe = np.where(second > 0, second, 1)
    return Density(second, third / safe**1.5, fourth / safe**2 - 3)


def error(image: np.ndarray, exact: np.ndarray) -> Any:
    """The mean squared error (Eq. 6) over the last axis."""
    return ((image - exact) ** 2).mean(-1)


def visual_error(image: np.ndarray, exact: np.ndarray, exposure: float = EXPOSURE) -> Any:
    """The mean of the absolute error in just noticeable differences (Eq. 7), over the last axis."""
    return (exposure * np.abs(image - exact) / tvi(exposure * exact)).mean(-1)


def efficiency(error: ArrayLike, work: ArrayLike) -> Any:
    """1 / (work error), for either error; the work in steps, the paper's in rays."""
    return 1 / (np.asarray(error) * np.asarray(work))


def downsampled(image: np.ndarray, axes: int, factor: int) -> np.ndarray:
    """Means over about `factor` pixels a side, at the image's own resolution: what one pixel's noise can not move."""
    side = image.shape[-1]
    small = resample(image, max(1, round(side / factor)), axes)
    return resample(small, side, axes)


def bilateral(image: np.ndarray, axes: int, width: float, contrast: np.ndarray) -> np.ndarray:
    """Tomasi and Manduchi 1998: Gaussian in place (of `width` pixels) and in value (of `contrast`, one an image).

    Cut at two widths, and at the borders, where the rest is rescaled.
    """
    require(axes in (1, 2), f"bilateral: an image has one or two axes, not {axes}")
    reach = int(np.ceil(2 * width))
    pad = [(0, 0)] * (image.ndim - axes) + [(reach, reach)] * axes
    padded = np.pad(image, pad, constant_values=np.nan)
    scale = np.maximum(np.asarray(contrast, np.float64), 1e-300).reshape((-1,) + (1,) * axes)
    total, weights = np.zeros_like(image), np.zeros_like(image)
    for shift in np.ndindex(*(2 * reach + 1,) * axes):
        own = tuple(slice(s, s + n) for s, n in zip(shift, image.shape[-axes:], strict=True))
        near = padded[(..., *own)]
        distance = sum((s - reach) ** 2 for s in shift) / width**2
        weight = np.exp(-0.5 * (distance + ((near - image) / scale) ** 2))
        weight = np.where(np.isnan(near), 0, weight)
        total += np.where(weight > 0, weight * near, 0)
        weights += weight
    return total / weights


def noise_target(
    mean: np.ndarray,
    variance: np.ndarray,
    axes: int,
    *,
    exposure: float = EXPOSURE,
    factor: int = 4,
    contrast: float = 2.0,
    width: float = 1.0,
) -> np.ndarray:
    """The visible noise of images (replicas, side) or (replicas, side, side): Hoberock and Hart 2010, section 4.3.5.

    The root of the variance, over `tvi` of the mean downsampled by `factor`; limited in `contrast`, by which the 95th
    percentile may exceed the 5th; clamped to both; black pixels set to the 95th; smoothed by a bilateral filter of
    `width` pixels. The paper gives the percentiles and the contrast of 2. Ours: the factor of 4; the contrast is
    limited by adding a constant, which keeps the order and lifts zeros; the percentiles are those of the pixels that
    are lit; the filter is one pixel wide and as high as half the span that clamping leaves.
    """
    places = tuple(range(-axes, 0))
    visible = np.sqrt(variance) / tvi(exposure * downsampled(mean, axes, factor))
    black = mean <= 0
    lit = np.where(black & ~black.all(places, keepdims=True), np.nan, visible)
    low, high = np.nanpercentile(lit, [5, 95], axis=places, keepdims=True)
    lift = np.maximum((high - contrast * low) / (contrast - 1), 0)  # (high + lift) / (low + lift) <= contrast
    clamped = np.clip(visible, low, high)
    target = np.where(black, high, clamped) + lift
    target = bilateral(target, axes, width, (high - low) / 2)
    # Nothing is visible where all is black or exact: then every pixel is as good as another.
    scale = target.mean(places, keepdims=True)
    return np.where(scale > 0, target / np.where(scale > 0, scale, 1), 1)
