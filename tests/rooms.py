"""Rooms of flatland that several tests look at."""

import itertools

from mcmc1d.flatland.reference import Resolution
from mcmc1d.flatland.scene import Material, Pinhole, Segment

# A coarse one, where the truth is constant or the comparison is with something no better.
COARSE = Resolution(order=4, points=8, corner=0.2, smallest=1e-2, grading=2.0)
LAMP, WHITE, GREY, BLACK = Material(emission=1.0), Material(lambert=0.7), Material(lambert=0.5), Material()
SQUARE = [(0, 0), (1.3, 0), (1.3, 1), (0, 1)]
L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
TRIANGLE = [(0, 0), (1.7, 0), (0.4, 1.1)]
# Clockwise: its fronts look outwards.
BAR = [(0.7, 0.6), (0.7, 0.65), (1.0, 0.8), (1.0, 0.75)]
EYE = Pinhole((0.35, 0.4), (1, 0.2), 0.6, 4)


def ring(points, material, name="w"):
    ends = itertools.pairwise([*points, points[0]])
    return [Segment(a, b, material, f"{name}{k}") for k, (a, b) in enumerate(ends)]


def box(right=GREY, lamp=LAMP, extra=()):
    """A room of 2 by 1.5, with a lamp in its ceiling."""
    return (
        Segment((0, 0), (2, 0), WHITE, "floor"),
        Segment((2, 0), (2, 1.5), right, "right"),
        Segment((2, 1.5), (1.2, 1.5), WHITE),
        Segment((1.2, 1.5), (0.8, 1.5), lamp, "lamp"),
        Segment((0.8, 1.5), (0, 1.5), WHITE),
        Segment((0, 1.5), (0, 0), GREY, "left"),
        *extra,
    )
