"""Where the cells of a coordinate end, from draws of its law: never where a float's last bits would decide."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

_ROUNDINGS = 16  # of a float, that two values may be apart and are one
_DISTINCT = 512  # values from which on a law is taken for continuous
_USUAL = 0.99  # the quantile of magnitudes by which roundings of differences are measured: the largest may be any


@dataclass(frozen=True)
class Ends:
    """The inner ends of a coordinate's cells, and what is not seen within these."""

    inner: np.ndarray
    """Rising, none on a value that occurs."""
    widest: float = 0.0
    """The largest share of the draws in a cell that holds several values."""
    blurred: float = 0.0
    """The difference up to which two values were taken for one, though it is no rounding of theirs; 0 if none were."""


class _Values(NamedTuple):
    """Rising values, each from its first to its last rounding, with their numbers of draws."""

    first: np.ndarray
    last: np.ndarray
    draws: np.ndarray
    blurred: float


def varies(values: np.ndarray) -> bool:
    """Whether there is more than one value, not by their difference, which may exceed an integer's range."""
    return bool(np.max(values) != np.min(values))


def interval(low: float, high: float) -> str:
    """The cell between two ends, to four digits, or as many more as tell it from its neighbours."""
    width, size = high - low, max(abs(low), abs(high))
    digits = 4
    if np.isfinite(width) and width > 0:
        digits = min(max(digits, 2 + int(np.ceil(np.log10(size / width)))), 17)
    return f"[{low:.{digits}g}, {high:.{digits}g}]"


def inner_ends(values: np.ndarray, cells: int) -> np.ndarray:
    """`cell_ends`, without what is not seen."""
    return cell_ends(values, cells).inner


def cell_ends(values: np.ndarray, cells: int) -> Ends:
    """About equally probable cells; an atom of the law has one of its own, and of few values each has.

    What differs by a few roundings is one value. Of discrete laws, whose values may be differences of larger numbers
    (a lattice of decimals that holds zero), so is what differs by a few roundings of the larger ones, where no other
    value is as near. Of all values that can not be asked: of a law with heavy tails nearly all are within that.
    """
    values = np.asarray(values)
    values = values[np.isfinite(values)]  # a log-density may be -inf
    if not values.size:
        return Ends(values.astype(np.float64))
    step, least = 0.0, 0.0
    if values.dtype.kind == "f":
        step, least = float(np.finfo(values.dtype).eps), _ROUNDINGS * float(np.finfo(values.dtype).tiny)
        # XLA flushes numbers that are too small to zero, and NumPy does not.
        values = np.where(np.abs(values) < least, 0, values)
    values = values.astype(np.float64)
    found = _different(values, step)
    if len(found.first) == 1:  # what the law never changes, a kernel must not
        noise = _ROUNDINGS * step * np.abs(values).max()
        low, high = found.first[0] - noise, found.last[0] + noise
        return Ends(np.array([np.nextafter(low, -np.inf), np.nextafter(high, np.inf)]))
    first = np.where(found.first == 0, -least, found.first)
    last = np.where(found.last == 0, least, found.last)
    between = (last[:-1] + first[1:]) / 2
    if len(first) <= cells:
        return Ends(between, 0.0, found.blurred)
    # The end under each quantile; of values that are no more than roundings apart, the widest gap of a few.
    at = np.searchsorted(first, np.quantile(values, np.arange(1, cells) / cells), side="right") - 2
    near = np.unique(np.clip(at, 0, None))
    if len(first) > _DISTINCT:
        around = np.clip(near[:, None] + np.arange(-2, 3), 0, len(between) - 1)
        near = np.unique(around[np.arange(len(near)), np.argmax((first[1:] - last[:-1])[around], axis=1)])
    near = _about_atoms(found, between, near, step, len(values) / cells) if cells > 2 else near
    return Ends(between[near], _widest(found, near, step) / len(values), found.blurred)


def _different(values: np.ndarray, step: float) -> _Values:
    """The values that are told apart; of a continuous law each its own."""
    different, counts = np.unique(values, return_counts=True)
    each = _Values(different, different, counts, 0.0)
    if step == 0:
        return each
    noise, size = _ROUNDINGS * step, np.abs(different)
    blur = noise * float(np.quantile(np.abs(values), _USUAL))
    own = _alone(different, noise * np.maximum(size[:-1], size[1:]))
    blurred = _alone(different, np.full(len(own), blur))
    starts = np.flatnonzero(np.append(True, ~(own | blurred)))
    if len(starts) > _DISTINCT:
        return each
    last = different[np.append(starts[1:], len(different)) - 1]
    return _Values(different[starts], last, np.add.reduceat(counts, starts), blur if np.any(blurred & ~own) else 0.0)


def _alone(different: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Which neighbours among rising values are one: no further apart than the noise, as are all between them.

    Not of a stretch that alone holds as many values as a continuous law.
    """
    if not len(noise):
        return np.zeros(0, bool)
    starts = np.append(True, np.diff(different) > noise)
    group, firsts = np.cumsum(starts) - 1, np.flatnonzero(starts)
    sizes = np.diff(np.append(firsts, len(different)))
    width = different[firsts + sizes - 1] - different[firsts]
    return ~starts[1:] & (width[group[1:]] <= noise) & (sizes[group[1:]] <= _DISTINCT)


def _about_atoms(found: _Values, between: np.ndarray, near: np.ndarray, step: float, heavy: float) -> np.ndarray:
    """The ends with those on both sides of each value that has so many draws or more, some roundings away."""
    for k in np.flatnonzero(found.draws >= heavy):
        # Within that a kernel may round the other way.
        slack = _ROUNDINGS * step * max(abs(found.first[k]), abs(found.last[k]))
        below = int(np.searchsorted(between, found.first[k] - slack, side="left")) - 1
        above = int(np.searchsorted(between, found.last[k] + slack, side="right"))
        own = np.array([end for end in (below, above) if 0 <= end < len(between)], np.int64)
        # Nor is a cell beside it as thin as that.
        low = between[below] - slack if below >= 0 else -np.inf
        high = between[above] + slack if above < len(between) else np.inf
        inside = (between[near] > low) & (between[near] < high)
        near = np.union1d(near[~inside], own)
    return near


def _widest(found: _Values, near: np.ndarray, step: float) -> int:
    """The most draws in a cell that holds several values."""
    starts = np.append(0, near + 1)
    ends = np.append(near, len(found.first) - 1)
    counts = np.add.reduceat(found.draws, starts)
    low, high = found.first[starts], found.last[ends]
    several = (ends > starts) & (high - low > 2 * _ROUNDINGS * step * np.maximum(np.abs(low), np.abs(high)))
    return int(counts[several].max(initial=0))
