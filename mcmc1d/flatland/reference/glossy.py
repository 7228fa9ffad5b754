"""The glossy lobe, and a table of directions to hold what it sends out."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaln

from mcmc1d.flatland.reference.mesh import legendre


def lobe_norm(exponent: int) -> float:
    """I_n, the integral of cos^n over (-pi / 2, pi / 2)."""
    return float(np.sqrt(np.pi) * np.exp(gammaln((exponent + 1) / 2) - gammaln(exponent / 2 + 1)))


def lobe(exponent: int, angle_out: np.ndarray | float, angle_in: np.ndarray | float) -> Any:
    """cos^n(alpha) / (I_n max(cos_i, cos_o)), of unit reflectance; alpha = theta_o + theta_i, zero from pi / 2 on."""
    alpha = angle_out + angle_in
    peak = _power(np.where(np.abs(alpha) < np.pi / 2, np.cos(alpha), 0), exponent)
    return peak / (lobe_norm(exponent) * np.maximum(np.cos(angle_out), np.cos(angle_in)))


def _power(base: Any, exponent: int) -> Any:
    """By squaring, which takes a quarter of the time of NumPy's."""
    result = base if exponent % 2 else 1.0
    while exponent := exponent // 2:
        base = base * base
        if exponent % 2:
            result = result * base
    return result


@dataclass(frozen=True)
class Directions:
    """Panels of angles over (-pi / 2, pi / 2), graded to its ends, with Gauss-Legendre nodes in each."""

    edges: np.ndarray
    order: int

    @staticmethod
    def of(exponent: int, widest: float, order: int) -> "Directions":
        """For lobes up to the exponent; panels are `widest` / sqrt(exponent) at most, in radians.

        And never wider than for exponent 8: the max of the cosines is no smoother for a broad lobe.
        """
        half = int(np.ceil(np.pi / 2 * np.sqrt(max(exponent, 8)) / widest))
        even = np.linspace(0, np.pi / 2, half + 1)
        grazing = np.pi / 2 - even[1] * np.array([0.3, 0.09, 0.027])
        upper = np.concatenate([even[:-1], grazing, even[-1:]])
        return Directions(np.concatenate([-upper[:0:-1], upper]), order)

    @property
    def count(self) -> int:
        """How many nodes."""
        return (len(self.edges) - 1) * self.order

    @property
    def nodes(self) -> np.ndarray:
        """The nodes' angles, (count,)."""
        width = np.diff(self.edges)
        return (self.edges[:-1, None] + width[:, None] * (legendre(self.order)[0] + 1) / 2).ravel()

    def locate(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The panel (M,) that holds all the angles of a row of (M, q), and their places in it, in [-1, 1], (M, q)."""
        middle = angles[:, angles.shape[1] // 2]
        k = np.clip(np.searchsorted(self.edges, middle, "right") - 1, 0, len(self.edges) - 2)
        return k, np.clip(2 * (angles - self.edges[k][:, None]) / np.diff(self.edges)[k][:, None] - 1, -1, 1)


__all__ = ["Directions", "lobe", "lobe_norm"]
