"""The methods of Hoberock and Hart 2010, table 1, on the line and the square."""

from experiments.support.scenes import walk
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import Move
from mcmc1d.perception import EXPOSURE
from mcmc1d.redistribution import energy_redistribution, independent
from mcmc1d.rendering import Rendered, Renderer, Scene
from mcmc1d.stages import MultiStage, NoiseAware, Stage, plan
from mcmc1d.types import Key

PAPER = "Hoberock and Hart 2010"
METHODS = ("path", "MLT", "ERPT", "two-stage", "multi-stage", "noise-aware")
"""The paper's 2MLT, MMLT and NAMLT are spelled out: MMLT is multiplexed Metropolis light transport elsewhere."""
BRIGHT, DARK = EXPOSURE, 1e-5
"""The mean of the image in cd/m^2: as a display shows it, where Weber's law is near, and in the dark, where the
threshold is constant and a visual error is an absolute one."""


def render(
    scene: Scene, method: str, samples: int, replicas: int, key: Key, kernel: Kernel | Move | None = None
) -> Rendered:
    """One of the methods at the same work, by the square's own walk unless a kernel is given.

    b is exact, so that only the samples differ.
    """
    kernel = walk() if kernel is None else kernel
    renderer, adapt = Renderer(scene, kernel, replicas, 4), MultiStage(scene.pixels)
    side = scene.pixels.side
    if method == "path":
        return independent(key, scene, samples, replicas)
    if method == "MLT":
        return renderer.plain(key, samples)
    if method == "ERPT":
        return energy_redistribution(key, scene, kernel, samples, replicas)
    if method == "two-stage":
        # A sixteenth of the work for a test image of a quarter of the resolution; the paper has 1e6 of 50 to 500
        # million rays for it, and leaves the resolution open.
        return renderer.two_stage(key, Stage(side // 4, samples // 16), samples - samples // 16, adapt)[1]
    exposure = BRIGHT / scene.exact().mean()
    return renderer.render(key, plan(side, samples), adapt if method == "multi-stage" else NoiseAware(adapt, exposure))
