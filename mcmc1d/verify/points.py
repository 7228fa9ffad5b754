"""Where contracts are checked: random points of the unit cube, and all its edges."""

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

_MOST_EDGE_POINTS = 3000


def cube_points(dimension: int, count: int, seed: int, dtype: Any, extra: Iterable[float] = ()) -> np.ndarray:
    """`count` random points of [0, 1)^dimension and then the edge points: shape (n, dimension), in `dtype`.

    Edges of a coordinate: 0, the smallest number that a generator yields, the quarters, the largest float under 1,
    and each of `extra` with its neighbours. In up to three dimensions all their combinations are taken, beyond (or
    where there are too many) a random few thousand of them, every other coordinate at random.
    """
    rng = np.random.default_rng(seed)
    step = float(np.finfo(dtype).eps)
    edges = {0.0, step, 0.25, 0.5, 0.75, 1 - step, 1 - step / 2}
    edges.update(float(e + d) for e in extra for d in (-step, 0.0, step) if 0 <= e + d < 1)
    values = np.unique(np.array(sorted(edges)).astype(dtype))
    values = values[(values >= 0) & (values < 1)]
    inside = rng.random((count, dimension)).astype(dtype)
    if dimension == 0:
        return inside
    if len(values) ** dimension <= _MOST_EDGE_POINTS:
        corners = np.array(list(itertools.product(values, repeat=dimension)), dtype)
    else:
        corners = rng.choice(values, (_MOST_EDGE_POINTS, dimension)).astype(dtype)
        fill = rng.random(corners.shape) < 0.3
        corners[fill] = rng.random(fill.sum()).astype(dtype)
    points = np.concatenate([inside, corners])
    return np.minimum(points, np.nextafter(np.ones((), dtype), np.zeros((), dtype)))
