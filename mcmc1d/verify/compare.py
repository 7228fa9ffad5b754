"""Comparing two sides of an equation at many points, at machine precision, fairly.

Two floats that should be equal differ by rounding, and how much of it is to be forgiven depends on the point: the
tolerance is a multiple of the point's condition number, and both sides are compared as a backward-stable computation
would be, at a point within the tolerance (a sample that rounds across a jump of the density lies on its other side).
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from mcmc1d.verify.contract import Check, numbers

TOLERANCE = {np.dtype(np.float64): 1e-10, np.dtype(np.float32): 2e-5}
"""Times the condition number of a point: 5e5 roundings in float64; 170 in float32, where fewer digits are to spare."""


@dataclass(frozen=True)
class Points:
    """Points of the unit cube with the condition number of the map at each; infinite where it is singular."""

    values: np.ndarray
    condition: np.ndarray
    free: int = 0
    """How many leading coordinates are those of a sample x and so not confined to [0, 1)."""
    rounding: np.ndarray | float = 0.0
    """What the rounding of an intermediate result may do to the outcome; it adds to the tolerance."""
    cap: float = np.inf
    """The largest tolerance: where eight roundings amplify to more than that, a point can not be checked."""
    last_bits: np.ndarray | float = 0.0
    """What the rounding of the image does to its log-determinant: far out in a tail that is all it is made of."""

    @property
    def regular(self) -> np.ndarray:
        """Where the map has finite derivatives, and few enough digits are lost."""
        amplified = 8 * np.finfo(self.values.dtype).eps * self.condition
        return np.asarray(np.isfinite(self.condition) & (amplified <= self.cap))

    @property
    def tolerance(self) -> np.ndarray:
        """The tolerance at each point."""
        return np.minimum(TOLERANCE[self.values.dtype] * self.condition + self.rounding, self.cap) + self.last_bits


def condition_number(jacobian: np.ndarray, slope: np.ndarray, log_det: np.ndarray) -> np.ndarray:
    """At each point the largest of 1, the entries of the Jacobian and of its inverse, and the log-det's slopes.

    `jacobian` (n, d, d), `slope` (n, d) and the claimed `log_det` (n,). Infinite at a singular point: where a
    derivative is not finite, or where the determinant is zero and is said to be. One that is zero and is not said to
    be is a mistake, and keeps a finite condition number to be caught by.
    """
    n, d = jacobian.shape[:2]
    if d == 0:
        return np.ones(n)
    finite = np.asarray(np.isfinite(jacobian).all((1, 2)) & np.isfinite(slope).all(1))
    safe = np.where(finite[:, None, None], jacobian, np.eye(d)).astype(np.float64)
    invertible = np.abs(np.linalg.det(safe)) > 0
    inverse = np.linalg.inv(np.where(invertible[:, None, None], safe, np.eye(d)))
    steepest = np.where(finite, np.abs(slope).max(1), 0)
    largest = np.max([np.abs(safe).max((1, 2)), np.abs(inverse).max((1, 2)), steepest], axis=0)
    singular = ~finite | (~invertible & ~np.isfinite(log_det))
    return np.where(singular, np.inf, np.maximum(largest, 1))


def steepness(jacobian: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """|d log_det / d image_j| at each point, (n, d): the slope carried through the map; 0 where that is singular."""
    if jacobian.shape[-1] == 0:
        return np.zeros(slope.shape)
    finite = np.asarray(np.isfinite(jacobian).all((1, 2)) & np.isfinite(slope).all(1))
    safe = np.where(finite[:, None, None], jacobian, 0).astype(np.float64)
    regular = np.asarray(finite & (np.linalg.det(safe) != 0))[:, None]
    safe = np.where(regular[..., None], safe, np.eye(slope.shape[1]))
    carried = np.linalg.solve(safe.transpose(0, 2, 1), np.where(regular, slope, 0)[..., None].astype(np.float64))
    return np.abs(carried[..., 0])


def log_abs_det(jacobian: np.ndarray) -> np.ndarray:
    """log|det| of a stack of matrices, shape (n,)."""
    if jacobian.shape[-1] == 0:
        return np.zeros(len(jacobian))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.linalg.slogdet(jacobian.astype(np.float64))[1]


def distance(left: Any, right: Any) -> np.ndarray:
    """The largest difference at each point between two pytrees of arrays with a leading axis of points.

    Equal infinities are equal; NaN is infinitely far from everything.
    """
    parts = []
    for pair in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        a, b = (np.asarray(side, np.float64).reshape(len(side), -1) for side in pair)
        with np.errstate(invalid="ignore"):
            parts.append(np.where(a == b, 0, np.abs(a - b)))
    apart = np.concatenate(parts, axis=1)
    return np.where(np.isnan(apart), np.inf, apart).max(1, initial=0)


def compare(
    equation: str,
    points: Points,
    side: Callable[[np.ndarray, np.ndarray], Any],
    expected: Any,
    among: np.ndarray | None = None,
    describe: Callable[[int], str] | None = None,
    note: str = "",
    anew: Callable[[np.ndarray, np.ndarray], Any] | None = None,
) -> Check:
    """Hold `side(values, rows)` to `expected` at the regular points (of those `among`).

    `side` is vectorised over points and is called with one number of them, so that it compiles once; `rows` says
    which of the points each was made from. Where it misses, it is tried at neighbours within the tolerance, and the
    best of them is taken; `anew` makes what is expected of the neighbour itself, for an equation both of whose sides
    jump there (a chosen number that rounds across an end of its interval).
    """
    look = points.regular if among is None else points.regular & among
    count = int(look.sum())
    if count == 0:
        return Check(equation, False, 0, np.nan, np.nan, note="no regular point to check it at")
    rows = np.arange(len(look))
    error = np.where(look, distance(side(points.values, rows), expected), 0)
    missed = np.flatnonzero(error > np.where(look, points.tolerance, np.inf))
    if 0 < len(missed) <= len(look) // 4:
        # The worst first: where none of a point's neighbours will do either, the rest need not be tried.
        missed = missed[np.argsort(-error[missed] / points.tolerance[missed], kind="stable")]
        for moved, which, tried in _neighbours(points, missed):
            left = side(moved, which)
            there = distance(left, jax.tree.map(lambda e, which=which: np.asarray(e)[which], expected))
            if anew is not None:
                there = np.minimum(there, distance(left, anew(moved, which)))
            np.minimum.at(error, which, there)
            if np.any(error[missed[:tried]] > points.tolerance[missed[:tried]]):
                break
    ratio = np.where(look, error / np.where(look, points.tolerance, 1), -1)  # the worst is a point that was looked at
    worst = int(np.argmax(ratio))
    where = describe(worst) if describe else numbers(points.values[worst])
    passed = bool(ratio[worst] <= 1)
    return Check(equation, passed, count, float(error[worst]), float(points.tolerance[worst]), where, note)


def directions(dimension: int) -> np.ndarray:
    """Where the neighbours of a point lie: every combination of up, not, down in a few dimensions, else some."""
    if dimension <= 3:
        return np.array([d for d in itertools.product((1, 0, -1), repeat=dimension) if any(d)])
    some = np.random.default_rng(0).integers(-1, 2, (20, dimension))
    axes = np.eye(dimension, dtype=int)
    return np.concatenate([axes, -axes, [[1] * dimension, [-1] * dimension], some])


def _neighbours(points: Points, missed: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """The missed points moved by a few roundings, and by up to the tolerance: nothing but a jump hides there.

    In batches of as many as there are points, with the rows that they come from, and how many of the missed points have
    then had all of their neighbours.
    """
    n, dtype = len(points.values), points.values.dtype
    steps = TOLERANCE[dtype] * np.array([1e-5, 1e-3, 1.0])
    moves = (steps[:, None, None] * directions(points.values.shape[1])).reshape(-1, points.values.shape[1])
    below_one = np.nextafter(np.ones((), dtype), np.zeros((), dtype))
    free = np.arange(points.values.shape[1]) < points.free
    rows, shifts = np.repeat(missed, len(moves)), np.tile(moves, (len(missed), 1))
    for first in range(0, len(rows), n):
        which = np.resize(rows[first : first + n], n)
        start = points.values[which]
        moved = start + np.resize(shifts[first : first + n], start.shape) * np.where(
            free, np.maximum(1, np.abs(start)), 1
        )
        tried = min(first + n, len(rows)) // len(moves)
        yield np.where(free, moved, np.clip(moved, 0, below_one)).astype(dtype), which, tried
