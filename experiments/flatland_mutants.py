"""Wrong integrators of flatland, on purpose, each beside the same without its mistake: what the exact image tells."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.framework import Claim, chosen
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.flatland import Bidirectional
from mcmc1d.flatland.integrators import integrate
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.mutants import mutants
from mcmc1d.flatland.reference import image


@dataclass(frozen=True)
class Config:
    """The experiment's numbers; mutants are names, or "all"."""

    mutants: str = "r_squared techniques_missing inverse_forgets_the_lamp"
    level: float = 1e-4
    """Family-wise: that any pixel of any right image fails."""
    trips: int = 1024
    """Round trips of a family of techniques."""
    contract: float = 1e-8
    """By how much a round trip may miss in float64."""


PROFILES = {"quick": Config(), "paper": Config(mutants="all")}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """By how much each mutant, and its right twin, are off, in units of what fails."""
    known = mutants()
    names = chosen(config.mutants, known)
    level = config.level / len(known)  # of all that there are, so that each is held alike whatever is beside it
    points = [(name, seed, level, config.trips, config.contract) for name in names]
    found = np.array(progress.map("mutants", excess, points)).reshape(-1, 2)
    return xr.Dataset(
        {
            "right": ("mutant", found[:, 0]),
            "wrong": ("mutant", found[:, 1]),
            "layer": ("mutant", [known[name].layer for name in names]),
            "mistake": ("mutant", [known[name].mistake for name in names]),
            "level": config.level,
            "contract": config.contract,
        },
        {"mutant": names},
    )


def excess(name: str, seed: int, level: float, trips: int, contract: float) -> tuple[float, float]:
    """Of the right twin and of the mutant: the worst pixel in radii of the test, or the worst round trip's error."""
    mutant = mutants()[name]
    if mutant.layer == "contract":
        return _missed(mutant.right, trips, seed) / contract, _missed(mutant.subject, trips, seed) / contract
    of = mutant.scene.with_pixels(4)
    known = image(of, max(mutant.lengths))
    at = [k - 1 for k in mutant.lengths]

    def worst(integrator: Any) -> float:
        found = integrate(jax.random.key(seed), integrator, of, lengths=mutant.lengths, samples=mutant.samples)
        return float(compare(found, known.values[at], known.errors[at], level).excess.max())

    return worst(mutant.right), worst(mutant.subject)


def _missed(family: Bidirectional, trips: int, seed: int) -> float:
    """By how much the inverses of the techniques miss the numbers that they should lead back to, in float64."""
    index = jnp.asarray(np.arange(trips) % len(family.members), jnp.int32)
    with jax.enable_x64(True):
        u = jnp.asarray(np.random.default_rng(seed).random((trips, family.dim_u)))
        back = jax.jit(jax.vmap(lambda i, u: family.inverse(i, *family.forward(i, u)[:2])[0]))(index, u)
        return float(np.abs(back - u).max())


def draw(data: xr.Dataset) -> Figure:
    """A row each: the right twin and the mutant, in units of what fails."""
    figure, axes = plt.subplots(figsize=(3.5, 0.6 + 0.17 * data.sizes["mutant"]))
    rows, least = np.arange(data.sizes["mutant"])[::-1], 1e-3
    # A right image may agree to within the exact one's own error.
    axes.plot(np.maximum(data.right, least), rows, "o", color="C0", markersize=3.5, label="right twin")
    axes.plot(np.maximum(data.wrong, least), rows, "X", color="C1", markersize=4, label="mutant")
    axes.axvline(1, color="black", linewidth=0.7, linestyle="--")
    axes.set_xscale("log")
    axes.set_xlabel("worst pixel, or round trip, in units of what fails")
    axes.set_yticks(rows, [str(name).replace("_", " ") for name in data.mutant.to_numpy()], fontsize=6)
    axes.tick_params(axis="y", which="both", length=0)
    axes.grid(axis="y", linewidth=0.3)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def table(data: xr.Dataset) -> Table:
    """The same numbers, and what each mistake is."""
    result = Table("mutant", "right twin", "mutant", "mistake", title="flatland_mutants", box=SIMPLE)
    for k, name in enumerate(data.mutant.to_numpy()):
        right, wrong = (f"{float(data[part][k]):.3g}" for part in ("right", "wrong"))
        result.add_row(str(name), right, wrong, str(data.mistake[k].item()))
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Each mutant is caught, and its right twin passes."""
    right, wrong = data.right.to_numpy(), data.wrong.to_numpy()
    told = (right <= 1) & (wrong > 1)
    missed = ", ".join(str(name) for name in data.mutant.to_numpy()[~told])
    trips = int((data.layer == "contract").sum())
    return [
        Claim(
            "flatland.mutants",
            f"Each of {told.size} wrong integrators is caught, and is right without its mistake",
            "ours; origins in mcmc1d.flatland.mutants",
            verdict(bool(told.all())),
            "holds",
            f"{told.sum()} of {told.size}{f', not {missed}' * bool(missed)}: right ones at {right.max():.2f} of what "
            f"fails at most, wrong ones at {wrong.min():.1f} at least",
            f"{told.size - trips} by the exact image, family-wise {float(data.level):g}, Bernstein; {trips} by round "
            f"trips, {float(data.contract):g}",
        )
    ]
