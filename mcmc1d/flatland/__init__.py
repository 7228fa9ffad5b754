"""Light transport in the plane: real paths, real visibility, and an exact answer for every pixel.

A scene is made of segments (`scene`, `files`, `scenes`). Paths of k edges are a space (`Paths`) with a density, the
light that they carry (`Light`), and techniques that make them (`Bidirectional`): for chains, a target like any other.
"""

from mcmc1d.flatland.bidirectional import Bidirectional, Joined
from mcmc1d.flatland.film import Exposure, Picture, independent, picture
from mcmc1d.flatland.paths import Light, Paths
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall

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
    "independent",
    "picture",
]
