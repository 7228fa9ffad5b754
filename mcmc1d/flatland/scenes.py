"""The catalogue of scenes: small ones from the TOML files in `scenes/`, large ones generated; and what they share.

Every front faces where the light is: rooms run counter-clockwise, what stands in them clockwise.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

from mcmc1d.checks import require
from mcmc1d.flatland.files import read
from mcmc1d.flatland.scene import Material, Pinhole, Point, Scene, Segment
from mcmc1d.flatland.schema import nearest

_FOLDER = Path(__file__).with_name("scenes")


def catalogue() -> Mapping[str, Callable[[], Scene]]:
    """By name, what makes each scene."""
    small = {path.stem: partial(read, path) for path in sorted(_FOLDER.glob("*.toml"))}
    return {**small, "lab": lab, "office": office}


def scene(name: str) -> Scene:
    """A scene of the catalogue; `ValueError` with the nearest name where there is none of this one."""
    known = catalogue()
    require(isinstance(name, str), f"scene: give the name of a scene, not {name!r}")
    require(name in known, f"there is no scene {name!r}; {nearest(name, known)}")
    return known[name]()


# --- parts of scenes ------------------------------------------------------------------------------------------------


def polygon(points: Sequence[Point], materials: Material | Sequence[Material]) -> list[Segment]:
    """The closed polygon's sides, of one material or of one each; counter-clockwise, the fronts face inside."""
    sides = list(pairwise([*points, points[0]]))
    each = [materials] * len(sides) if isinstance(materials, Material) else list(materials)
    require(len(each) == len(sides), f"polygon: {len(sides)} sides need as many materials, not {len(each)}")
    return [Segment(start, end, material) for (start, end), material in zip(sides, each, strict=True)]


def block(centre: Point, size: Point, materials: Material | Sequence[Material], turns: int = 0) -> list[Segment]:
    """A rectangle of `size` with its fronts outside, turned by quarter turns; sides: left, top, right, bottom."""
    w, h = size[0] / 2, size[1] / 2
    return polygon([_turned(centre, corner, turns) for corner in ((-w, -h), (-w, h), (w, h), (w, -h))], materials)


def _turned(centre: Point, by: Point, turns: int) -> Point:
    """`centre` plus `by` turned counter-clockwise by quarter turns; rounded to 1e-6, so that it is a simple number."""
    x, y = by
    for _ in range(turns % 4):
        x, y = -y, x
    return round(centre[0] + x, 6), round(centre[1] + y, 6)


# --- large scenes ---------------------------------------------------------------------------------------------------


def lab() -> Scene:
    """A room of 9 by 4 with 33 small lamps, of emissions from 0.5 to 40: 18 in the ceiling, 15 over three benches."""
    wall, bench, metal = Material(lambert=0.6), Material(lambert=0.4), Material(lambert=0.1, glossy=0.7, exponent=40)
    outline = [(0.0, 4.0), (0.0, 0.0)]
    for left in (1.0, 4.0, 7.0):  # the benches are part of the floor
        outline += [(left, 0.0), (left, 1.0), (left + 1, 1.0), (left + 1, 0.0)]
    outline += [(9.0, 0.0), (9.0, 4.0)]
    benches = {3, 7, 11}  # their tops
    segments = [Segment(a, b, bench if k in benches else wall) for k, (a, b) in enumerate(pairwise(outline))]
    strengths = (0.5, 1.0, 2.0, 5.0, 10.0, 40.0)
    x = 9.0
    for k in range(18):  # from right to left, so that the ceiling faces down
        lamp = round(8.7 - 0.48 * k, 6)
        segments.append(Segment((x, 4.0), (lamp, 4.0), wall))
        x = round(lamp - 0.08, 6)
        segments.append(Segment((lamp, 4.0), (x, 4.0), Material(strengths[k * 5 % 6] / 2, lambert=0.2)))
    segments.append(Segment((x, 4.0), (0.0, 4.0), wall))
    for k in range(15):
        centre = (round(1.1 + 3 * (k // 5) + 0.2 * (k % 5), 6), (1.3, 1.5)[k % 2])
        segments += block(centre, (0.1, 0.1), [Material(strengths[k * 7 % 6]), metal, metal, metal], turns=k)
    return Scene("lab", tuple(segments), Pinhole((0.4, 2.4), (1.0, -0.2), 0.6))


def office() -> Scene:
    """A plan of 10 by 8: 48 workplaces of a desk, a screen, a chair and a lamp, partitions and windows: 799 segments.

    Every third workplace's lamp is on, of emissions 4, 8 and 16 in turn. Workplaces stand turned by quarter turns.
    """
    wall, window = Material(lambert=0.6), Material(0.5, lambert=0.1)
    segments = polygon([(0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (0.0, 8.0)], [wall] * 4)[:3]
    for bottom in range(0, 8, 2):  # the left wall, from the top; half of it are windows
        y = 8.0 - bottom
        segments.append(Segment((0.0, y), (0.0, y - 1), window))
        segments.append(Segment((0.0, y - 1), (0.0, y - 2), wall))
    for k in range(48):
        centre = (round(0.85 + 1.1 * (k % 8), 6), round(0.75 + 1.3 * (k // 8), 6))
        segments += _workplace(centre, turns=k * 7 // 3, emission=(4.0, 8.0, 16.0)[k // 3 % 3] if k % 3 == 0 else 0.0)
    for k in range(5):  # between the rows
        segments += block((3.6 if k % 2 else 5.6, round(1.4 + 1.3 * k, 6)), (6.4, 0.06), Material(lambert=0.5))
    return Scene("office", tuple(segments), Pinhole((9.5, 0.4), (-0.8, 1.0), 0.7))


def _workplace(centre: Point, turns: int, emission: float) -> list[Segment]:
    """Within 0.42 of the centre: a desk, a glossy screen, a mirroring chair, and a lamp that faces the screen."""
    desk, glass, steel = Material(lambert=0.5), Material(lambert=0.1, glossy=0.6, exponent=30), Material(mirror=0.7)
    dark = Material(lambert=0.2)
    lamp = [dark, dark, Material(emission, lambert=0.2), dark]
    parts = (
        ((0.0, 0.1), (0.6, 0.16), desk),
        ((0.3, 0.34), (0.05, 0.12), glass),
        ((0.05, -0.3), (0.2, 0.12), steel),
        ((-0.3, 0.34), (0.06, 0.12), lamp),
    )
    return [side for by, size, materials in parts for side in block(_turned(centre, by, turns), size, materials, turns)]


__all__ = ["block", "catalogue", "lab", "office", "polygon", "scene"]
