"""Images of table 1's algorithms against the exact one, in absolute scale, and twins of them that are not right."""

import numpy as np
import xarray as xr

from experiments.support.framework import Claim
from experiments.support.verdict import verdict
from mcmc1d.flatland.integrators import Image
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.integrators.image import Layer, Stacked

FACTORS = (1.0, 0.5, 2.0)
"""By which an image is multiplied: all but the first are twins that must fail."""
LEVEL = 1e-5
"""That any pixel of any right image fails, of all scenes and algorithms together."""
GOAL = 0.1
"""The error of a pixel that must be found if an image is to be called right, of the pixel or of the mean if larger."""


def held(layer: Layer | Stacked | None, values: np.ndarray, errors: np.ndarray, level: float) -> dict[str, list[float]]:
    """The worst pixel's excess of the image and its twins, and the error that is found in it; see `compare`.

    Of no image nothing is known, and no error would be found.
    """
    if layer is None:
        return {"excess": [np.nan] * len(FACTORS), "detectable": [np.inf] * len(FACTORS)}
    found = [compare(Image([layer.scaled(factor)]), values[None], errors[None], level) for factor in FACTORS]
    return {
        "excess": [float(one.excess.max()) for one in found],
        "detectable": [float(one.detectable.max()) for one in found],
    }


def right(excess: np.ndarray, detectable: np.ndarray) -> bool | None:
    """Whether images agree, (algorithms, factors); None where one could be wrong and not be found to be, as its twins.

    `detectable`: of the images themselves, (algorithms,).
    """
    if np.any(excess[:, 0] > 1):
        return False
    return True if np.all(detectable <= GOAL) and np.all(excess[:, 1:] > 1) else None


def exact_claim(data: xr.Dataset, source: str) -> Claim:
    """That all algorithms make the exact image, as far as bounds can tell."""
    true, listed = [], []
    for scene in data.scene.to_numpy():
        here = data.sel(scene=scene)
        excess = here.excess.sel(factor=list(FACTORS)).transpose("algorithm", "factor").to_numpy()
        detectable = here.detectable.to_numpy()
        true.append(right(excess, detectable))
        each = zip(here.algorithm.to_numpy(), excess, detectable, strict=True)
        listed.append(f"{scene}: " + ", ".join(_one(m, e[0], d) for m, e, d in each))
    twins = data.excess.sel(factor=list(FACTORS[1:])).to_numpy()
    twins = twins[np.isfinite(twins)]
    return Claim(
        "plane.stages-exact",
        "Images by all six algorithms of table 1 agree with the exact image in every pixel, in absolute scale",
        f"{source}, Alg. 1 and 2; ours, flatland",
        verdict(*true),
        "holds",
        f"the worst pixel in radii of the test, and the error that would be found in any: {'; '.join(listed)}; of "
        f"{twins.size} twins, half or twice as bright, {int((twins > 1).sum())} are found",
        f"Bernstein's inequality, family-wise {LEVEL:g}; path and ERPT: all runs as one image, the others: in the "
        f"paper profile, images of {int(data.held_chains)} chains, b apart; open unless errors of {GOAL:.0%} and all "
        "twins are found",
    )


def _one(method: str, excess: float, detectable: float) -> str:
    return f"{method} {excess:.2f} (finds {detectable:.0%})" if np.isfinite(detectable) else f"{method} not held"


__all__ = ["FACTORS", "LEVEL", "exact_claim", "held", "right"]
