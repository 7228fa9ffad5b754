"""Points and segments of the plane, in NumPy: distances, gaps and crossings; a segment is its two ends."""

from collections.abc import Sequence

import numpy as np


def distance(point: np.ndarray, ends: np.ndarray) -> float:
    """From a point to a segment, given by its two ends."""
    along = ends[1] - ends[0]
    t = np.clip((point - ends[0]) @ along / (along @ along), 0, 1)
    return float(np.hypot(*(point - ends[0] - t * along)))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The third component of the cross product of vectors in the plane, over the last axis."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def near(ends: np.ndarray, a: int, tiny: float) -> Sequence[int]:
    """The segments after `a` whose boxes touch its box, or nearly do."""
    low, high = ends.min(1), ends.max(1)
    later = np.arange(a + 1, len(ends))
    touch = np.all((low[later] <= high[a] + tiny) & (low[a] <= high[later] + tiny), axis=1)
    return later[touch].tolist()


def crossing(one: np.ndarray, two: np.ndarray, tiny: float) -> np.ndarray | None:
    """Where two segments cross or begin to overlap; None where they are apart, or touch at an end of either."""
    d, e, gap = one[1] - one[0], two[1] - two[0], two[0] - one[0]
    across = float(cross(d, e))
    longer, other = (d, [gap, two[1] - one[0]]) if np.hypot(*d) >= np.hypot(*e) else (e, [-gap, one[1] - two[0]])
    off = [abs(float(cross(longer / np.hypot(*longer), end))) for end in other]
    if max(off) <= tiny or abs(across) <= 1e-12 * np.hypot(*d) * np.hypot(*e):
        unit = d / np.hypot(*d)
        if min(off) > tiny:
            return None
        ahead = np.sort([gap @ unit, (two[1] - one[0]) @ unit])
        lower, upper = max(0.0, ahead[0]), min(float(np.hypot(*d)), ahead[1])
        return one[0] + lower * unit if upper - lower > tiny else None
    s, t = float(cross(gap, e)) / across, float(cross(gap, d)) / across
    inside = [tiny / np.hypot(*v) < at < 1 - tiny / np.hypot(*v) for at, v in ((s, d), (t, e))]
    return one[0] + s * d if all(inside) else None


def gaps(ends: np.ndarray) -> np.ndarray:
    """How far each end of n segments is from each other segment, (n, 2, n); infinite from its own."""
    starts, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    offset = ends[:, :, None] - starts
    t = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0, 1)
    found = np.hypot(*np.moveaxis(offset - t[..., None] * along, -1, 0))
    own = np.arange(len(starts))
    found[own, :, own] = np.inf
    return found


__all__ = ["cross", "crossing", "distance", "gaps", "near"]
