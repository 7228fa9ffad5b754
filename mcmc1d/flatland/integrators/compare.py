"""An integrator's image against an exact one, pixel by pixel, at a level that holds for every number of samples.

What is summed is bounded, by 1 or by the brightest that a path's f / p can be, so that a deviation's probability is
known without a central limit: rare bright paths, which no sample variance has seen, are paid for by the bound.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from mcmc1d.checks import require, require_instance
from mcmc1d.flatland.integrators.image import Image, Layer, Stacked
from mcmc1d.flatland.sampling import Sums


class Comparison(NamedTuple):
    """Rows: each length, then the total. A pixel fails where its excess is over 1."""

    excess: np.ndarray
    """The difference from the exact value, less that value's own error, in radii of the test; (rows, pixels)."""
    detectable: np.ndarray
    """The error that would be found with probability 0.99, relative to the pixel or, if larger, the image's mean.

    To the mean of the total in a length that the exact image has dark. Infinite where what is summed has no bound, or
    the exact image is dark in all and the other is not; zero where both are dark.
    """

    def __str__(self) -> str:
        pixels, finite = self.excess.shape[1], self.detectable[np.isfinite(self.detectable)]
        worst = (
            f"the worst of {pixels} pixels, in each length and in total, is at {self.excess.max():.2f} of what fails"
        )
        if self.differs:
            return f"differs: {worst}"
        found = "nothing would be found in some" if finite.size < self.detectable.size else ""
        if not found:
            found = f"an error of {finite.min():.1%} to {finite.max():.1%} of a pixel would be found"
        return f"{'agrees' if self.agrees else 'undecided'}: {worst}; {found}"

    @property
    def agrees(self) -> bool:
        """Whether every pixel of every row does, and could have been found not to."""
        return bool(np.all(self.excess <= 1) and np.all(np.isfinite(self.detectable)))

    @property
    def differs(self) -> bool:
        """Whether some pixel can not be a right integrator's; neither this nor `agrees` where nothing can be told."""
        return bool(np.any(self.excess > 1))


def bernstein_radius(sums: Sums, level: float) -> np.ndarray:
    """How far a mean of independent numbers in [0, bound] strays at most, but with probability `level`.

    Maurer and Pontil 2009, "Empirical Bernstein bounds and sample variance penalization", theorem 4, on either side.
    """
    log = np.log(4 / level)
    return np.sqrt(2 * sums.variance * log / sums.size) + 7 * sums.bound * log / (3 * (sums.size - 1))


def radius(layers: Sequence[Layer | Stacked], level: float) -> np.ndarray:
    """How far the sum of these layers strays from the exact one at most, in each pixel, but with probability `level`.

    b' d' - b d = b (d' - d) + d (b' - b) + (b' - b) (d' - d), with d a layer's mean deposit and b what normalises it.
    The first two are of independent numbers, summed over all layers: at half the level, for those alone, by Bernstein's
    inequality. The standard deviations and the b and d in them are replaced by upper bounds, and the third is bounded,
    at the other half: `bernstein_radius`; Maurer and Pontil 2009, theorem 10, for a standard deviation.

    The layers of a stack depend on those before them: then the sum is a martingale, see `_martingale_radius`.
    """
    stacked = any(isinstance(layer, Stacked) for layer in layers)
    parts = [part for layer in layers for part in (layer.layers if isinstance(layer, Stacked) else (layer,))]
    events = sum(1 if part.normaliser is None else 4 for part in parts)
    small = level / (2 * events)
    variances, ranges, beyond = [], [], np.zeros(())

    def add(sums: Sums, factor: np.ndarray) -> None:
        deviation = np.sqrt(sums.variance) + sums.bound * np.sqrt(2 * np.log(1 / small) / (sums.size - 1))
        variances.append((factor * deviation) ** 2 / sums.size)
        ranges.append(factor * sums.bound / sums.size)

    for part in parts:
        d, b, scale = part.deposits, part.normaliser, np.broadcast_to(part.scale, part.deposits.total.shape)
        if b is None:
            add(d, scale)
            continue
        of_d, of_b = bernstein_radius(d, small), bernstein_radius(b, small)
        add(d, scale * (b.mean + of_b))
        add(b, scale * (d.mean + of_d))
        beyond = beyond + scale * of_d * of_b
    if stacked:
        return _martingale_radius(np.array(variances), np.array(ranges), level) + beyond
    log, variance = np.log(4 / level), np.sum(variances, axis=0)
    tail = np.max(ranges, axis=0) * log / 3
    return tail + np.sqrt(tail**2 + 2 * variance * log) + beyond


