"""Which segments a renderer's rays are tested against, by a grid; and how many of those a small cache holds."""

from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from mcmc1d.flatland.scene import Scene


class Grid:
    """A uniform grid of cells, each with the segments that cross it: a ray is tested against those, cell by cell."""

    def __init__(self, scene: Scene, cells: int):
        """`cells`: along the longer side of the scene."""
        ends = np.array(scene.ends, np.float64)
        self.a, self.b = ends[:, 0], ends[:, 1]
        self.low = ends.min((0, 1))
        self.size = float((ends.max((0, 1)) - self.low).max()) / cells * (1 + 1e-9)
        self.lists: dict[tuple[int, int], list[int]] = defaultdict(list)
        for k, (a, b) in enumerate(ends):
            for cell, _ in self._crossed(a, b):
                self.lists[cell].append(k)

    def _crossed(self, a: np.ndarray, b: np.ndarray) -> list[tuple[tuple[int, int], float]]:
        """The cells from a to b in their order, and where each is left, as a share of the way."""
        start, way = (a - self.low) / self.size, (b - a) / self.size
        crossings = []
        for axis in (0, 1):
            if way[axis] != 0:
                first, last = sorted((start[axis], start[axis] + way[axis]))
                lines = np.arange(np.ceil(first), np.floor(last) + 1)
                crossings.append((lines - start[axis]) / way[axis])
        inner = np.concatenate([*crossings, np.zeros(0)])
        ends = np.sort(np.append(inner[(inner > 0) & (inner < 1)], 1.0))
        middles = (np.append(0.0, ends[:-1]) + ends) / 2
        cells = np.floor(start + middles[:, None] * way).astype(int)
        return list(zip(map(tuple, cells.tolist()), ends.tolist(), strict=True))

    def tested(self, ray: np.ndarray) -> list[int]:
        """The segments that a ray, (2, 2), from a point to another is tested against, until it is stopped."""
        a, b = ray
        way, tests = b - a, []
        for cell, left in self._crossed(a, b):
            if cell not in self.lists:
                continue
            own = self.lists[cell]
            tests += own
            edge, off = self.b[own] - self.a[own], self.a[own] - a
            across = way[0] * edge[:, 1] - way[1] * edge[:, 0]
            safe = np.where(across == 0, np.inf, across)
            t = (off[:, 0] * edge[:, 1] - off[:, 1] * edge[:, 0]) / safe
            s = (off[:, 0] * way[1] - off[:, 1] * way[0]) / safe
            # Where it begins it is not stopped; where it ends it is, by whatever lies there.
            if np.any((s >= 0) & (s <= 1) & (t > 1e-9) & (t <= min(left, 1 - 1e-9))):
                break
        return tests


def hit_rates(requests: Iterable[int], sizes: Sequence[int]) -> np.ndarray:
    """The share of the requests that a cache of each size holds; it gives up what was not asked for the longest."""
    caches: list[OrderedDict[int, None]] = [OrderedDict() for _ in sizes]
    hits, count = np.zeros(len(sizes)), 0
    for segment in requests:
        count += 1
        for k, (cache, size) in enumerate(zip(caches, sizes, strict=True)):
            if segment in cache:
                hits[k] += 1
                cache.move_to_end(segment)
            else:
                cache[segment] = None
                if len(cache) > size:
                    cache.popitem(last=False)
    return hits / max(count, 1)
