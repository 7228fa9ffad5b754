"""Gaussian, uniform and linear perturbations for `mtm_lambda`: each at several sizes, by the operator."""

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.verdict import verdict
from mcmc1d.moves import LinearStep, Move, SmallStep, UniformStep
from mcmc1d.types import Key
from mcmc1d.verify import Operator, transition_operator

SIZES = (0.06, 0.12, 0.18, 0.25)
"""Standard deviations."""
SHAPES: dict[str, Callable[[float], Move]] = {
    "Gaussian": SmallStep,
    "uniform": lambda sigma: UniformStep(sigma * np.sqrt(12)),
    "linear": lambda sigma: LinearStep(sigma * np.sqrt(24)),
}


def measure(
    key: Key,
    target: mcmc1d.Multiplexed,
    bins: int,
    cells: int,
    points: int,
    chains: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """The data of each perturbation at each size, for a dataset: its autocorrelation, and its acceptance at the best.

    The autocorrelation time is the mean over the bins of their indicators' integrated autocorrelation times, each
    counted by its variance; its root is the error at equal work, independent samples' being 1.
    """
    time = np.zeros((len(SHAPES), len(SIZES)))
    for i, j in np.ndindex(time.shape):
        move = list(SHAPES.values())[i](SIZES[j])
        operator = transition_operator(move, target, u_cells=cells, x_cells=1, points=points)
        time[i, j] = _time(operator, bins)
        progress(i * len(SIZES) + j + 1, time.size)
    acceptance = []
    for make, times in zip(SHAPES.values(), time, strict=True):
        best, estimators = make(SIZES[int(times.argmin())]), {"acceptance": mcmc1d.Acceptance()}
        found = mcmc1d.run(key, best, target, steps=1, chains=chains, blocks=1, estimators=estimators)
        acceptance += found.acceptance().values()
    return {"rate": ("shape", acceptance), "time": (("shape", "sd"), time), "error": (("shape", "sd"), np.sqrt(time))}


def _time(operator: Operator, bins: int) -> float:
    """The sum of the bins' asymptotic variances over that of their variances, from the fundamental matrix."""
    p, mu = operator.matrix.toarray(), operator.stationary()
    inside = np.repeat(np.eye(bins), len(mu) // bins, axis=0)
    g = inside - mu @ inside
    variance = float(mu @ (g * g).sum(1))
    z = np.linalg.solve(np.eye(len(mu)) - p + mu, g)
    return 2 * float(mu @ (g * z).sum(1)) / variance - 1


def draw(data: xr.Dataset, axis: Any) -> None:
    """The error of each perturbation against its size."""
    for k, shape in enumerate(data.shape.to_numpy()):
        # One over the other, and to be seen all the same: they hardly differ, which is the finding.
        style = {"color": f"C{k}", "linestyle": ("-", "--", ":")[k], "linewidth": (2.2, 1.4, 1.2)[k]}
        style |= {"marker": "os^"[k], "markersize": (6, 4, 2.5)[k]}
        axis.plot(data.sd, data.error.sel(shape=shape), label=str(shape), **style)
    axis.set(xlabel="standard deviation of the step", ylabel="error at equal work", yscale="log")
    axis.set_yticks([1.5, 2, 3, 4, 5], ["1.5", "2", "3", "4", "5"])
    axis.minorticks_off()
    axis.set_title("independent samples: 1", fontsize=6)
    axis.legend(fontsize=5.5)


def table(data: xr.Dataset) -> Table:
    """Each perturbation at its best size."""
    result = Table("perturbation", "best size", "acceptance", "autocorrelation time", "error", box=SIMPLE)
    result.title = "mtm_lambda: perturbations, each at its best size; error of a histogram at equal work"
    for shape in data.shape.to_numpy():
        here = data.sel(shape=shape)
        best = here.isel(sd=int(here.error.to_numpy().argmin()))
        result.add_row(str(shape), *(f"{float(best[name]):.3g}" for name in ("sd", "rate", "time", "error")))
    return result


def claim(data: xr.Dataset) -> Claim:
    """Whether Gaussian ones are better than both others by what could be seen."""
    best = {str(shape): float(data.error.sel(shape=shape).min()) for shape in data.shape.to_numpy()}
    return Claim(
        "mtm.shapes",
        "With one candidate, Gaussian perturbations are more effective than uniform and linear ones",
        "ours; Segovia et al. 2007, sec. 6.1, which speaks of many",
        verdict(best["Gaussian"] < 0.98 * min(best["uniform"], best["linear"])),
        "fails",
        "error of a histogram at equal work: " + "; ".join(f"{name} {error:.3f}" for name, error in best.items()),
        "operator, at 2 % of a difference; sizes up to 0.25, on which all three are about alike",
    )