_RATES = 2.0 ** np.arange(-64, 64, 0.25)
"""One over any radius that an image can have."""


def _martingale_radius(variances: np.ndarray, ranges: np.ndarray, level: float) -> np.ndarray:
    """Of sums whose variances and ranges, (sums, pixels), are known only once the sums before them are.

    Freedman 1975, "On tail probabilities for martingales", in the form that holds whatever variances the past brings
    about: for each rate r chosen beforehand, exp(r sum - r^2 / 2 total of variance / (1 - r range / 3)) has a mean of 1
    at most. The best of the rates is taken, and paid for by their number.
    """
    log = np.log(4 * len(_RATES) / level)
    rates = _RATES[:, None, None]
    left = 1 - rates * ranges / 3
    total = np.sum(np.divide(variances, left, out=np.full_like(left, np.inf), where=left > 0), axis=1)
    return (_RATES[:, None] / 2 * total + log / _RATES[:, None]).min(0)


_DARK = 1e-12
"""Of the light of all lengths: less than this share is none."""


def compare(image: Image, values: np.ndarray, errors: np.ndarray | None = None, level: float = 1e-5) -> Comparison:
    """Hold an image to exact `values`, (lengths, pixels), known to `errors`: each length, and the total.

    `level`: that any pixel of a right integrator fails, all rows together (a union bound). Raises `ValueError` where
    the shapes do not fit, or a number of either image is NaN or infinite.
    """
    require_instance(image, Image, "compare: the image")
    known = isinstance(level, int | float | np.floating) and 0 < level < 1
    require(known, f"compare: the level is a probability over 0 and under 1, not {level!r}")
    values = _numbers("the exact image", values)
    errors = np.zeros_like(values) if errors is None else _numbers("its errors", errors)
    require(
        values.shape == errors.shape == image.values.shape,
        f"compare: the image has {image.values.shape} lengths and pixels; the exact one {values.shape}, its errors "
        f"{errors.shape}",
    )
    for what, numbers in (("the image", image.values), ("the exact image", values), ("its errors", errors)):
        require(bool(np.isfinite(numbers).all()), f"compare: {what} is NaN or infinite somewhere")
    require(bool((errors >= 0).all()), "compare: the exact image's errors must not be negative")
    lengths, pixels = values.shape
    each = level / (pixels * (lengths + 1))
    around = np.stack([radius([layer], each) for layer in image.layers] + [radius(image.layers, each)])
    found = np.concatenate([image.values, image.total[None]])
    error = np.concatenate([image.errors, image.total_error[None]])
    exact = np.concatenate([values, values.sum(0)[None]])
    known = np.concatenate([errors, errors.sum(0)[None]])
    missed = np.maximum(np.abs(exact - found) - known, 0)
    excess = np.where(missed > 0, missed / np.maximum(around, np.finfo(np.float64).tiny), 0)
    mean = exact.mean(1, keepdims=True)
    # What is left of a dark length by rounding is no scale.
    scale = np.maximum(exact, np.where(mean > _DARK * mean[-1], mean, mean[-1]))
    widest = np.where((scale > 0) | (found > 0), around + known - ndtri(0.01) * error, 0)
    detectable = np.divide(widest, scale, out=np.where(widest > 0, np.inf, 0), where=scale > 0)
    return Comparison(excess, detectable)


def _numbers(what: str, given: Any) -> np.ndarray:
    try:
        return np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"compare: {what} must be an array of numbers, (lengths, pixels), not a {type(given).__name__}; "
            "of a Reference give both, its values and its errors"
        ) from None


__all__ = ["Comparison", "bernstein_radius", "compare", "radius"]
