"""Bins of a sample, and of (technique, sample), whose masses are known: where rounding puts what lies at an edge."""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcmc1d.verify.ends import interval
from mcmc1d.verify.statistic import Discrete, Position


@dataclass(frozen=True)
class Bins:
    """The exact masses of bins of x, (bins,), or of (technique, x), (techniques, bins)."""

    edges: np.ndarray
    masses: np.ndarray

    def statistic(self) -> Discrete:
        """As cells that are tested."""
        spans = [f"x in {interval(a, b)}" for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)]
        joint = self.masses.ndim == 2
        labels = [f"technique {i}, {span}" for i in range(len(self.masses)) for span in spans] if joint else spans
        masses = self.masses.ravel() / self.masses.sum()
        return Discrete(self.cell, masses, tuple(labels), ordered=not joint, cut=True)

    def cell(self, where: Position) -> np.ndarray:
        """The cell of each state; -1 outside of all bins.

        A sample that rounds across an edge into a bin of probability zero is counted on the side that it comes from.
        """
        joint = self.masses.ndim == 2
        x = np.asarray(where["x"] if isinstance(where, dict) else where).reshape(-1)
        x, dtype = x.astype(np.float64), x.dtype
        masses = np.atleast_2d(self.masses)
        rows = np.asarray(where["index"]) if joint else np.zeros(len(x), np.int64)
        known = (rows >= 0) & (rows < len(masses))
        rows = np.where(known, rows, 0)
        bins = masses.shape[1]
        cell = self._place(x)
        cell = np.where(x == self.edges[-1], bins - 1, cell)
        empty = (cell < 0) | (cell >= bins) | (masses[rows, np.clip(cell, 0, bins - 1)] == 0)
        for side in (-1, 1):
            near = self._place(x[empty] + side * roundings(self.edges, x[empty], dtype))
            lit = (near >= 0) & (near < bins)
            lit[lit] = masses[rows[empty][lit], near[lit]] > 0
            cell[np.flatnonzero(empty)[lit]] = near[lit]
        return np.where(known & (cell >= 0) & (cell < bins), rows * bins + cell, -1)

    def _place(self, x: np.ndarray) -> np.ndarray:
        return np.searchsorted(self.edges, x, side="right") - 1


@dataclass(frozen=True)
class PlanarBins:
    """The exact masses of cells of a planar x, (nx, ny), or of (technique, x), (techniques, nx, ny)."""

    x_edges: np.ndarray
    y_edges: np.ndarray
    masses: np.ndarray

    def statistic(self) -> Discrete:
        """As cells that are tested."""
        spans = [
            f"x in {interval(a, b)} x {interval(c, d)}"
            for a, b in itertools.pairwise(self.x_edges)
            for c, d in itertools.pairwise(self.y_edges)
        ]
        joint = self.masses.ndim == 3
        labels = [f"technique {i}, {span}" for i in range(len(self.masses)) for span in spans] if joint else spans
        return Discrete(self.cell, self.masses.ravel() / self.masses.sum(), tuple(labels), cut=True)

    def cell(self, where: Position) -> np.ndarray:
        """The cell of each state; -1 outside of all. One that rounds into an empty cell is counted beside it."""
        joint = self.masses.ndim == 3
        x = np.asarray(where["x"])
        x, dtype = x.astype(np.float64), x.dtype
        masses = self.masses.reshape(-1, self.masses.shape[-2] * self.masses.shape[-1])
        rows = np.asarray(where["index"]) if joint else np.zeros(len(x), np.int64)
        known = (rows >= 0) & (rows < len(masses))
        rows = np.where(known, rows, 0)
        cell = self._place(x)
        empty = (cell < 0) | (masses[rows, np.maximum(cell, 0)] == 0)
        off = np.stack([roundings(e, x[empty, k], dtype) for k, e in enumerate((self.x_edges, self.y_edges))], axis=-1)
        for side in itertools.product((-1, 0, 1), repeat=2):
            near = self._place(x[empty] + np.array(side) * off)
            lit = near >= 0
            lit[lit] = masses[rows[empty][lit], near[lit]] > 0
            cell[np.flatnonzero(empty)[lit]] = near[lit]
        return np.where(known & (cell >= 0), rows * masses.shape[1] + cell, -1)

    def _place(self, x: np.ndarray) -> np.ndarray:
        """The cell's number within its technique's; -1 outside of all."""
        place, inside = np.zeros(len(x), np.int64), np.ones(len(x), bool)
        for k, edges in enumerate((self.x_edges, self.y_edges)):
            n = len(edges) - 1
            along = np.searchsorted(edges, x[:, k], side="right") - 1
            along = np.where(x[:, k] == edges[-1], n - 1, along)
            inside &= (along >= 0) & (along < n)
            place = place * n + along
        return np.where(inside, place, -1)


_ROUNDING = 5e-7  # four times float32's: what a few operations near an edge may be off by
_ROUNDINGS = 4  # of the kind of floats that a position has


def roundings(edges: np.ndarray, x: np.ndarray, dtype: Any) -> np.ndarray:
    """How far a few operations may have moved x, of this type: by the scale of the bins (1 at most), and of itself."""
    spacing = float(np.finfo(dtype).eps) if np.issubdtype(dtype, np.floating) else 0.0
    return _ROUNDING * min(1.0, float(edges[-1] - edges[0])) + _ROUNDINGS * spacing * np.abs(x)
