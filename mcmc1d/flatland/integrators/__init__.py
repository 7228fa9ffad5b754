"""Integrators of flatland: the image of a scene, by path length and pixel, in absolute scale, with its rays counted."""

from collections.abc import Sequence

import jax
import numpy as np

from mcmc1d.checks import require, require_instance, require_key, require_whole
from mcmc1d.flatland.integrators.base import Integrator
from mcmc1d.flatland.integrators.chains import MMLT, PSSMLT, RJMLT
from mcmc1d.flatland.integrators.coherent import CoherentMLT
from mcmc1d.flatland.integrators.exchange import ReplicaExchange
from mcmc1d.flatland.integrators.image import Image, Layer, Stacked
from mcmc1d.flatland.integrators.independent import BidirectionalPathTracing, LightTracing, PathTracing
from mcmc1d.flatland.integrators.instant import InstantRadiosity
from mcmc1d.flatland.integrators.photons import PhotonDensity
from mcmc1d.flatland.integrators.redistribution import EnergyRedistribution
from mcmc1d.flatland.integrators.staged import StagedMLT
from mcmc1d.flatland.integrators.veach import MLT
from mcmc1d.flatland.sampling import Sums
from mcmc1d.flatland.scene import Scene, require_scene
from mcmc1d.flatland.schema import nearest
from mcmc1d.types import Key
from mcmc1d.weights import Maximum, Power

INTEGRATORS: dict[str, Integrator] = {
    "pt": PathTracing(),
    "lt": LightTracing(),
    "bdpt": BidirectionalPathTracing(),
    "bdpt_power": BidirectionalPathTracing(Power()),
    "bdpt_maximum": BidirectionalPathTracing(Maximum()),
    "pssmlt_sum": PSSMLT(),
    "pssmlt_max": PSSMLT(combine="maximum"),
    "mlt": MLT(),
    "mmlt": MMLT(),
    "rjmlt": RJMLT(),
    "rjmlt_aimed": RJMLT(aimed=True),
}
"""By the name that tables use."""

FURTHER: dict[str, Integrator] = {
    "ir": InstantRadiosity(),
    "ir_clamped": InstantRadiosity(clamp=1.0),
    "photons": PhotonDensity(),
    "cmlt": CoherentMLT(),
    "cmlt_published": CoherentMLT(deposit="published"),
    "erpt": EnergyRedistribution(),
    "rex": ReplicaExchange(),
    "two_stage": StagedMLT("two_stage"),
    "multi_stage": StagedMLT("multi_stage"),
    "noise_aware": StagedMLT("noise_aware"),
}
"""Others, by name: of the papers under test, and those whose light is biased, or without a bound."""

BIASED = frozenset({"cmlt_published", "ir_clamped", "photons"})
"""Those of `FURTHER` that miss the exact image, by an amount that their class states."""


def integrate(
    key: Key,
    integrator: Integrator | str,
    scene: Scene,
    *,
    lengths: int | Sequence[int] = 6,
    samples: int = 2**18,
    pixels: int | None = None,
) -> Image:
    """Render a scene.

    Arguments: `integrator`, or its name in `INTEGRATORS` or `FURTHER`; `lengths`, the numbers of edges, or the largest
    of them; `samples`, of each length: paths, or mutations of all chains together (rounded to what runs at once);
    `pixels`, the scene's own unless given.

    Raises `ValueError` where there is no integrator of that name, where it can not make some of the scene's light, and
    where none of its paths of any length brought light to the sensor. (Of one length that is a dark image: the light
    of the room behind the door has two edges at least.)
    """
    if isinstance(integrator, str):
        known = INTEGRATORS | FURTHER
        require(integrator in known, f"there is no integrator {integrator!r}; {nearest(integrator, known)}")
        integrator = known[integrator]
    require_instance(integrator, Integrator, "integrate: the integrator", ", nor a name of one")
    require_scene(scene, "integrate: the scene")
    several = np.iterable(lengths)
    given = tuple(lengths) if several else (lengths,)
    for k in given:
        require_whole(k, "integrate: lengths: a number of edges")
    each = given if several else range(1, lengths + 1)
    distinct = len(set(each)) == len(each) > 0
    require(distinct, f"integrate: lengths are different numbers of edges, one at least, not {lengths}")
    require_key(key, "integrate")
    require_whole(samples, "integrate: samples", 2)
    scene = scene if pixels is None else scene.with_pixels(pixels)
    for k in each:
        integrator.check(scene, k)
    image = Image([integrator.render(jax.random.fold_in(key, k), scene, k, samples) for k in each])
    require(
        bool(image.total.sum() > 0),
        f"integrate: scene {scene.name}: no path of {', '.join(map(str, each))} edges brought light to the sensor, in "
        f"{image.rays:.2g} rays; let a lamp face what the sensor sees, allow more edges, or take more samples",
    )
    return image


__all__ = [
    "BIASED",
    "FURTHER",
    "INTEGRATORS",
    "MLT",
    "MMLT",
    "PSSMLT",
    "RJMLT",
    "BidirectionalPathTracing",
    "CoherentMLT",
    "EnergyRedistribution",
    "Image",
    "InstantRadiosity",
    "Integrator",
    "Layer",
    "LightTracing",
    "PathTracing",
    "PhotonDensity",
    "ReplicaExchange",
    "Stacked",
    "StagedMLT",
    "Sums",
    "integrate",
]
