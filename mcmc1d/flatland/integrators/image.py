"""What an integrator makes: for each path length, sums over independent numbers, and the image that they estimate."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mcmc1d.flatland.sampling import Sums


class Layer(NamedTuple):
    """The light of paths of one length: scale times the mean deposit times the mean of what normalises it."""

    edges: int
    scale: float | np.ndarray
    """One, or one for each pixel."""
    deposits: Sums
    """Of each pixel, (pixels,)."""
    normaliser: Sums | None
    """Of b, (1,), the integral of what a chain samples, from independent samples; None where nothing is normalised."""
    rays: float
    """Rays traced, those for b included; see `Integrator`."""

    @property
    def value(self) -> np.ndarray:
        """The image of this length, (pixels,)."""
        b = 1.0 if self.normaliser is None else self.normaliser.mean
        return self.scale * b * self.deposits.mean

    @property
    def error(self) -> np.ndarray:
        """Its standard error, (pixels,): that of b included, which is the same in every pixel."""
        if self.normaliser is None:
            return self.scale * self.deposits.error
        b, mean = self.normaliser, self.deposits.mean
        return self.scale * np.hypot(b.mean * self.deposits.error, mean * b.error)

    def scaled(self, factor: float) -> "Layer":
        """The same light times a factor."""
        return self._replace(scale=self.scale * factor)


class Stacked(NamedTuple):
    """The light of one length as a sum of layers: of stages, or of parts; each is unbiased given those before it."""

    layers: tuple[Layer, ...]

    @property
    def edges(self) -> int:
        """The length."""
        return self.layers[0].edges

    @property
    def rays(self) -> float:
        """Of all of them."""
        return sum(layer.rays for layer in self.layers)

    @property
    def value(self) -> np.ndarray:
        """The image, (pixels,)."""
        return np.sum([layer.value for layer in self.layers], axis=0)

    @property
    def error(self) -> np.ndarray:
        """Its standard error, (pixels,): that a layer depends on those before it adds none."""
        return np.sqrt(np.sum([layer.error**2 for layer in self.layers], axis=0))

    def scaled(self, factor: float) -> "Stacked":
        """The same light times a factor."""
        return Stacked(tuple(layer.scaled(factor) for layer in self.layers))


class Image:
    """An image in absolute scale, by path length: mean radiance of a pinhole's pixels, irradiance of a wall's."""

    def __init__(self, layers: Sequence[Layer | Stacked]):
        """`layers`: one for each length."""
        self.layers = tuple(layers)

    @property
    def lengths(self) -> tuple[int, ...]:
        """The numbers of edges."""
        return tuple(layer.edges for layer in self.layers)

    @property
    def values(self) -> np.ndarray:
        """Of each length, (lengths, pixels)."""
        return np.stack([layer.value for layer in self.layers])

    @property
    def errors(self) -> np.ndarray:
        """The standard errors of `values`."""
        return np.stack([layer.error for layer in self.layers])

    @property
    def total(self) -> np.ndarray:
        """Of all lengths together, (pixels,)."""
        return self.values.sum(0)

    @property
    def total_error(self) -> np.ndarray:
        """The standard error of `total`: the lengths are independent."""
        return np.sqrt((self.errors**2).sum(0))

    @property
    def rays(self) -> float:
        """Of all lengths."""
        return sum(layer.rays for layer in self.layers)

    def __repr__(self) -> str:
        numbers = f"total {self.total.mean():.5g} in {self.total.size} pixels, rays={self.rays:.3g}"
        return f"Image(lengths={self.lengths}, {numbers})"


__all__ = ["Image", "Layer", "Stacked", "Sums"]
