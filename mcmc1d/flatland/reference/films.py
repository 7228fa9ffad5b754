"""The rays that make an image: of a pinhole's film, and of points along a wall."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from mcmc1d.flatland.reference.mesh import Mesh, Resolution, apart, graded, in_parts, legendre, scatters, shadow_cuts
from mcmc1d.flatland.reference.rays import Geometry, Rays, fan
from mcmc1d.flatland.reference.shadows import ShadowLines
from mcmc1d.flatland.scene import Pinhole, Scene


def pinhole_rays(sensor: Pinhole) -> Rays:
    """Those of the film, their rows its pixels, to be weighed by d tan(theta)."""
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
    return rays.replace(weight=np.full(pieces, sensor.pixels / (2 * limit)))


@dataclass(frozen=True)
class WallPoints:
    """Quadrature of the means over a wall sensor's pixels: arrays of N points."""

    pixel: np.ndarray
    place: np.ndarray
    weight: np.ndarray
    node: np.ndarray
    """Whether it is a node of the mesh."""
    lost: np.ndarray
    """The shares of pixels, (pixels,), where shadow lines are too many to look between them."""

    @staticmethod
    def of(scene: Scene, geometry: Geometry, mesh: Mesh, resolution: Resolution, lines: ShadowLines) -> "WallPoints":
        """In the sensor's panels of the mesh, if it scatters and they are cut at shadow lines, or in panels of its own.

        Between two neighbouring shadow lines, by way of any mirrors, what arrives is smooth, and is integrated there
        however close they are; in what is narrow by fewer points.
        """
        k, pixels = scene.sensor_segment, scene.sensor.pixels
        assert k is not None
        length, mine = geometry.length[k], mesh.segment == k
        edges = np.linspace(0, length, pixels + 1)
        shared = resolution.shadows and scatters(scene.segments[k])
        if shared:
            panels, order = np.append(mesh.low[mine], length), mesh.order
        else:
            direct, kinks = shadow_cuts(geometry, resolution, lines)
            near = replace(resolution, shadows=True, largest=min(resolution.largest, 0.5))
            cuts = graded(geometry, k, apart(edges, kinks[k], 1e-9 * length), direct, near, resolution.grading)
            panels, order = in_parts(cuts, resolution.parts), max(resolution.order, 8)
        inside, lost = lines.thinned(k)
        cuts = apart(panels, inside, 1e-9 * length)
        low, width, middle = cuts[:-1], np.diff(cuts), (cuts[1:] + cuts[:-1]) / 2
        panel = np.clip(np.searchsorted(panels, middle, "right") - 1, 0, len(panels) - 2)
        # An integrand that is analytic within a panel's length errs (ratio / 4)^(2 n).
        ratio = np.clip(width / np.diff(panels)[panel], 1e-9, 1)
        count = np.maximum(2, np.ceil(order * np.log(4) / np.log(4 / ratio) - 1e-6)).astype(int)
        pixel = np.clip(np.searchsorted(edges, middle, "right") - 1, 0, pixels - 1)
        found = []
        for n in np.unique(count):
            some = count == n
            nodes, weights, _ = legendre(int(n))
            at = low[some][:, None] + width[some][:, None] * (nodes + 1) / 2
            weight = width[some][:, None] * weights / 2 * pixels / length
            whole = shared & (ratio[some] > 1 - 1e-9)
            found.append((np.repeat(pixel[some], n), at.ravel(), weight.ravel(), np.repeat(whole, n)))
        overlaps = (np.minimum(lost[:, 1], b) - np.maximum(lost[:, 0], a) for a, b in itertools.pairwise(edges))
        shares = np.array([np.clip(x, 0, None).sum() for x in overlaps]) * pixels / length
        return WallPoints(*(np.concatenate(column) for column in zip(*found, strict=True)), lost=shares)


__all__ = ["WallPoints", "pinhole_rays"]
