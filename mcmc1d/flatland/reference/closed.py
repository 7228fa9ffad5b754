"""Closed forms, of nothing but elementary geometry: they share no code with the solver that they check."""

import math
from collections.abc import Iterable

from mcmc1d.checks import require
from mcmc1d.flatland.scene import Point


def furnace(emission: float, reflectance: float, edges: int | None = None) -> float:
    """The radiance everywhere in a closed room whose walls all emit L_e and reflect rho (Lambert or mirror).

    L_e (1 - rho^K) / (1 - rho) of paths up to K edges; L_e / (1 - rho) of all. A path of exactly k: L_e rho^(k - 1).
    """
    require(0 <= reflectance < 1, f"furnace: the reflectance must be under 1, and not negative: {reflectance}")
    return emission * (1 if edges is None else 1 - reflectance**edges) / (1 - reflectance)


def visible_intervals(
    point: Point, normal: Point, lamp: tuple[Point, Point], screens: Iterable[tuple[Point, Point]] = ()
) -> list[tuple[float, float]]:
    """The angles from the normal, within a quarter turn, at which a lamp is seen between screens that stand before it.

    All screens must lie nearer than the lamp, and all of it before the point's horizon or behind.
    """
    a, b = _angles(point, normal, lamp)
    free = [(a, b)] if b > a else []
    for screen in screens:
        low, high = _angles(point, normal, screen)
        parts = [part for x, y in free for part in ((x, min(y, low)), (max(x, high), y))]
        free = [(x, y) for x, y in parts if y > x]
    return free


def emitter_irradiance(
    point: Point,
    normal: Point,
    lamp: tuple[Point, Point],
    emission: float = 1.0,
    screens: Iterable[tuple[Point, Point]] = (),
) -> float:
    """E = L_e (sin b - sin a), summed over the intervals in which a lamp of radiance L_e is seen.

    The lamp's front must face the point. A Lambert wall there sends on rho / 2 E.
    """
    return emission * sum(math.sin(b) - math.sin(a) for a, b in visible_intervals(point, normal, lamp, screens))


def crossed_strings(one: tuple[Point, Point], two: tuple[Point, Point]) -> float:
    """Hottel's form factor F_12 = (crossed - uncrossed) / (2 l_1) of two segments that see all of each other."""
    (a, b), (c, d) = one, two
    pairs = math.dist(a, c) + math.dist(b, d), math.dist(a, d) + math.dist(b, c)
    return abs(pairs[0] - pairs[1]) / (2 * math.dist(a, b))


def irradiance_between(one: tuple[Point, Point], two: tuple[Point, Point], emission: float = 1.0) -> float:
    """The mean irradiance 2 L_e F_12 on segment one from the emitter two, unobstructed."""
    return 2 * emission * crossed_strings(one, two)


def _angles(point: Point, normal: Point, pair: tuple[Point, Point]) -> tuple[float, float]:
    """The least and largest angle of a segment, cut off at the horizon."""
    size = math.hypot(*normal)
    n = normal[0] / size, normal[1] / size
    found = []
    for end, other in (pair, pair[::-1]):
        x, y = end[0] - point[0], end[1] - point[1]
        p, q = other[0] - point[0], other[1] - point[1]
        height, far = n[0] * x + n[1] * y, n[0] * p + n[1] * q
        if height <= 0 and far <= 0:
            return 0.0, 0.0
        if height < 0:  # the part of the segment over the horizon begins where its height is zero
            t = height / (height - far)
            x, y, height = x + t * (p - x), y + t * (q - y), 0.0
        # The tangent is the normal turned clockwise: the axis from which a front's angles grow.
        found.append(math.atan2(n[1] * x - n[0] * y, height))
    return min(found), max(found)


__all__ = ["crossed_strings", "emitter_irradiance", "furnace", "irradiance_between", "visible_intervals"]
