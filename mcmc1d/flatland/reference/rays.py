"""What a point of flatland sees, exactly: the angles between the ends of segments, through mirrors too.

Between two neighbouring directions to ends of segments a point sees one segment, or nothing. So visibility is decided
once an interval of angles, at its middle, and nothing is cast inside. A mirror's interval is seen again from the
point's image, with the axes reflected: the angle of a ray at its point stays what it was.
"""

import dataclasses
from dataclasses import dataclass, fields

import numpy as np

from mcmc1d.flatland.scene import Scene

# Radians: what is narrower than this is left out, and is no more than rounding.
TINY = 1e-12


@dataclass(frozen=True)
class Geometry:
    """The segments of a scene: arrays of shape (S, 2) and (S,). The normal stands on the front, left of the tangent."""

    start: np.ndarray
    end: np.ndarray
    tangent: np.ndarray
    normal: np.ndarray
    length: np.ndarray
    mirror: np.ndarray
    """The mirrors' reflectances, 0 for all else."""

    @staticmethod
    def of(scene: Scene) -> "Geometry":
        """That of a scene."""
        ends, lengths = scene.ends, scene.lengths
        tangent = (ends[:, 1] - ends[:, 0]) / lengths[:, None]
        mirror = np.array([segment.material.mirror for segment in scene.segments])
        return Geometry(ends[:, 0], ends[:, 1], tangent, left(tangent), lengths, mirror)

    @property
    def extent(self) -> float:
        """The larger side of the box around the scene."""
        return float(np.ptp(np.concatenate([self.start, self.end]), axis=0).max())


@dataclass(frozen=True)
class Rays:
    """Intervals of angles at points or at their images: arrays of N, vectors (N, 2).

    A ray at `angle` runs along cos(angle) normal + sin(angle) tangent, from `origin`, or from the last mirror on.
    """

    row: np.ndarray
    """Whose they are."""
    origin: np.ndarray
    tangent: np.ndarray
    normal: np.ndarray
    low: np.ndarray
    high: np.ndarray
    segment: np.ndarray
    """Of rays that start: the segment they leave, of a point or a mirror; of rays that arrive: what they hit; or -1."""
    weight: np.ndarray
    """The product of the mirrors' reflectances on the way."""
    bounces: np.ndarray
    """How many mirrors."""

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, index) -> "Rays":
        return Rays(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def replace(self, **arrays: np.ndarray) -> "Rays":
        """The same with other arrays."""
        return dataclasses.replace(self, **arrays)


def left(vector: np.ndarray) -> np.ndarray:
    """The vectors (..., 2) turned by a quarter, counter-clockwise."""
    return np.stack([-vector[..., 1], vector[..., 0]], -1)


def fan(row: np.ndarray, origin: np.ndarray, normal: np.ndarray, segment: np.ndarray, half_angle: float) -> Rays:
    """All rays from points (N, 2) within `half_angle` (up to pi / 2) of the `normal`, a unit vector (N, 2)."""
    n = len(row)
    high = np.full(n, half_angle)
    zero = np.zeros(n, np.int64)
    return Rays(row, origin, -left(normal), normal, -high, high, segment, np.ones(n), zero)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The inner product over the last axis."""
    return (a * b).sum(-1)


def hits(
    geometry: Geometry,
    rays: Rays,
    cuts: np.ndarray | None = None,
    skip: np.ndarray | None = None,
    edge_on: bool = False,
) -> Rays:
    """The intervals in which the rays hit one segment's front, with that segment; cut at the angles `cuts` (C,) too.

    `skip` (N, S) names segments that the rays do not see, besides the one they leave: those that hold the origin.
    `edge_on` cuts at the ends of these, and of segments that are seen edge on, as well.
    """
    n, segments = len(rays), len(geometry.length)
    if not n:
        return rays
    own = rays.segment[:, None] == np.arange(segments)
    hidden = own if skip is None else own | skip
    low, high = _spans(geometry, rays)
    mirrored = rays.bounces > 0
    if mirrored.any():  # what lies behind the mirror is not met, and need not cut
        m = rays.segment[mirrored]
        tiny = 1e-12 * geometry.extent
        behind = [
            dot(point - geometry.start[m][:, None], geometry.normal[m][:, None]) < tiny
            for point in (geometry.start, geometry.end)
        ]
        hidden[mirrored] |= behind[0] & behind[1]
    first, last = np.maximum(low, rays.low[:, None]), np.minimum(high, rays.high[:, None])
    present = (last - first > TINY) & ~hidden
    limits = [rays.low[:, None], rays.high[:, None]]
    if cuts is not None:
        limits.append(np.clip(np.broadcast_to(cuts, (n, len(cuts))), *limits[:2]))
    if edge_on:
        thin = (high - low < 1e-9) & ~own if skip is None else (high - low < 1e-9) & ~own | skip
        limits.append(np.clip(_end_angles(geometry, rays, thin), *limits[:2]))
    edges = np.concatenate([np.where(present, first, limits[0]), np.where(present, last, limits[0]), *limits], 1)
    order = np.argsort(edges, axis=1, kind="stable")
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(edges.shape[1])[None], 1)
    edges = np.take_along_axis(edges, order, 1)
    # Each segment lies over a run of intervals: one line for each interval of each run.
    i, k = np.nonzero(present)
    begin = rank[:, :segments][i, k]
    count = rank[:, segments : 2 * segments][i, k] - begin
    pair, step = expand(count)
    i, k, j = i[pair], k[pair], begin[pair] + step
    wide = edges[i, j + 1] - edges[i, j] > TINY
    i, k, j = i[wide], k[wide], j[wide]
    found = rays[i]
    middle = (edges[i, j] + edges[i, j + 1]) / 2
    distance = reach(geometry, found, k, middle)
    beyond = np.zeros(len(i))
    again = found.bounces > 0
    beyond[again] = reach(geometry, found[again], found.segment[again], middle[again])
    ahead = distance > beyond * (1 + 1e-9)
    i, k, j, distance = i[ahead], k[ahead], j[ahead], distance[ahead]
    key = i * edges.shape[1] + j
    nearest = np.lexsort((distance, key))
    key = key[nearest]
    nearest = nearest[np.concatenate([[True], key[1:] != key[:-1]])[: len(key)]]
    i, k, j = i[nearest], k[nearest], j[nearest]
    front = dot(rays.origin[i] - geometry.start[k], geometry.normal[k]) > 0
    i, k, j = i[front], k[front], j[front]
    return rays[i].replace(segment=k, low=edges[i, j], high=edges[i, j + 1])


def trace(
    geometry: Geometry,
    rays: Rays,
    depth: int,
    cuts: np.ndarray | None = None,
    skip: np.ndarray | None = None,
    edge_on: bool = False,
) -> tuple[Rays, Rays]:
    """All that the rays arrive at, through `depth` mirrors at most; and the rays that would go on from there."""
    found = [hits(geometry, rays, cuts, skip, edge_on)]
    for _ in range(depth):
        onward = _reflected(geometry, found[-1])
        if not len(onward):
            break
        found.append(hits(geometry, onward, edge_on=edge_on))
    together = {f.name: np.concatenate([getattr(part, f.name) for part in found]) for f in fields(Rays)}
    return Rays(**together), _reflected(geometry, found[-1])


def reach(geometry: Geometry, rays: Rays, segment: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """The distance (N,) from the origins to the lines of the segments, along the rays at the angles."""
    along = direction(rays, angle)
    return dot(geometry.start[segment] - rays.origin, geometry.normal[segment]) / dot(along, geometry.normal[segment])


def direction(rays: Rays, angle: np.ndarray) -> np.ndarray:
    """The unit vectors (N, 2) of the rays at the angles."""
    return np.cos(angle)[:, None] * rays.normal + np.sin(angle)[:, None] * rays.tangent


def place(geometry: Geometry, found: Rays, angle: np.ndarray) -> np.ndarray:
    """How far along the hit segments the rays at the angles arrive: (N,), within the segments."""
    along = direction(found, angle)
    k = found.segment
    offset = found.origin - geometry.start[k]
    down = np.maximum(-dot(along, geometry.normal[k]), 1e-300)
    s = dot(offset, geometry.tangent[k]) + dot(offset, geometry.normal[k]) * dot(along, geometry.tangent[k]) / down
    return np.clip(s, 0, geometry.length[k])


def expand(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts c_0, c_1, ...: the indices 0 (c_0 times), 1 (c_1 times), ... and the steps 0 .. c - 1 in each."""
    index = np.repeat(np.arange(len(count)), count)
    return index, np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)


