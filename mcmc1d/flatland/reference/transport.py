"""Exact images: light of each length, or of all, by quadrature and linear algebra; no path is sampled.

B_k(x), what Lambert's lobe sends out after k edges, and G_k(x, theta), the glossy lobe's, are polynomials on panels.
What arrives by k edges is L_e for k = 1, B_k + G_k of what is seen, and the same by way of mirrors, each an edge.
"""

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, gmres

from mcmc1d.checks import require_whole
from mcmc1d.flatland.reference.glossy import Directions, lobe
from mcmc1d.flatland.reference.mesh import Resolution, make_mesh
from mcmc1d.flatland.reference.operators import FILM, IRRADIANCE, Gather, Sources, TooLargeError, gather, incoming
from mcmc1d.flatland.reference.rays import Geometry, Rays, fan
from mcmc1d.flatland.scene import Pinhole, Scene, require_scene
from mcmc1d.numerics import require

SMALL = Resolution()
"""For scenes of a few segments, of Lambert's lobe and mirrors: 1e-6 of the mean, or better."""
GLOSSY = Resolution(order=7, points=9, smallest=1e-3, lobe=2.0)
"""For a few segments, of which some are glossy: 1e-4 of the mean."""
LARGE = Resolution(order=4, points=4, largest=1.0, longest=0.025, shadows=False)
"""For scenes of hundreds of segments: even panels, shadow lines not found; 5e-3 of the mean or so."""
_ROUGH = Resolution(order=3, points=6, smallest=2e-2, lobe=3.0)
# Where memory does not hold what these take, the next is tried; what each errs by stands in `Reference.errors`.
_SMALL, _GLOSSY, _LARGE = (SMALL,), (GLOSSY, _ROUGH), (LARGE, replace(LARGE, order=2))
# From so many segments on, LARGE is the default.
_MANY = 60
# Mirrors in a row that `converged` follows at most, and the share of light that it may leave behind them.
_DEEPEST, _FAINT = 100, 1e-15
# At the mesh's nodes, and at the glossy ones for each direction.
_Sent: TypeAlias = tuple[np.ndarray, np.ndarray | None]


@dataclass(frozen=True)
class Reference:
    """Images and their errors, float64 of shape (lengths, pixels); row k - 1 is the light of exactly k edges.

    `errors` compares with a computation on panels twice as long, with two nodes fewer in each: of a length, the largest
    difference in any pixel (in one alone it may be small by accident), plus 1e-13 of the largest value for rounding.
    It is the coarser computation's error; the finer one's, of the values, is 4 to 8 times smaller or better. Where a
    lobe is glossy it is less sure, for quadrature meets the bend of max(cos_i, cos_o) where it will: there 3 times it.
    """

    values: np.ndarray
    errors: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """The image of all the lengths, (pixels,)."""
        return self.values.sum(0)

    @property
    def total_errors(self) -> np.ndarray:
        """The errors' sum, (pixels,)."""
        return self.errors.sum(0)


def image(scene: Scene, lengths: int, resolution: Resolution | None = None) -> Reference:
    """The images of paths of exactly 1, 2, ..., `lengths` edges.

    Raises `ValueError` where the scene's glossy walls are too many for the resolution.
    """
    require_scene(scene, "image: the scene")
    require_whole(lengths, "image: lengths")
    return _compared(scene, resolution, lambda r: (_Transport(scene, lengths - 1, r, lengths > 1).orders(lengths), 0.0))


def converged(scene: Scene, resolution: Resolution | None = None) -> Reference:
    """The image of all lengths at once, one row: the solution of the linear system.

    Chains of mirrors end where their light is below 1e-15, or after 100; what is left there is added to the errors.
    Raises `ValueError` where light has no end: in a closed room that absorbs nothing.
    """
    require_scene(scene, "converged: the scene")
    mirrors = max(segment.material.mirror for segment in scene.segments)
    depth = 0 if mirrors == 0 else _DEEPEST
    if 0 < mirrors < 1:
        depth = min(_DEEPEST, int(np.ceil(np.log(_FAINT) / np.log(mirrors))))
    return _compared(scene, resolution, lambda r: _Transport(scene, depth, r).solution())


