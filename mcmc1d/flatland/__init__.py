"""Light transport in the plane: real paths, real visibility, and an exact answer for every pixel.

A scene is made of segments (`scene`, `files`, `scenes`). Paths of k edges are a space (`Paths`) with a density, the
light that they carry (`Light`), and techniques that make them (`Bidirectional`): for chains, a target like any other.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from mcmc1d.flatland.bidirectional import Bidirectional, Joined
from mcmc1d.flatland.film import Exposure, Picture, independent, picture
from mcmc1d.flatland.paths import Light, Paths
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall

if TYPE_CHECKING:
    from mcmc1d.flatland import files, integrators, mutants, mutations, reference, scenes
else:
    # On first use, for they are most of flatland; see `mcmc1d` itself.
    def __getattr__(name):
        if name not in _MODULES:
            raise AttributeError(f"module 'mcmc1d.flatland' has no attribute {name!r}", name=name)
        return import_module(f"mcmc1d.flatland.{name}")


_MODULES = ("files", "integrators", "mutants", "mutations", "reference", "scenes")

__all__ = [
    "Bidirectional",
    "Exposure",
    "Joined",
    "Light",
    "Material",
    "Paths",
    "Picture",
    "Pinhole",
    "Scene",
    "Segment",
    "Wall",
    "files",
    "independent",
    "integrators",
    "mutants",
    "mutations",
    "picture",
    "reference",
    "scenes",
]
