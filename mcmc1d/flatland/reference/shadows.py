"""Shadow lines: the places on segments where what is seen from them begins, or ceases, to be seen."""

from dataclasses import dataclass

import numpy as np

from mcmc1d.flatland.plane import distance
from mcmc1d.flatland.reference.rays import Geometry, Rays, fan, place, trace
from mcmc1d.flatland.scene import Scene

# So many intervals between shadow lines, the widest, of a wall sensor are looked into; and of all other walls together.
MOST = 20_000


@dataclass(frozen=True)
class ShadowLines:
    """Where another segment's end is seen to cover, or to touch, an end: arrays of N, sorted by segment and place.

    Each end sees intervals of angles; their limits, on what is hit, are those places: seen from there, the limit's
    end lies in front of the end that looked. Between two that are neighbours all that a segment's points see, they see
    between the same ends: irradiance from emitters is analytic there. Of a beam of light the edges are among them.
    """

    segment: np.ndarray
    bounces: np.ndarray
    """How many mirrors are on the way."""
    place: np.ndarray
    length: np.ndarray
    """Of each segment."""
    depth: int
    """The most mirrors that were looked through."""

    @staticmethod
    def of(scene: Scene, geometry: Geometry, depth: int) -> "ShadowLines":
        """Those of a scene, by way of `depth` mirrors at most."""
        ends = np.unique(scene.ends.reshape(-1, 2), axis=0)
        tiny = 1e-9 * geometry.extent
        slanted = np.array([np.cos(0.3743), np.sin(0.3743)])  # no wall is likely to lie along the half-planes' limit
        found = []
        batch = max(4, 4_000 // len(geometry.length))
        for first in range(0, len(ends), batch):
            some = ends[first : first + batch]
            holds = np.array([[distance(p, pair) < tiny for pair in scene.ends] for p in some])
            for normal in (slanted, -slanted):
                row, normals = np.arange(len(some)), np.broadcast_to(normal, some.shape).copy()
                rays = fan(row, some, normals, np.full(len(some), -1), np.pi / 2)
                seen, _ = trace(geometry, rays, depth, skip=holds, edge_on=True)
                found += [_limits(geometry, seen, angle) for angle in (seen.low, seen.high)]
        segment, bounces, at = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.lexsort((at, segment))
        return ShadowLines(segment[order], bounces[order], at[order], geometry.length, depth)

    def on(self, k: int, depth: int | None = None) -> np.ndarray:
        """The places inside segment k, by way of `depth` mirrors at most, or any; each once."""
        first, last = np.searchsorted(self.segment, [k, k + 1])
        at, length = self.place[first:last], self.length[k]
        if depth is not None:
            at = at[self.bounces[first:last] <= depth]
        at = at[(at > 0) & (at < length)]
        return at[np.diff(at, prepend=-np.inf) > 1e-9 * length]

    def thinned(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """The places inside segment k that bound the widest intervals, and the other intervals, (N, 2)."""
        cuts = np.concatenate([[0.0], self.on(k), [self.length[k]]])
        narrow = np.ones(len(cuts) - 1, bool)
        narrow[np.argsort(-np.diff(cuts), kind="stable")[:MOST]] = False
        between = narrow[1:] & narrow[:-1]
        return cuts[1:-1][~between], np.stack([cuts[:-1], cuts[1:]], 1)[narrow]


def _limits(geometry: Geometry, seen: Rays, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    limit = np.abs(angle) < np.pi / 2 - 1e-9
    return seen.segment[limit], seen.bounces[limit], place(geometry, seen, angle)[limit]


__all__ = ["MOST", "ShadowLines"]
