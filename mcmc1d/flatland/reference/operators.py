"""Linear operators from what segments send out to what arrives: sparse matrices, one for each number of mirrors."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.sparse import csr_array

from mcmc1d.flatland.reference.glossy import Directions
from mcmc1d.flatland.reference.mesh import Mesh, Points, legendre, quadrature
from mcmc1d.flatland.reference.rays import Geometry, Rays, trace

# Matrix entries made at a time.
_BATCH = 1_000_000


@dataclass(frozen=True)
class Measure:
    """What a row weighs the radiance with, per radian of the angle theta at the point: its density and integral."""

    density: Callable[[np.ndarray], np.ndarray]
    """Of cos(theta)."""
    integral: Callable[[np.ndarray, np.ndarray], np.ndarray]


IRRADIANCE = Measure(lambda x: x, lambda a, b: 2 * np.cos((a + b) / 2) * np.sin((b - a) / 2))
FILM = Measure(lambda x: 1 / x**2, lambda a, b: np.sin(b - a) / (np.cos(a) * np.cos(b)))
"""d tan(theta)."""


@dataclass(frozen=True)
class Sources:
    """All that can send light: emitting segments, nodes of the mesh, and nodes times directions of glossy segments."""

    geometry: Geometry
    mesh: Mesh
    emission: np.ndarray
    lambert: np.ndarray
    glossy: np.ndarray
    directions: Directions | None
    first_glossy: np.ndarray
    """For each panel, the index of its first node among the glossy nodes; -1 for none."""
    glossy_nodes: int

    @staticmethod
    def of(geometry: Geometry, mesh: Mesh, materials: list, directions: Directions | None) -> "Sources":
        """From the segments' materials."""
        emission, lambert, glossy = (
            np.array([getattr(m, name) for m in materials]) for name in ("emission", "lambert", "glossy")
        )
        shiny = glossy[mesh.segment] > 0
        first = np.where(shiny, mesh.order * (np.cumsum(shiny) - 1), -1)
        return Sources(geometry, mesh, emission, lambert, glossy, directions, first, mesh.order * int(shiny.sum()))


@dataclass(frozen=True)
class Gather:
    """What `rows` receive: for each number of mirrors from 0 on, from emission, from nodes, from glossy tables.

    Matrices of shapes (rows, S), (rows, nodes) and (rows, glossy nodes * directions).
    """

    emission: list[csr_array]
    diffuse: list[csr_array]
    glossy: list[csr_array]
    missed: float
    """The most that a row would receive, after one more mirror, of unit radiance from everywhere."""

    def apply(self, emission: np.ndarray, diffuse: np.ndarray, glossy: np.ndarray | None, bounces: int) -> np.ndarray:
        """What arrives by exactly so many mirrors."""
        total = self.emission[bounces] @ emission + self.diffuse[bounces] @ diffuse
        return total if glossy is None else total + self.glossy[bounces] @ glossy

    def plus(self, matrix: csr_array, other: "Gather") -> "Gather":
        """What arrives here, and a `matrix` of what arrives there, whose rows weigh 1 each at most."""
        kinds = ((self.emission, other.emission), (self.diffuse, other.diffuse), (self.glossy, other.glossy))
        sums = [[a + matrix @ b for a, b in zip(*both, strict=True)] for both in kinds]
        return Gather(*sums, missed=self.missed + other.missed)


