"""Errors of flatland's integrators at equal rays, and whose is lower, with intervals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import sem
from scipy.stats import t as student

from experiments.support.flatland_rivals import CHAINS
from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, Ratio, shown, under
from experiments.support.verdict import among

WHOLE = "image"
"""The part that is all pixels."""


def critical(data: xr.Dataset, tests: int) -> float:
    """In how many standard errors of so many runs one of several deviations is refuted: 1e-4 of all, by Student's t."""
    return float(student.isf(DECIDES / (2 * tests), int(data.runs) - 1))


def squared(here: xr.Dataset, part: str = WHOLE, *, b_known: bool = False) -> tuple[np.ndarray, xr.DataArray]:
    """Of one scene the rays, and the squared error of the image of all lengths over its mean: (budgets,) of all.

    Of each run, or batch of independent samples: (integrator, budget, run). Unless b is known, a chain spends a share
    of all rays on independent samples of it, whose relative variance adds; independent integrators have all rays.
    """
    member = here.member.sel(part=part)
    mse, rays = here.mse.sel(part=part), here.rays
    if not b_known:
        share, chain = float(here.spent_on_b), here.integrator.isin(CHAINS)
        of_b = here.b_cost * (1 - share) / (share * rays)
        mse = xr.where(chain, mse + of_b * (here.reference**2).where(member).mean("pixel"), (1 - share) * mse)
        rays = rays / (1 - share)
    mean = here.reference.sum("edges").where(member).mean("pixel")
    # Errors of the lengths are independent, and without bias.
    total = mse.sum("edges") / mean**2
    return rays.sum("edges").to_numpy(), total.transpose("integrator", "budget", "run")


def root(each: np.ndarray, miss: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The root of the mean over the last axis, and its interval: of the logarithm, which errs by sem / mean."""
    middle = each.mean(-1)
    width = student.isf(miss / 2, each.shape[-1] - 1) * sem(each, axis=-1) / middle
    return np.sqrt(middle), np.sqrt(middle * np.exp(-width)), np.sqrt(middle * np.exp(width))


def mean_ratio(above: np.ndarray, below: np.ndarray, miss: float = 0.05) -> Ratio:
    """The ratio of the roots of two mean squares, and its interval by Welch's t on their logarithms."""
    parts = [(sem(each) / each.mean()) ** 2 for each in (above, below)]
    freedom = sum(parts) ** 2 / sum(p**2 / (each.size - 1) for p, each in zip(parts, (above, below), strict=True))
    width = student.isf(miss / 2, freedom) * sum(parts) ** 0.5 / 2
    middle = np.log(above.mean() / below.mean()) / 2
    return float(np.exp(middle)), float(np.exp(middle - width)), float(np.exp(middle + width))


def log_ratio(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """The log of the ratio of the roots of two mean squares over the same runs, and its standard error."""
    each = above / above.mean() - below / below.mean()
    return float(np.log(above.mean() / below.mean())) / 2, float(sem(each)) / 2


class Rivalry(NamedTuple):
    """Who is said to have the lower error at equal rays, than whom and where."""

    id: str
    statement: str
    source: str
    expected: str
    lower: str
    higher: Sequence[str]
    scenes: Sequence[str]
    """Of which it is said."""
    b_known: bool
    part: str = WHOLE
    note: str = ""
    """What the number is followed by."""


def judged(rivalries: Sequence[Rivalry], data: xr.Dataset) -> list[Claim]:
    """Each rivalry whose scenes are there, decided at 1e-4 for all of them together."""
    names = [str(name) for name in data.scene.to_numpy()]
    present = [(one, [name for name in names if name in one.scenes]) for one in rivalries]
    comparisons = sum(len(one.higher) * len(where) for one, where in present)
    return [_judged(one, data, where, names, DECIDES / comparisons) for one, where in present if where]


def _judged(one: Rivalry, data: xr.Dataset, where: list[str], names: list[str], miss: float) -> Claim:
    def ratios(name: str, miss: float = 0.05) -> dict[str, Ratio]:
        all_of = squared(data.sel(scene=name), one.part, b_known=one.b_known)[1]
        last = {who: all_of.sel(integrator=who).isel(budget=-1).to_numpy() for who in (one.lower, *one.higher)}
        return {rival: mean_ratio(last[one.lower], last[rival], miss) for rival in one.higher}

    deciding = {name: list(ratios(name, miss).values()) for name in where}
    blind = max(high / middle for found in deciding.values() for middle, _, high in found)
    beside = [name for name in names if name not in where and one.part == WHOLE]
    words = [
        f"{name}{' (beside)' if name in beside else ''}: "
        + ", ".join(f"{one.lower} / {rival} {shown(found)}" for rival, found in ratios(name).items())
        for name in (*where, *beside)
    ]
    return Claim(
        one.id,
        one.statement + ", b known" * one.b_known,
        one.source,
        among({name: under(1.0, *found) for name, found in deciding.items()}),
        one.expected,
        "RMS error, " + "; ".join(words) + one.note,
        f"t interval, shown of 95 %, deciding at {DECIDES:g} of all comparisons, either way; {int(data.runs)} runs; "
        f"sees a ratio under {1 / blind:.2f} or over {blind:.2f}",
    )


__all__ = ["WHOLE", "Rivalry", "critical", "judged", "log_ratio", "mean_ratio", "root", "squared"]
