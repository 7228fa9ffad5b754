"""Three maps of one domain for `planar`: small steps through each have one law, and mix at a rate of their own."""

from collections.abc import Callable
from typing import Any

import emcee
import jax
import numpy as np
import xarray as xr
from scipy.stats import sem

import mcmc1d
from experiments.support.beside import both_cores
from experiments.support.framework import Claim
from mcmc1d.moves import SmallStep
from mcmc1d.targets import Ring, Target
from mcmc1d.targets.planar import two_ridges
from mcmc1d.techniques import ConcentricDisk, PolarDisk, Rectangle, Technique
from mcmc1d.types import Key
from mcmc1d.verify.goodness import expected_distance, total_variation

MAPS: dict[str, Technique] = {
    # A disk around the unit square, so that each of the three makes all of it.
    "polar": PolarDisk((0.5, 0.5), 0.7072),
    "concentric": ConcentricDisk((0.5, 0.5), 0.7072),
    "uniform": Rectangle(),
}
WALKED: dict[str, Target] = {"ring": Ring(), "ridges": two_ridges()}
_GROUPS = 32
"""Of chains, whose spread is the error of what all of them say."""


def measure(key: Key, sigma: float, steps: int, chains: int, progress: Callable[[int, int], None]) -> dict[str, Any]:
    """The data of small steps of this sigma through each map, for a dataset.

    Autocorrelation times and their errors; the total variation of each histogram, and that which chance makes.
    """
    edges = np.linspace(0, 1, 9)
    exact = {name: target.bin_masses((edges, edges)) for name, target in WALKED.items()}

    def walk(k: int) -> tuple[np.ndarray, np.ndarray, float, float]:
        walked, chart = list(WALKED)[k // len(MAPS)], list(MAPS)[k % len(MAPS)]
        target = mcmc1d.Multiplexed(WALKED[walked], MAPS[chart])
        found = mcmc1d.trace(jax.random.fold_in(key, 100 + k), SmallStep(sigma), target, steps=steps, chains=chains)
        parts = np.split(found.x, _GROUPS, axis=1)
        times = [emcee.autocorr.integrated_time(part, tol=0) for part in parts]
        counts = [np.histogramdd(part.reshape(-1, 2), [edges, edges])[0] for part in parts]
        shares, law = np.array(counts) / np.sum(counts[0]), exact[walked] / exact[walked].sum()
        return (
            np.mean(times, axis=0),
            sem(times),
            total_variation(shares.mean(0), law),
            expected_distance(sem(shares)),
        )

    found = both_cores(walk, range(len(WALKED) * len(MAPS)), progress)
    where, shape = ("walked", "chart"), (len(WALKED), len(MAPS))
    times, spread, distance, chance = (np.array(part) for part in zip(*found, strict=True))
    return {
        "time": ((*where, "coordinate"), times.reshape(*shape, 2)),
        "time_error": ((*where, "coordinate"), spread.reshape(*shape, 2)),
        "map_distance": (where, distance.reshape(shape)),
        "map_chance": (where, chance.reshape(shape)),
    }


def claims(data: xr.Dataset) -> list[Claim]:
    """The maps have one law, and the times of two of them differ."""
    ratio = float((data.map_distance / data.map_chance).max())
    found = [
        Claim(
            "planar.maps-law",
            "Polar, concentric and uniform maps of one domain give small steps one law",
            "Shirley and Chiu 1997; ours",
            "holds" if ratio < 5 else "fails",
            "holds",
            f"TV from the exact law {float(data.map_distance.max()):.4f} at most, {ratio:.2f} times what chance makes",
            "5 times what chance makes on average, 64 cells: 4e-4 of the runs, if one number moves all of them",
        )
    ]
    for walked in data.walked.to_numpy():
        here = data.sel(walked=walked)
        slow = [int(np.argmax(here.sel(chart=name).time.to_numpy())) for name in ("polar", "concentric")]
        times = [float(here.time.sel(chart=name)[k]) for name, k in zip(("polar", "concentric"), slow, strict=True)]
        errors = [
            float(here.time_error.sel(chart=name)[k]) for name, k in zip(("polar", "concentric"), slow, strict=True)
        ]
        apart = abs(times[0] - times[1]) / np.hypot(errors[0], errors[1])
        uniform = float(here.time.sel(chart="uniform").max())
        found.append(
            Claim(
                f"planar.maps-time-{walked}",
                f"The map decides how fast small steps in u mix ({walked})",
                "ours; Shirley and Chiu 1997",
                "holds" if apart > 6 else "fails",
                "holds",
                f"autocorrelation time, slower coordinate: polar {times[0]:.1f} ± {errors[0]:.1f}, concentric "
                f"{times[1]:.1f} ± {errors[1]:.1f}, uniform {uniform:.1f}",
                "6 standard errors between polar and concentric (32 groups)",
            )
        )
    return found
