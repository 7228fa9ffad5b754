"""Panels along the segments, and the quadrature of what is seen of them.

What a segment sends out is smooth but for shadow lines, where an end of a segment covers another end, and for
neighbourhoods of corners and ends. Panels are cut at the first and graded towards the second (Atkinson, Chandler 1990,
"Boundary integral equation methods for solving Laplace's equation with nonlinear boundary conditions: the smooth
boundary case" and the radiosity collocation of Atkinson 2000 grade so). Inside a panel: Gauss-Legendre nodes.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from mcmc1d.flatland.reference.rays import Geometry, Rays, dot, expand, place
from mcmc1d.flatland.reference.shadows import ShadowLines
from mcmc1d.flatland.scene import Scene, Segment

# A segment is cut at so many shadow lines by way of mirrors at most, and by way of so many mirrors: else the mesh has
# no end. What light the nodes miss between the others stands in the errors (`Unseen`).
_KINKS, _DEEP = 40, 4


@dataclass(frozen=True)
class Resolution:
    """How finely the plane is cut."""

    order: int = 8
    """Nodes in a panel."""
    points: int = 10
    """Gauss-Legendre points in a piece of what is seen."""
    grading: float = 1.0
    """A panel is at most so many times as long as it is far from the ends of other segments."""
    corner: float = 0.3
    """The ratio of the last panel to the last two, next to a corner."""
    smallest: float = 3e-4
    """Where grading ends, as a share of the scene's extent."""
    largest: float = 0.5
    """The longest panel, as a share of its segment."""
    longest: float = 1.0
    """The same, as a share of the scene's extent."""
    parts: int = 1
    """Into how many equal parts each panel is cut in the end."""
    shadows: bool = True
    """Whether panels are cut at the shadow lines and graded."""
    lobe: float = 1.4
    """The widest panel of directions at a glossy segment, times the square root of the exponent, in radians."""

    def finer(self) -> "Resolution":
        """One with panels half as long, of two nodes more: it errs 4 to 8 times less even at a kink in a panel."""
        return replace(
            self,
            order=self.order + 2,
            points=self.points + 2,
            parts=2 * self.parts,
            smallest=0.3 * self.smallest,
            lobe=0.5 * self.lobe,
        )

    def coarser(self) -> "Resolution":
        """One with panels up to twice as long, of two nodes fewer, where it can have fewer."""
        return replace(
            self,
            order=max(1, self.order - 2),
            points=max(1, self.points - 2),
            parts=max(1, self.parts // 2),
            grading=2 * self.grading,
            largest=min(1.0, 2 * self.largest),
            longest=2 * self.longest,
            smallest=self.smallest / 0.3,
            lobe=2 * self.lobe,
        )


@dataclass(frozen=True)
class Mesh:
    """Panels, sorted by segment and place: arrays of shape (P,). A segment that sends nothing on has one panel."""

    segment: np.ndarray
    low: np.ndarray
    high: np.ndarray
    order: int

    @property
    def local(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gauss-Legendre nodes and weights on [-1, 1], and the matrix from values there to Legendre coefficients."""
        return legendre(self.order)

    @property
    def places(self) -> np.ndarray:
        """The nodes' places along their segments, (P, order)."""
        return self.low[:, None] + (self.high - self.low)[:, None] * (self.local[0] + 1) / 2


@dataclass(frozen=True)
class Points:
    """Quadrature points, (M, q): of piece m, all in one panel, what row `row[m]` sees of it."""

    row: np.ndarray
    panel: np.ndarray
    bounces: np.ndarray
    weight: np.ndarray
    """In angle, d theta, times the mirrors' reflectances; (M, q)."""
    cosine: np.ndarray
    """Of the angle at the point that sees, (M, q)."""
    sine: np.ndarray
    local: np.ndarray
    """The place in the panel, in [-1, 1], (M, q)."""
    slope: np.ndarray
    """At the point seen, the tangent of the angle of the direction in which it is seen, (M, q)."""

    @property
    def angle(self) -> np.ndarray:
        """At the point that sees, in radians, (M, q)."""
        return np.arctan2(self.sine, self.cosine)


def legendre(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [-1, 1] and the matrix (order, order) from values to coefficients."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    n = np.arange(order)
    return nodes, weights, (n[:, None] + 0.5) * weights * np.polynomial.legendre.legvander(nodes, order - 1).T


def make_mesh(
    scene: Scene, geometry: Geometry, resolution: Resolution, lines: ShadowLines | None, steepest: int
) -> Mesh:
    """The panels of a scene, cut at its shadow lines; `steepest` is the largest glossy exponent or 0.

    A lobe of exponent n shows another segment's end at distance d over about d / sqrt(n): the grading follows.
    """
    direct, kinks = shadow_cuts(geometry, resolution, lines)
    grading = resolution.grading * min(1.0, 2 / np.sqrt(max(steepest, 1)))
    rows = []
    for k, segment in enumerate(scene.segments):
        cuts = np.array([0.0, geometry.length[k]])
        if scatters(segment):
            if k == scene.sensor_segment:
                cuts = np.linspace(0, geometry.length[k], scene.sensor.pixels + 1)
            cuts = apart(cuts, kinks[k], 1e-9 * geometry.length[k])
            cuts = graded(geometry, k, cuts, direct, resolution, grading)
        cuts = in_parts(cuts, resolution.parts)
        rows.append((np.full(len(cuts) - 1, k), cuts[:-1], cuts[1:]))
    return Mesh(*(np.concatenate(column) for column in zip(*rows, strict=True)), order=resolution.order)


def scatters(segment: Segment) -> bool:
    """Whether it has a lobe that is no mirror."""
    return segment.material.lambert > 0 or segment.material.glossy > 0


def shadow_cuts(
    geometry: Geometry, resolution: Resolution, lines: ShadowLines | None
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """For each segment, the shadow lines of what is seen directly, and all those that it is cut at."""
    if lines is None or not resolution.shadows:
        none = [np.zeros(0)] * len(geometry.length)
        return none, none
    direct, every = [], []
    for k in range(len(geometry.length)):
        upto = [lines.on(k, d) for d in range(min(lines.depth, _DEEP) + 1)]
        direct.append(upto[0])
        every.append(max((p for p in upto if len(p) <= _KINKS), key=len, default=upto[0]))
    return direct, every


def in_parts(cuts: np.ndarray, parts: int) -> np.ndarray:
    """Each interval in so many equal parts."""
    whole = np.arange(len(cuts))
    return np.interp(np.arange(parts * whole[-1] + 1) / parts, whole, cuts)


def apart(cuts: np.ndarray, more: np.ndarray, tiny: float) -> np.ndarray:
    """`cuts`, and those of `more` that are no copies."""
    both = np.sort(np.concatenate([cuts, more]))
    both = both[np.concatenate([[True], np.diff(both) > tiny])]
    both[-1] = cuts[-1]
    return both


def graded(
    geometry: Geometry, k: int, cuts: np.ndarray, kinks: list[np.ndarray], resolution: Resolution, grading: float
) -> np.ndarray:
    """The cuts of segment k, refined towards what lies near: ends of other segments, and shadow lines on them."""
    longest = min(resolution.largest * geometry.length[k], resolution.longest * geometry.extent)
    smallest = resolution.smallest * geometry.extent
    others = [j for j in range(len(kinks)) if j != k]
    near = [point for j in others for point in (geometry.start[j], geometry.end[j])]
    near += [geometry.start[j] + s * geometry.tangent[j] for j in others for s in kinks[j]]
    offset = np.array(near).reshape(-1, 2) - geometry.start[k]
    tiny = 1e-9 * geometry.extent
    height, along = offset @ geometry.normal[k], offset @ geometry.tangent[k]
    # A T, or a corner: a cut of its own.
    touching = along[np.abs(height) <= tiny]
    seen = height >= -tiny if resolution.shadows else np.zeros(len(offset), bool)
    height, along = height[seen], along[seen]
    cuts = apart(cuts, touching[(touching > tiny) & (touching < geometry.length[k] - tiny)], tiny)
    todo, done = list(itertools.pairwise(cuts)), [cuts[0]]
    while todo:
        a, b = todo.pop(0)
        far = np.hypot(height, np.maximum(np.maximum(a - along, along - b), 0))
        close = far <= tiny
        first, last = (bool(np.any(np.abs(along[close] - end) <= tiny)) for end in (a, b))
        beside = np.abs(height) > tiny
        gap = grading * far.min(initial=np.inf, where=~close & beside)
        gap = min(gap, 1.001 * (1 / resolution.corner - 1) * far.min(initial=np.inf, where=~close & ~beside))
        if (first or last) and b - a > smallest:
            ratio = 0.5 if first and last else resolution.corner if first else 1 - resolution.corner
            middle = a + ratio * (b - a)
        elif b - a > max(min(longest, gap), smallest):
            middle = (a + b) / 2
        else:
            done.append(b)
            continue
        todo[:0] = [(a, middle), (middle, b)]
    return np.array(done)


def quadrature(
    geometry: Geometry, mesh: Mesh, found: Rays, points: int, directions: np.ndarray | None, shiny: np.ndarray
) -> Points:
    """Points for what the rays hit, split at the panels; of `shiny` (S,) segments at the angles `directions` too.

    With D the height of the origin over the hit segment's line and s = foot + D sinh(v), d theta = d v / cosh(v):
    all is analytic for |Im v| < pi / 2, however near the origin (the sinh transformation of Johnston, Elliott 2005).
    So pieces are at most 1.5 wide in v, where 10 points reach 1e-13.
    """
    k = found.segment
    offset = found.origin - geometry.start[k]
    foot, height = dot(offset, geometry.tangent[k]), dot(offset, geometry.normal[k])
    both = np.sort([place(geometry, found, found.low), place(geometry, found, found.high)], axis=0)
    slope = (both - foot) / height
    # At the panels, counted in segments and shares of them.
    limits = mesh.segment + mesh.low / geometry.length[mesh.segment]
    share = both / geometry.length[k]
    first = np.searchsorted(limits, k + share[0] + 1e-13, "right") - 1
    last = np.searchsorted(limits, k + share[1] - 1e-13, "left") - 1
    piece, step = expand(np.maximum(last - first + 1, 0))
    panel = first[piece] + step
    low = np.maximum(slope[0][piece], (mesh.low[panel] - foot[piece]) / height[piece])
    high = np.minimum(slope[1][piece], (mesh.high[panel] - foot[piece]) / height[piece])
    if directions is not None:
        piece, panel, low, high = _split(piece, panel, low, high, np.tan(directions[1:-1]), shiny[k[piece]])
    low, high = np.arcsinh(low), np.arcsinh(high)
    parts = np.maximum(np.ceil((high - low) / 1.5).astype(int), 0)
    part, step = expand(parts)
    width = (high - low)[part] / parts[part]
    low, piece, panel = low[part] + step * width, piece[part], panel[part]
    nodes, weights, _ = legendre(points)
    v = low[:, None] + width[:, None] * (nodes + 1) / 2
    grown = np.exp(v)
    slope, cosine = (grown - 1 / grown) / 2, 2 / (grown + 1 / grown)
    sine = slope * cosine
    seen, tangent, normal = found[piece], geometry.tangent[k[piece]], geometry.normal[k[piece]]
    x = sine * dot(tangent, seen.normal)[:, None] - cosine * dot(normal, seen.normal)[:, None]
    y = sine * dot(tangent, seen.tangent)[:, None] - cosine * dot(normal, seen.tangent)[:, None]
    s = foot[piece][:, None] + height[piece][:, None] * slope
    size = (mesh.high - mesh.low)[panel]
    return Points(
        row=seen.row,
        panel=panel,
        bounces=seen.bounces,
        weight=width[:, None] * weights / 2 * cosine * seen.weight[:, None],
        cosine=x,
        sine=y,
        local=np.clip(2 * (s - mesh.low[panel][:, None]) / size[:, None] - 1, -1, 1),
        slope=-slope,
    )


def _split(piece, panel, low, high, at, wanted):
    """Intervals cut at the rising numbers `at`, where `wanted`."""
    first, last = np.searchsorted(at, low, "right"), np.searchsorted(at, high, "left")
    first, last = np.where(wanted, first, 0), np.where(wanted, last, 0)
    part, step = expand(np.maximum(last - first + 1, 0))
    limits = np.concatenate([[-np.inf], at, [np.inf]])
    j = first[part] + step
    lower, upper = np.maximum(low[part], limits[j]), np.minimum(high[part], limits[j + 1])
    whole = ~wanted[part]
    return piece[part], panel[part], np.where(whole, low[part], lower), np.where(whole, high[part], upper)


__all__ = [
    "Mesh",
    "Points",
    "Resolution",
    "apart",
    "graded",
    "in_parts",
    "legendre",
    "make_mesh",
    "quadrature",
    "scatters",
    "shadow_cuts",
]
