"""An integrator's image against an exact one, pixel by pixel, at a level that holds for every number of samples.

What is summed is bounded, by 1 or by the brightest that a path's f / p can be, so that a deviation's probability is
known without a central limit: rare bright paths, which no sample variance has seen, are paid for by the bound.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from mcmc1d.flatland.integrators.image import Image, Layer, Stacked, Sums
from mcmc1d.numerics import require


class Comparison(NamedTuple):
    """Rows: each length, then the total. A pixel fails where its excess is over 1."""

    excess: np.ndarray
    """The difference from the exact value, less that value's own error, in radii of the test; (rows, pixels)."""
    detectable: np.ndarray
    """The error that would be found with probability 0.99, relative to the pixel or, if larger, the image's mean."""

    @property
    def agrees(self) -> bool:
        """Whether every pixel of every row does."""
        return bool(np.all(self.excess <= 1))


def bernstein_radius(sums: Sums, level: float) -> np.ndarray:
    """How far a mean of independent numbers in [0, bound] strays at most, but with probability `level`.

    Maurer and Pontil 2009, "Empirical Bernstein bounds and sample variance penalization", theorem 4, on either side.
    """
    log = np.log(4 / level)
    return np.sqrt(2 * sums.variance * log / sums.size) + 7 * sums.bound * log / (3 * (sums.size - 1))


def interval(layer: Layer | Stacked, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Between what and what each pixel of a length's exact image lies, but with probability `level` each."""
    if isinstance(layer, Stacked):  # of a sum, the sum of the intervals at their shares of the level
        ends = [interval(part, level / len(layer.layers)) for part in layer.layers]
        return np.sum([low for low, _ in ends], axis=0), np.sum([high for _, high in ends], axis=0)
    b = layer.normaliser
    share = level if b is None else level / 2
    mean, radius = layer.deposits.mean, bernstein_radius(layer.deposits, share)
    least, most = (
        (1.0, 1.0) if b is None else (b.mean - bernstein_radius(b, share), b.mean + bernstein_radius(b, share))
    )
    low, high = np.maximum(mean - radius, 0) * np.maximum(least, 0), (mean + radius) * most
    return layer.scale * low, layer.scale * high


def compare(image: Image, values: np.ndarray, errors: np.ndarray | None = None, level: float = 1e-5) -> Comparison:
    """Hold an image to exact `values`, (lengths, pixels), known to `errors`: each length, and the total.

    `level`: that any pixel of a right integrator fails, all rows together (a union bound).
    """
    values = np.asarray(values, np.float64)
    errors = np.zeros_like(values) if errors is None else np.asarray(errors, np.float64)
    require(
        values.shape == errors.shape == image.values.shape,
        f"compare: the image has {image.values.shape} lengths and pixels; the exact one {values.shape}, its errors "
        f"{errors.shape}",
    )
    lengths, pixels = values.shape
    each = level / (pixels * (lengths + 1))
    low, high = (np.stack(ends) for ends in zip(*(interval(layer, each) for layer in image.layers), strict=True))
    # The total's interval is the sum of the lengths', at their share of its level: wide, and true.
    shared = [interval(layer, each / lengths) for layer in image.layers]
    low, high = (
        np.concatenate([ends, np.sum([s[k] for s in shared], axis=0)[None]]) for k, ends in enumerate((low, high))
    )
    found = np.concatenate([image.values, image.total[None]])
    error = np.concatenate([image.errors, image.total_error[None]])
    exact = np.concatenate([values, values.sum(0)[None]])
    known = np.concatenate([errors, errors.sum(0)[None]])
    over, under = exact - found, found - exact
    missed = np.maximum(np.maximum(over, under) - known, 0)
    radius = np.where(over > 0, high - found, found - low)
    tiny = np.finfo(np.float64).tiny
    excess = np.where(missed > 0, missed / np.maximum(radius, tiny), 0)
    scale = np.maximum(exact, exact.mean(1, keepdims=True))
    widest = np.maximum(high - found, found - low) + known - ndtri(0.01) * error
    detectable = np.where(scale > 0, widest / np.where(scale > 0, scale, 1), 0)
    return Comparison(excess, detectable)


__all__ = ["Comparison", "bernstein_radius", "compare", "interval"]
