"""Exact images: light of each length, or of all, by quadrature and linear algebra; no path is sampled."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mcmc1d.checks import require_instance, require_whole
from mcmc1d.flatland.reference.mesh import Resolution
from mcmc1d.flatland.reference.operators import TooLargeError
from mcmc1d.flatland.reference.rays import Geometry
from mcmc1d.flatland.reference.shadows import ShadowLines
from mcmc1d.flatland.reference.transport import FAINT, Bound, Transport
from mcmc1d.flatland.scene import Pinhole, Scene, Wall, require_scene

SMALL = Resolution()
"""For scenes of a few segments, of Lambert's lobe and mirrors: 1e-6 of the mean, or better; 1e-3 after many mirrors."""
GLOSSY = Resolution(order=7, points=9, smallest=1e-3, lobe=2.0)
"""For a few segments, of which some are glossy: 4e-3 of the mean, at low exponents too.

More where light goes to and fro between glossy walls: two in a corner 1e-2 by four edges, 0.15 by five.
"""
LARGE = Resolution(order=4, points=4, largest=1.0, longest=0.025, shadows=False)
"""For scenes of hundreds of segments: even panels, not cut at shadow lines; 1e-2 of the mean or so.

A wall sensor is cut at all of them; what narrow beams of light other walls' nodes miss stands in the errors.
"""
_ROUGH = Resolution(order=3, points=6, smallest=2e-2, lobe=3.0)
# Where memory does not hold what these take, the next is tried; what each errs by stands in `Reference.errors`.
_SMALL, _GLOSSY, _LARGE = (SMALL,), (GLOSSY, _ROUGH), (LARGE, replace(LARGE, order=2))
# From so many segments on, LARGE is the default.
_MANY = 60
# Mirrors in a row that `converged` follows at most.
_DEEPEST = 100


@dataclass(frozen=True)
class Reference:
    """Images and their errors, float64 of shape (lengths, pixels); row k - 1 is the light of exactly k edges.

    `errors` compares with a computation on panels twice as long, with two nodes fewer in each: of a length, the largest
    difference in any pixel (in one alone it may be small by accident), plus 1e-13 of the largest value for rounding.
    It is the coarser computation's error; the finer one's, of the values, is 4 to 8 times smaller or better. Where a
    lobe is glossy it is less sure, for quadrature meets the bend of max(cos_i, cos_o) where it will, and both may be
    off alike: there 3 times it, or an eighth of the same difference of the coarser one and a third, coarser yet,
    whichever is more: half as much again as errors that fall fourfold would leave.

    Added is what both miss between their nodes: in each interval between neighbouring shadow lines that holds no node,
    twice the difference, in its middle, of the irradiance and the nodes' polynomial. Where the sensor sees it, it is
    where it is. Handed on from wall to wall it is an estimate: spread over its panel, and of a glossy lobe the peak, at
    normal incidence, in every direction. Of more than 20,000 intervals the narrowest count as lit by the most there is.
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
    lines = _shadow_lines(scene, lengths - 1) if lengths > 1 or isinstance(scene.sensor, Wall) else None
    return _compared(scene, resolution, lambda r: Transport(scene, lengths - 1, r, lines, lengths > 1).orders(lengths))


def converged(scene: Scene, resolution: Resolution | None = None) -> Reference:
    """The image of all lengths at once, one row: the solution of the linear system.

    Chains of mirrors end where their light is below 1e-15, or after 100; what is left there is added to the errors.
    Raises `ValueError` where light has no end: in a closed room that absorbs nothing.
    """
    require_scene(scene, "converged: the scene")
    mirrors = max(segment.material.mirror for segment in scene.segments)
    depth = 0 if mirrors == 0 else _DEEPEST
    if 0 < mirrors < 1:
        depth = min(_DEEPEST, int(np.ceil(np.log(FAINT) / np.log(mirrors))))
    lines = _shadow_lines(scene, depth)
    return _compared(scene, resolution, lambda r: Transport(scene, depth, r, lines).solution())


def _shadow_lines(scene: Scene, depth: int) -> ShadowLines | None:
    """None where nobody asks for them: where nothing but lamps and mirrors is seen by a pinhole."""
    scatters = any(segment.material.lambert > 0 or segment.material.glossy > 0 for segment in scene.segments)
    if not scatters and isinstance(scene.sensor, Pinhole):
        return None
    return ShadowLines.of(scene, Geometry.of(scene), depth if scene.mirrors else 0)


def _compared(
    scene: Scene, resolution: Resolution | None, compute: Callable[[Resolution], tuple[np.ndarray, Bound]]
) -> Reference:
    """The finest of several computations, and its errors; the light that it may have left out is asked of it alone."""
    if resolution is not None:
        require_instance(resolution, Resolution, "resolution")
    default = _LARGE if len(scene.segments) >= _MANY else _GLOSSY if scene.glossy else _SMALL
    coarse, *rougher = default if resolution is None else (resolution,)
    while True:
        try:  # the finer one first: where memory holds it, it holds both
            second, left_out = compute(coarse.finer())
            bound = left_out()
            del left_out  # which holds all the operators
            first, _ = compute(coarse)
            break
        except TooLargeError:
            if not rougher:
                raise
            coarse = rougher.pop(0)
    rounding = 1e-13 * np.abs(second).max(initial=0)
    worst = np.abs(second - first).max(1, keepdims=True)
    if scene.glossy:
        rough, _ = compute(coarse.coarser())
        worst = np.maximum(3 * worst, np.abs(first - rough).max(1, keepdims=True) / 8)
    worst = worst + bound.max(1, keepdims=True)
    return Reference(second, np.broadcast_to(worst + rounding, second.shape).copy())


__all__ = ["GLOSSY", "LARGE", "SMALL", "Reference", "converged", "image"]
