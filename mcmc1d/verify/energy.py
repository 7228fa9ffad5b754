"""The logarithm of a law's density at many positions, in the precision that they have."""

import threading

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, traced
from mcmc1d.verify.law import Law
from mcmc1d.verify.statistic import Position

_ROWS = 4096  # that are evaluated at once: of every new number a program would be compiled
_WALL = 1e-6  # of the way to the median, within which of a wall a number is at it
_KEPT = 4  # batches of each thread: where chains start, and where they are


class Energy:
    """Compiled once: of n positions n numbers. In float32 a float64 position may be rounded onto a wall or a pole."""

    def __init__(self, law: Law):
        density = law.log_density
        assert density is not None
        self.name, self.batch = law.name, jax.jit(jax.vmap(density))
        self.last = threading.local()

    def __call__(self, where: Position) -> np.ndarray:
        """Raises `ValueError` for a function that is not JAX's, and for one whose value is not one real number.

        The last batches' numbers are kept, for several tests ask for the same.
        """
        kept = [pair for pair in getattr(self.last, "kept", []) if pair[0] is not where]
        mine = [pair for pair in getattr(self.last, "kept", []) if pair[0] is where]
        found = mine[0] if mine else (where, self._evaluated(where))
        self.last.kept = [found, *kept][:_KEPT]
        return found[1]

    def zero(self, where: Position) -> np.ndarray:
        """(n,), where the density is zero.

        Not where it is so for a rounding onto a wall, next to which, inwards, it is not.
        """
        found = np.isneginf(self(where))
        rows = np.flatnonzero(found)[:_ROWS]
        if len(rows):
            inwards = jax.tree.map(lambda a: _inwards(np.asarray(a), np.resize(rows, _ROWS)), where)
            found[rows] = np.isneginf(self._evaluated(inwards))[: len(rows)]
        return found

    def _evaluated(self, where: Position) -> np.ndarray:
        leaves = jax.tree.leaves(where)
        n = len(leaves[0])
        wide = jnp.zeros(()).dtype == np.float64 or any(np.result_type(leaf) == np.float64 for leaf in leaves)
        # What is left over is filled up with the first rows; a few, which may be slow, are not.
        rows = range(0, n, _ROWS)
        parts = [where] if n < _ROWS // 2 else [_rows(where, n, first) for first in rows]
        with jax.enable_x64(wide), traced(f"{self.name}: log_density, a function of one position,"):
            values = [np.asarray(self.batch(part)) for part in parts]
        require(
            values[0].shape == jax.tree.leaves(parts[0])[0].shape[:1] and values[0].dtype.kind in "biuf",
            f"{self.name}: log_density of one position must be one real number, not {values[0].dtype} of shape "
            f"{values[0].shape[1:]}: sum over the coordinates",
        )
        return np.concatenate(values)[:n]


def _inwards(a: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Some rows, by roundings nearer to the median of all."""
    if a.dtype.kind != "f":
        return a[rows]
    way = np.median(a, axis=0) - a[rows]
    step = np.maximum(_WALL * np.abs(way), 4 * np.abs(np.spacing(a[rows])))
    return (a[rows] + np.sign(way) * step).astype(a.dtype)


def _rows(where: Position, n: int, first: int) -> Position:
    if first + _ROWS <= n:
        return jax.tree.map(lambda a: a[first : first + _ROWS], where)
    return jax.tree.map(lambda a: np.asarray(a)[(first + np.arange(_ROWS)) % n], where)
