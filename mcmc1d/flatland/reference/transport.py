"""Light between the walls of one scene: what is sent out after so many edges, where it arrives, and what is missed.

B_k(x), what Lambert's lobe sends out after k edges, and G_k(x, theta), the glossy lobe's, are polynomials on panels.
What arrives by k edges is L_e for k = 1, B_k + G_k of what is seen, and the same by way of mirrors, each an edge.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, gmres

from mcmc1d.checks import require
from mcmc1d.flatland.reference.films import WallPoints, pinhole_rays
from mcmc1d.flatland.reference.glossy import Directions, lobe
from mcmc1d.flatland.reference.mesh import Resolution, make_mesh
from mcmc1d.flatland.reference.operators import FILM, IRRADIANCE, Gather, Sources, gather, incoming, sends
from mcmc1d.flatland.reference.rays import Geometry, Rays, dot, fan
from mcmc1d.flatland.reference.shadows import ShadowLines
from mcmc1d.flatland.reference.unseen import Unseen
from mcmc1d.flatland.scene import Pinhole, Scene

FAINT = 1e-15
"""The share of light that may be left behind the last mirror that is followed."""
Bound: TypeAlias = Callable[[], np.ndarray]
"""The light left out, at most, of shape (lengths, pixels); found when asked for."""
# At the mesh's nodes, and at the glossy ones for each direction.
_Sent: TypeAlias = tuple[np.ndarray, np.ndarray | None]


class Transport:
    """The operators of one scene at one resolution, for chains of up to `depth` mirrors."""

    def __init__(
        self, scene: Scene, depth: int, resolution: Resolution, lines: ShadowLines | None, scattered: bool = True
    ):
        self.materials = [segment.material for segment in scene.segments]
        if not scene.mirrors:
            depth = 0
        steepest = max((m.exponent for m in self.materials if m.glossy > 0), default=0)
        self.scene, self.depth, self.resolution, self.lines = scene, depth, resolution, lines
        self.geometry = Geometry.of(scene)
        self.mesh = make_mesh(scene, self.geometry, resolution, lines, steepest)
        glossy = scattered and steepest > 0  # a lamp seen directly asks for no lobe
        directions = Directions.of(steepest, resolution.lobe, resolution.order) if glossy else None
        self.sources = Sources.of(self.geometry, self.mesh, self.materials, directions)
        self.exponent = np.array([m.exponent for m in self.materials])
        self.node_segment = np.repeat(self.mesh.segment, self.mesh.order)
        self.glossy = self._gather_glossy() if directions is not None else None
        self.scattered = scattered
        self.seen, self.at_node, self.lost = self._film()

    # --- what arrives where -----------------------------------------------------------------------------------------

    def _fan(self, segment: np.ndarray, place: np.ndarray, row: np.ndarray) -> Rays:
        g = self.geometry
        points = g.start[segment] + place[:, None] * g.tangent[segment]
        return fan(row, points, g.normal[segment], segment, np.pi / 2)

    def _rays(self, nodes: np.ndarray, row: np.ndarray) -> Rays:
        return self._fan(self.node_segment[nodes], self.mesh.places.ravel()[nodes], row)

    @cached_property
    def nodes(self) -> Gather:
        """The irradiance at the nodes of what scatters it."""
        nodes = np.flatnonzero(np.repeat((self.sources.lambert > 0)[self.mesh.segment], self.mesh.order))
        if self.lines is not None and self.unseen is not None:  # what the glossy ones' nodes miss is asked, too
            nodes = np.arange(len(self.node_segment))[sends(self.sources)[self.node_segment]]
        rays = self._rays(nodes, nodes)
        return gather(self.sources, rays, len(self.node_segment), self.depth, self.resolution.points, IRRADIANCE)

    @cached_property
    def unseen(self) -> Unseen | None:
        """Where light may have fallen between the nodes."""
        return None if self.lines is None else Unseen.of(self.sources, self.lines, self.materials)

    @cached_property
    def _film_of_pieces(self) -> Gather:
        assert self.unseen is not None
        return self._gather_film(self.unseen.sources, self.seen, 4)  # each is even

    def _film(self) -> tuple[Rays, np.ndarray, np.ndarray]:
        """The rays that make the image, their rows its pixels; which start at nodes; the shares of pixels left out."""
        sensor, k = self.scene.sensor, self.scene.sensor_segment
        if k is not None:
            assert self.lines is not None
            points = WallPoints.of(self.scene, self.geometry, self.mesh, self.resolution, self.lines)
            rays = self._fan(np.full(len(points.place), k), points.place, points.pixel)
            # Without scattering nobody asks the nodes.
            return rays.replace(weight=points.weight), points.node & self.scattered, points.lost
        assert isinstance(sensor, Pinhole)
        rays = pinhole_rays(sensor)
        return rays, np.zeros(len(rays), bool), np.zeros(sensor.pixels)

    def _gather_film(self, sources: Sources, rays: Rays, points: int) -> Gather:
        measure = FILM if isinstance(self.scene.sensor, Pinhole) else IRRADIANCE
        return gather(sources, rays, self.scene.sensor.pixels, self.depth, points, measure)

    @cached_property
    def film(self) -> Gather:
        """The image: of the film's rays, and of the irradiance at nodes where these stand on the sensor."""
        found = self._gather_film(self.sources, self.seen[~self.at_node], self.resolution.points)
        if not self.at_node.any():
            return found
        same = self.seen[self.at_node]
        place = dot(same.origin - self.geometry.start[same.segment], self.geometry.tangent[same.segment])
        mine = np.flatnonzero(self.node_segment == self.scene.sensor_segment)
        node = mine[np.abs(self.mesh.places.ravel()[mine] - place[:, None]).argmin(1)]
        shape = (self.scene.sensor.pixels, len(self.node_segment))
        return found.plus(csr_array((same.weight, (same.row, node)), shape), self.nodes)

    def _gather_glossy(self) -> tuple[Gather, csr_array]:
        """The radiance that reaches quadrature points of directions at glossy nodes; and the lobe's matrix on it."""
        directions, order = self.sources.directions, self.mesh.order
        assert directions is not None
        nodes = np.flatnonzero(np.repeat((self.sources.glossy > 0)[self.mesh.segment], order))
        rays = self._rays(nodes, np.arange(len(nodes)))
        arriving, owner, angle, weight = incoming(self.sources, rays, self.depth, max(4, self.resolution.points // 2))
        count, rows = directions.count, np.argsort(owner, kind="stable")
        values, columns, sizes = [], [], []
        for i, mine in enumerate(np.split(rows, np.searchsorted(owner[rows], np.arange(1, len(nodes))))):
            k = self.node_segment[nodes[i]]
            value = lobe(int(self.exponent[k]), directions.nodes[:, None], angle[None, mine])
            value *= self.sources.glossy[k] * np.cos(angle[mine]) * weight[mine]
            some = value > 1e-14
            values.append(value[some])
            columns.append(np.broadcast_to(mine.astype(np.int32), value.shape)[some])
            sizes.append(some.sum(1))
        first = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])
        matrix = csr_array((np.concatenate(values), np.concatenate(columns), first), (len(nodes) * count, len(owner)))
        return arriving, matrix

    # --- solving ----------------------------------------------------------------------------------------------------

    def _reflect(self, irradiance: np.ndarray, radiance: np.ndarray | None) -> _Sent:
        """What nodes send out of what arrives: by Lambert's lobe and by the glossy one."""
        diffuse = self.sources.lambert[self.node_segment] / 2 * irradiance
        return diffuse, None if self.glossy is None or radiance is None else self.glossy[1] @ radiance

    def _nothing(self) -> _Sent:
        directions = self.sources.directions
        empty = None if directions is None else np.zeros(self.sources.glossy_nodes * directions.count)
        return np.zeros(len(self.node_segment)), empty

    def _by(self, operator: Gather, emission: np.ndarray, sent: list[_Sent], k: int) -> np.ndarray:
        """What arrives by k edges; sent[j] is of j, and emission is no node's."""
        dark, by = np.zeros_like(emission), range(min(k, self.depth + 1))
        return np.sum([operator.apply(emission if k == d + 1 else dark, *sent[k - 1 - d], d) for d in by], axis=0)

    def _by_any(self, operator: Gather, emission: np.ndarray, sent: _Sent) -> np.ndarray:
        return np.sum([operator.apply(emission, *sent, d) for d in range(self.depth + 1)], axis=0)

    def orders(self, lengths: int) -> tuple[np.ndarray, Bound]:
        """The images, of shape (lengths, pixels), and the light that may have fallen between nodes."""
        emission = self.sources.emission
        sent, images, arrived = [self._nothing()], [], []
        for k in range(1, lengths + 1):
            images.append(self._by(self.film, emission, sent, k))
            if k < lengths:
                arrived.append(self._by(self.nodes, emission, sent, k))
                radiance = None if self.glossy is None else self._by(self.glossy[0], emission, sent, k)
                sent.append(self._reflect(arrived[-1], radiance))

        def left_out() -> np.ndarray:
            peaks = [float(emission.max()), *(_peak(part) for part in sent[1:])]
            most = [2 * max(peaks[max(0, k - 1 - self.depth) : k]) for k in range(1, lengths + 1)]
            bound = np.outer(most, self.lost)
            if lengths == 1 or self.unseen is None:
                return bound
            probes = self._probes(self.unseen)
            missed = [
                self.unseen.missed(self._by(probes, emission, sent, k), arrived[k - 1], most[k - 1])
                for k in range(1, lengths)
            ]
            # What lacks and what is too much make up for each other in part: of both sums the larger is the most.
            return bound + np.max(
                [np.abs(self._unseen_orders(self.unseen, part)) for part in zip(*missed, strict=True)], axis=0
            )

        return np.array(images), left_out

    def _probes(self, unseen: Unseen) -> Gather:
        segment, place = unseen.at
        rays = self._fan(segment, place, np.arange(len(segment)))
        points = max(4, self.resolution.points - 2)
        return gather(self.sources, rays, len(segment), self.depth, points, IRRADIANCE)

    def _unseen_orders(self, unseen: Unseen, missed: tuple[np.ndarray, ...]) -> np.ndarray:
        """The images of irradiances missed, of k = 1, 2, ... edges: seen themselves, or by way of the nodes."""
        dark, film = np.zeros_like(self.sources.emission), self._film_of_pieces
        pieces: list[_Sent] = [(unseen.on_pieces(np.zeros_like(missed[0])), None)]
        pieces += [(unseen.on_pieces(part), None) for part in missed]
        handed, every = [self._nothing()], [self._nothing()]
        for k, part in enumerate(missed, 1):
            radiance = None if self.glossy is None else self._by(self.glossy[0], dark, every, k)
            handed.append(self._reflect(self._by(self.nodes, dark, every, k), radiance))
            every.append(_sum(handed[-1], unseen.on_nodes(part, self.sources)))
        return np.array(
            [self._by(self.film, dark, handed, k) + self._by(film, dark, pieces, k) for k in range(1, len(missed) + 2)]
        )

    def solution(self) -> tuple[np.ndarray, Bound]:
        """The image of all lengths, of shape (1, pixels), and the light that may be missing from it.

        That is what fell between nodes, and what chains of mirrors too long to follow may add.
        """
        emission, shapes = self.sources.emission, self._nothing()
        dark, n = np.zeros_like(emission), len(shapes[0])

        def split(flat: np.ndarray) -> _Sent:
            return flat[:n], None if self.glossy is None else flat[n:]

        def joined(sent: _Sent) -> np.ndarray:
            return sent[0] if sent[1] is None else np.concatenate([sent[0], sent[1]])

        def step(emission: np.ndarray, flat: np.ndarray) -> np.ndarray:
            sent = split(flat)
            radiance = None if self.glossy is None else self._by_any(self.glossy[0], emission, sent)
            return joined(self._reflect(self._by_any(self.nodes, emission, sent), radiance))

        size = len(joined(shapes))
        first = step(emission, np.zeros(size))
        make: Any = LinearOperator  # its constructor returns one of several classes
        operator = make((size, size), matvec=lambda x: x - step(dark, np.ravel(x)), dtype=np.float64)
        flat, _ = gmres(operator, first, rtol=1e-13, atol=0.0, restart=100, maxiter=5)
        scale = np.abs(flat).max(initial=0)
        require(
            bool(np.abs(operator.matvec(flat) - first).max(initial=0) <= 1e-11 * max(scale, 1e-300))
            and scale <= 1e7 * emission.max(),
            f"converged: scene {self.scene.name} keeps all its light, or nearly; let something absorb, or leave a gap",
        )
        sent, chains = split(flat), self._left_out()

        def left_out() -> np.ndarray:
            most = 2 * max(float(emission.max()), _peak(sent))
            bound = chains + most * self.lost[None]
            if self.unseen is None:
                return bound
            found, nodes = (self._by_any(op, emission, sent) for op in (self._probes(self.unseen), self.nodes))
            film, shown = self._film_of_pieces, []
            for missed in self.unseen.missed(found, nodes, most):
                later = step(dark, joined(self.unseen.on_nodes(missed, self.sources)))
                handed, _ = gmres(operator, later, rtol=1e-6, atol=0.0, restart=100, maxiter=5)
                pieces = self._by_any(film, dark, (self.unseen.on_pieces(missed), None))
                shown.append(np.abs(pieces + self._by_any(self.film, dark, split(handed))))
            return bound + np.max(shown, axis=0)

        return self._by_any(self.film, emission, sent)[None], left_out

    def _left_out(self) -> float:
        missed = max(op.missed for op in (self.nodes, self.film, self.glossy and self.glossy[0]) if op is not None)
        if missed <= FAINT:
            return 0.0
        reflectance = self.scene.reflectance
        require(
            reflectance < 1,
            f"converged: scene {self.scene.name} has mirrors that hand light on for ever; let them absorb a little",
        )
        return missed * self.sources.emission.max() / (1 - reflectance) ** 2


def _peak(sent: _Sent) -> float:
    """The largest radiance that is sent out."""
    return float(sent[0].max(initial=0) + (0 if sent[1] is None else sent[1].max(initial=0)))


def _sum(one: _Sent, two: _Sent) -> _Sent:
    return one[0] + two[0], None if one[1] is None or two[1] is None else one[1] + two[1]


__all__ = ["FAINT", "Bound", "Transport"]