def _compared(scene: Scene, resolution: Resolution | None, compute) -> Reference:
    default = _LARGE if len(scene.segments) >= _MANY else _GLOSSY if scene.glossy else _SMALL
    coarse, *rougher = default if resolution is None else (resolution,)
    while True:
        try:  # the finer one first: where memory holds it, it holds both
            second, left_out = compute(coarse.finer())
            first, _ = compute(coarse)
            break
        except TooLargeError:
            if not rougher:
                raise
            coarse = rougher.pop(0)
    rounding = 1e-13 * np.abs(second).max(initial=0)
    worst = (3 if scene.glossy else 1) * np.abs(second - first).max(1, keepdims=True)
    return Reference(second, np.broadcast_to(worst + rounding + left_out, second.shape).copy())


class _Transport:
    """The operators of one scene at one resolution, for chains of up to `depth` mirrors."""

    def __init__(self, scene: Scene, depth: int, resolution: Resolution, scattered: bool = True):
        materials = [segment.material for segment in scene.segments]
        if not scene.mirrors:
            depth = 0
        steepest = max((m.exponent for m in materials if m.glossy > 0), default=0)
        self.scene, self.depth, self.resolution = scene, depth, resolution
        self.geometry = Geometry.of(scene)
        self.mesh = make_mesh(scene, self.geometry, resolution, depth, steepest)
        glossy = scattered and steepest > 0  # a lamp seen directly asks for no lobe
        directions = Directions.of(steepest, resolution.lobe, resolution.order) if glossy else None
        self.sources = Sources.of(self.geometry, self.mesh, materials, directions)
        self.exponent = np.array([m.exponent for m in materials])
        self.node_segment = np.repeat(self.mesh.segment, self.mesh.order)
        self.nodes = self._gather_nodes()
        self.glossy = self._gather_glossy() if directions is not None else None
        self.film = self._gather_film() if isinstance(scene.sensor, Pinhole) else None

    # --- what arrives where -----------------------------------------------------------------------------------------

    def _rays(self, nodes: np.ndarray, row: np.ndarray) -> Rays:
        segment, g = self.node_segment[nodes], self.geometry
        points = g.start[segment] + self.mesh.places.ravel()[nodes][:, None] * g.tangent[segment]
        return fan(row, points, g.normal[segment], segment, np.pi / 2)

    def _gather_nodes(self) -> Gather:
        wanted = (self.sources.lambert > 0)[self.mesh.segment]
        if self.scene.sensor_segment is not None:
            wanted |= self.mesh.segment == self.scene.sensor_segment
        nodes = np.flatnonzero(np.repeat(wanted, self.mesh.order))
        rays = self._rays(nodes, nodes)
        return gather(self.sources, rays, len(self.node_segment), self.depth, self.resolution.points, IRRADIANCE)

    def _gather_film(self) -> Gather:
        sensor = self.scene.sensor
        assert isinstance(sensor, Pinhole)
        # A film's edges, and cuts that grow with the slope: 1 / cos^2 is steep at grazing angles.
        limit = np.tan(sensor.half_angle)
        grown = 2.0 ** np.arange(-1, 12)
        edges = np.linspace(-limit, limit, sensor.pixels + 1)
        cuts = np.unique(np.concatenate([edges, [0.0], grown[grown < limit], -grown[grown < limit]]))
        pieces = len(cuts) - 1
        normal = np.asarray(sensor.direction, np.float64) / np.hypot(*sensor.direction)
        middle = (cuts[1:] + cuts[:-1]) / 2
        # A fan's angles grow clockwise, along the tangent that has its normal to the left; the film's do not.
        pixel = np.clip(np.searchsorted(edges, -middle, "right") - 1, 0, sensor.pixels - 1)
        origin = np.broadcast_to(np.asarray(sensor.position, np.float64), (pieces, 2))
        rays = fan(pixel, origin, np.broadcast_to(normal, (pieces, 2)), np.full(pieces, -1), 0.0)
        angles = np.arctan(cuts)
        rays = rays.replace(low=angles[:-1], high=angles[1:])
        rays = rays.replace(weight=np.full(pieces, sensor.pixels / (2 * limit)))
        return gather(self.sources, rays, sensor.pixels, self.depth, self.resolution.points, FILM)

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

    def _pixels(self, irradiance: np.ndarray) -> np.ndarray:
        """The means over the sensor's pixels of irradiance at the nodes."""
        mesh, k = self.mesh, self.scene.sensor_segment
        mine = mesh.segment == k
        mass = irradiance.reshape(-1, mesh.order)[mine] @ mesh.local[1] / 2 * (mesh.high - mesh.low)[mine]
        assert k is not None
        count, length = self.scene.sensor.pixels, self.geometry.length[k]
        pixel = np.floor((mesh.low + mesh.high)[mine] / 2 / length * count).astype(int)
        return np.bincount(pixel, mass, count) * count / length

    def _reflect(self, irradiance: np.ndarray, radiance: np.ndarray | None) -> _Sent:
        """What nodes send out of what arrives: by Lambert's lobe and by the glossy one."""
        diffuse = self.sources.lambert[self.node_segment] / 2 * irradiance
        return diffuse, None if self.glossy is None or radiance is None else self.glossy[1] @ radiance

    def _nothing(self) -> _Sent:
        directions = self.sources.directions
        empty = None if directions is None else np.zeros(self.sources.glossy_nodes * directions.count)
        return np.zeros(len(self.node_segment)), empty

    def orders(self, lengths: int) -> np.ndarray:
        """The images, of shape (lengths, pixels)."""
        dark = np.zeros_like(self.sources.emission)
        sent, images = [self._nothing()], []  # sent[k - 1] of k edges; emission is no node's
        for k in range(1, lengths + 1):

            def arrives(operator: Gather, k: int = k) -> np.ndarray:
                by = range(min(k, self.depth + 1))
                lit = [self.sources.emission if k == d + 1 else dark for d in by]
                return np.sum([operator.apply(lit[d], *sent[k - 1 - d], d) for d in by], axis=0)

            irradiance = arrives(self.nodes)
            images.append(self._pixels(irradiance) if self.film is None else arrives(self.film))
            if k < lengths:
                sent.append(self._reflect(irradiance, None if self.glossy is None else arrives(self.glossy[0])))
        return np.array(images)

    def solution(self) -> tuple[np.ndarray, float]:
        """The image of all lengths, of shape (1, pixels), and what chains of mirrors too long to follow may add."""
        dark, shapes = np.zeros_like(self.sources.emission), self._nothing()
        n = len(shapes[0])

        def arrives(operator: Gather, emission: np.ndarray, sent: _Sent) -> np.ndarray:
            return np.sum([operator.apply(emission, *sent, d) for d in range(self.depth + 1)], axis=0)

        def step(emission: np.ndarray, flat: np.ndarray) -> np.ndarray:
            sent = (flat[:n], None if self.glossy is None else flat[n:])
            radiance = None if self.glossy is None else arrives(self.glossy[0], emission, sent)
            diffuse, shiny = self._reflect(arrives(self.nodes, emission, sent), radiance)
            return diffuse if shiny is None else np.concatenate([diffuse, shiny])

        size = n + (0 if shapes[1] is None else len(shapes[1]))
        first = step(self.sources.emission, np.zeros(size))
        make: Any = LinearOperator  # its constructor returns one of several classes
        operator = make((size, size), matvec=lambda x: x - step(dark, np.ravel(x)), dtype=np.float64)
        flat, _ = gmres(operator, first, rtol=1e-13, atol=0.0, restart=100, maxiter=5)
        scale = np.abs(flat).max(initial=0)
        require(
            bool(np.abs(operator.matvec(flat) - first).max(initial=0) <= 1e-11 * max(scale, 1e-300))
            and scale <= 1e7 * self.sources.emission.max(),
            f"converged: scene {self.scene.name} keeps all its light, or nearly; let something absorb, or leave a gap",
        )
        sent = (flat[:n], None if self.glossy is None else flat[n:])
        irradiance = arrives(self.nodes, self.sources.emission, sent)
        shown = self._pixels(irradiance) if self.film is None else arrives(self.film, self.sources.emission, sent)
        return shown[None], self._left_out()

    def _left_out(self) -> float:
        missed = max(op.missed for op in (self.nodes, self.film, self.glossy and self.glossy[0]) if op is not None)
        if missed <= _FAINT:
            return 0.0
        reflectance = self.scene.reflectance
        require(
            reflectance < 1,
            f"converged: scene {self.scene.name} has mirrors that hand light on for ever; let them absorb a little",
        )
        return missed * self.sources.emission.max() / (1 - reflectance) ** 2


__all__ = ["GLOSSY", "LARGE", "SMALL", "Reference", "converged", "image"]