def gather(sources: Sources, rays: Rays, rows: int, depth: int, points: int, measure: Measure, cuts=None) -> Gather:
    """The operator of rows 0 .. rows - 1, whose rays are given; cut at the angles `cuts` too."""
    parts, missed = _Parts(sources, rows, depth), np.zeros(rows)
    batch = max(4, 4_000 // (2 * len(sources.emission) + (0 if cuts is None else len(cuts))))
    for first in range(0, len(rays), batch):
        found, onward = trace(sources.geometry, rays[first : first + batch], depth, cuts)
        parts.emission(found, measure.integral(found.low, found.high) * found.weight)
        np.add.at(missed, onward.row, measure.integral(onward.low, onward.high) * onward.weight)
        found = found[sends(sources)[found.segment]]
        seen = quadrature(sources.geometry, sources.mesh, found, points, *_edges(sources))
        parts.sent(seen, seen.weight * measure.density(seen.cosine))
    return parts.gather(float(missed.max(initial=0)))


class TooLargeError(ValueError):
    """Where a computation would take more memory than there is."""


_MOST_ENTRIES = 150_000_000
"""Of an operator: 16 bytes each, and three times as much while it is made."""


def incoming(
    sources: Sources, rays: Rays, depth: int, points: int
) -> tuple[Gather, np.ndarray, np.ndarray, np.ndarray]:
    """The radiance at quadrature points of what the rays see: a `Gather` whose rows are those points, in three.

    Also, of each point, the rays' row, the angle and the weight in angle.
    """
    assert sources.directions is not None
    cuts, angles, weights, owners, batches = sources.directions.edges, [], [], [], []
    batch, missed = max(4, 4_000 // (2 * len(sources.emission) + len(cuts))), 0.0
    for first in range(0, len(rays), batch):
        found, onward = trace(sources.geometry, rays[first : first + batch], depth, cuts)
        missed = max(missed, float(onward.weight.max(initial=0)) if len(onward) else 0.0)
        seen = quadrature(sources.geometry, sources.mesh, found, points, *_edges(sources))
        batches.append(seen)
        angles.append(seen.angle.ravel())
        weights.append(seen.weight.ravel())
        owners.append(np.repeat(seen.row, points))
    count = sum(len(a) for a in angles)
    if count * sources.mesh.order * sources.directions.order > _MOST_ENTRIES:
        raise TooLargeError(
            f"image: the glossy walls see {count} places in {sources.directions.count} directions, which memory does "
            "not hold; pass a coarser resolution=, such as Resolution(order=2, points=4, smallest=0.1, lobe=4.0), or "
            "lower the largest exponent"
        )
    parts, start = _Parts(sources, count, depth), 0
    for seen in batches:
        parts.radiance(seen, start)
        start += seen.cosine.size
    return parts.gather(missed), np.concatenate(owners), np.concatenate(angles), np.concatenate(weights)


class _Parts:
    """Entries of the matrices, as they come."""

    def __init__(self, sources: Sources, rows: int, depth: int):
        self.sources, self.depth = sources, depth
        directions = 0 if sources.directions is None else sources.directions.count
        columns = [len(sources.emission), sources.mesh.order * len(sources.mesh.low), sources.glossy_nodes * directions]
        self.shapes = [(rows, n) for n in columns]
        self.entries: list[list[list[tuple]]] = [[[] for _ in range(depth + 1)] for _ in columns]

    def add(self, kind: int, bounces: np.ndarray, row: np.ndarray, column: np.ndarray, value: np.ndarray) -> None:
        """Entries (row, column, value) for each number of mirrors."""
        bounces, row = np.broadcast_to(bounces, value.shape), np.broadcast_to(row, value.shape)
        for d in range(self.depth + 1):
            mine = bounces == d
            if mine.any():
                self.entries[kind][d].append((value[mine], row[mine].astype(np.int32), column[mine].astype(np.int32)))

    def emission(self, found: Rays, value: np.ndarray) -> None:
        """From the segments that emit."""
        lit = self.sources.emission[found.segment] > 0
        found = found[lit]
        self.add(0, found.bounces, found.row, found.segment, value[lit])

    def sent(self, seen: Points, weight: np.ndarray) -> None:
        """From the nodes: the sums over points of weights times the nodes' interpolation, for each piece."""
        mesh, directions = self.sources.mesh, self.sources.directions
        order, matrix = mesh.order, legendre(mesh.order)[2]
        segment = mesh.segment[seen.panel]
        for some in _batches(self.sources.lambert[segment] > 0, order * seen.local.shape[1]):
            basis = np.einsum("pqn,pq->pn", legvander(seen.local[some], order - 1), weight[some]) @ matrix
            column = seen.panel[some][:, None] * order + np.arange(order)
            self.add(1, seen.bounces[some][:, None], seen.row[some][:, None], column, basis)
        if directions is None:
            return
        wide, other = directions.order, legendre(directions.order)[2]
        for some in _batches(self.sources.glossy[segment] > 0, order * wide * seen.local.shape[1]):
            k, at = directions.locate(np.arctan(seen.slope[some]))
            by_place = np.einsum("pqn,pq->pqn", legvander(seen.local[some], order - 1) @ matrix, weight[some])
            both = np.einsum("pqn,pqm->pnm", by_place, legvander(at, wide - 1) @ other)
            node = self.sources.first_glossy[seen.panel[some]][:, None] + np.arange(order)
            column = node[:, :, None] * directions.count + (k[:, None] * wide + np.arange(wide))[:, None, :]
            shape = (len(column), 1, 1)
            self.add(2, seen.bounces[some].reshape(shape), seen.row[some].reshape(shape), column, both)

    def radiance(self, seen: Points, start: int) -> None:
        """From everything to the points themselves, that are rows `start` and on; mirrors' reflectances left out."""
        mesh, directions = self.sources.mesh, self.sources.directions
        assert directions is not None
        q = seen.cosine.shape[1]
        row = start + np.arange(len(seen.row) * q).reshape(-1, q)
        segment = np.broadcast_to(mesh.segment[seen.panel][:, None], row.shape)
        bounces = np.broadcast_to(seen.bounces[:, None], row.shape)
        self.add(0, bounces, row, segment, (self.sources.emission[segment] > 0).astype(float))
        single = Points(
            row=row.ravel(),
            panel=np.repeat(seen.panel, q),
            bounces=bounces.ravel(),
            weight=np.ones((row.size, 1)),
            cosine=seen.cosine.reshape(-1, 1),
            sine=seen.sine.reshape(-1, 1),
            local=seen.local.reshape(-1, 1),
            slope=seen.slope.reshape(-1, 1),
        )
        self.sent(single, single.weight)

    def gather(self, missed: float) -> Gather:
        """The matrices made of them."""
        kinds = zip(self.entries, self.shapes, strict=True)
        matrices = [[_sparse(part, shape) for part in kind] for kind, shape in kinds]
        return Gather(*matrices, missed=missed)


def _sparse(entries: list[tuple], shape: tuple[int, int]) -> csr_array:
    if not entries:
        return csr_array(shape)
    value, row, column = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array((value, (row, column)), shape=shape)


def _batches(wanted: np.ndarray, size: int) -> list[np.ndarray]:
    index = np.flatnonzero(wanted)
    step = max(1, _BATCH * 4 // size)
    return [index[i : i + step] for i in range(0, len(index), step)]


def sends(sources: Sources) -> np.ndarray:
    """The segments of which nodes are seen."""
    return (sources.lambert > 0) | (sources.glossy > 0)


def _edges(sources: Sources) -> tuple[np.ndarray | None, np.ndarray]:
    """At which directions to split what is seen of which segments."""
    return None if sources.directions is None else sources.directions.edges, sources.glossy > 0


__all__ = ["FILM", "IRRADIANCE", "Gather", "Measure", "Sources", "TooLargeError", "gather", "incoming", "sends"]
