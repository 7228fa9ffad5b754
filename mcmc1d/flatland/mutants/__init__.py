"""Wrong integrators, on purpose: mistakes of released renderers, each a few lines from the right thing.

Nothing here is for use. `mutants()` collects the `MUTANTS` of this folder's files. Each says where it comes from and
what must catch it: the exact image ("image": `integrators.compare`), or the techniques' round trip ("contract").
"""

import importlib
import pkgutil
from dataclasses import dataclass, field
from typing import Any

from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment
from mcmc1d.flatland.scenes import scene

LAYERS = ("contract", "image")


@dataclass(frozen=True)
class Mutant:
    """A wrong integrator, or a family of techniques."""

    subject: Any
    right: Any
    """The same without the mistake, which passes."""
    mistake: str
    origin: str
    """The paper or the released software in which it was made."""
    layer: str = "image"
    """One of `LAYERS`, which must catch it."""
    scene: Scene = field(default_factory=lambda: scene("box"))
    lengths: tuple[int, ...] = (2,)
    samples: int = 2**17


def two_lamps() -> Scene:
    """A room with a mirror, and lamps of two lengths and strengths: a mistake in their choice shows."""
    grey = Material(lambert=0.7)
    points = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (3.5, 3.0), (2.5, 3.0), (1.0, 3.0), (0.7, 3.0), (0.0, 3.0)]
    each = [grey, grey, grey, Material(2, lambert=0.3), grey, Material(6, lambert=0.3), grey, Material(mirror=0.8)]
    sides = [
        Segment(start, end, material)
        for start, end, material in zip(points, points[1:] + points[:1], each, strict=True)
    ]
    return Scene("two_lamps", tuple(sides), Pinhole((2.0, 1.0), (-1.0, 0.3), 1.1, 4))


def mutants() -> dict[str, Mutant]:
    """Every mutant by name."""
    found: dict[str, Mutant] = {}
    for module in pkgutil.iter_modules(__path__):
        found |= getattr(importlib.import_module(f"{__name__}.{module.name}"), "MUTANTS", {})
    return found


__all__ = ["LAYERS", "Mutant", "mutants", "two_lamps"]