def _spans(geometry: Geometry, rays: Rays) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest angle (N, S) of each segment as seen from each origin, around the rays' normals."""
    ends = [point - rays.origin[:, None] for point in (geometry.start, geometry.end)]
    angle = [np.arctan2(dot(v, rays.tangent[:, None]), dot(v, rays.normal[:, None])) for v in ends]
    low, high = np.minimum(*angle), np.maximum(*angle)
    # A segment behind the point may cross the direction -normal, where the angle jumps by a turn. (By the difference
    # alone: of a wall in line with the point's own both angles are a quarter turn, whichever of them rounds up.)
    jump, over = high - low > np.pi, high > np.pi / 2
    low, high = (
        np.where(jump, np.where(over, high - 2 * np.pi, high), low),
        np.where(jump, np.where(over, low, low + 2 * np.pi), high),
    )
    return low, high


def _end_angles(geometry: Geometry, rays: Rays, wanted: np.ndarray) -> np.ndarray:
    """The angles (N, 2 S) of the ends of the `wanted` (N, S) segments that are not the origins; else far below any."""
    angles = []
    for point in (geometry.start, geometry.end):
        v = point - rays.origin[:, None]
        here = np.hypot(v[..., 0], v[..., 1]) < 1e-9 * geometry.extent
        angle = np.arctan2(dot(v, rays.tangent[:, None]), dot(v, rays.normal[:, None]))
        angles.append(np.where(wanted & ~here, angle, -10.0))
    return np.concatenate(angles, 1)


def _reflected(geometry: Geometry, found: Rays) -> Rays:
    """The rays that hit mirrors, as they go on from there."""
    onto = found[(geometry.mirror[found.segment] > 0) & (found.segment >= 0)]
    n = geometry.normal[onto.segment]
    height = dot(onto.origin - geometry.start[onto.segment], n)[:, None]
    return onto.replace(
        origin=onto.origin - 2 * height * n,
        tangent=onto.tangent - 2 * dot(onto.tangent, n)[:, None] * n,
        normal=onto.normal - 2 * dot(onto.normal, n)[:, None] * n,
        weight=onto.weight * geometry.mirror[onto.segment],
        bounces=onto.bounces + 1,
    )


__all__ = ["TINY", "Geometry", "Rays", "direction", "dot", "expand", "fan", "hits", "left", "place", "reach", "trace"]
