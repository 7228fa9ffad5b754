"""Images that are taken again, longer, until they are sharp enough to find an error that is asked for."""

import jax
import numpy as np

from mcmc1d.flatland import Scene
from mcmc1d.flatland.integrators import Image, Integrator, integrate
from mcmc1d.flatland.integrators.compare import Comparison, compare
from mcmc1d.types import Key

LOOKS = 4
"""Images at most. Which is the last depends on its own spread, so that each has a share of the level."""


def sharp(
    key: Key,
    make: Integrator,
    of: Scene,
    lengths: int,
    samples: int,
    goal: float,
    work: float,
    exact: tuple[np.ndarray, np.ndarray],
    level: float,
) -> tuple[Image, Comparison, int]:
    """An image, how it compares, and its samples of each length: the first of `samples`, the last as long as it takes.

    No image takes more than `work`, rays times segments. `exact`: values and errors; `level`: that a right image fails.
    """
    margin = 1.3 if hasattr(make, "chains") else 1.15
    sharper, before = 2.0, (0, 0.0)  # how much sharper four times the samples are, until a second look tells
    for look in range(LOOKS):
        found = integrate(jax.random.fold_in(key, look), make, of, lengths=lengths, samples=samples)
        result = compare(found, *exact, level / LOOKS)
        error, most = float(result.detectable[-1].max()), work * samples / (found.rays * len(of.segments))
        # What has no bound, or has had all the work there is, gets no sharper.
        if error <= goal or not np.isfinite(error) or samples > 0.8 * most or look == LOOKS - 1:
            return found, result, samples
        if look > 0:  # the error of short chains falls more slowly than samples grow
            sharper = np.clip((before[1] / error) ** (np.log(4) / np.log(samples / before[0])), 1.5, 2.0)
        before = samples, error
        growth = margin * 4 ** (np.log(error / goal) / np.log(sharper))
        samples = int(min(samples * min(growth, 64), most))
    raise AssertionError("a look is the last")
