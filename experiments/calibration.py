"""Are the p-values honest? Thousands of verifications of a right kernel, and false alarms at an exaggerated level."""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import binom

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from mcmc1d.verify import JaxKernel, LawError, Verdict, laws, verify
from mcmc1d.verify.mutants.memory import depositing


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    runs: int = 300
    """Verifications of a right kernel at the default level, for their first-stage p-values."""
    replicas: int = 512
    alarms: int = 300
    """Verifications at the exaggerated level."""
    level: float = 0.05
    confidence: float = 0.999
    """Of the binomial intervals."""


PROFILES = {"quick": Config(), "paper": Config(runs=10_000, alarms=4000)}

LAYERS = ("marginal", "exchangeability", "deposits")


def kernel() -> JaxKernel:
    """A walk at two walls with expected-value deposits, declared reversible: all of it right."""
    return depositing(laws.walls())


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """First-stage p-values, combined and by layer; and verdicts of the whole scheme at the exaggerated level."""
    law, right = laws.walls(), kernel()
    common = {"replicas": config.replicas, "reversible": True, "ergodic": False, "steps": (1, 16)}
    first = np.ones(config.runs)
    layers = np.ones((config.runs, len(LAYERS)))
    for k in range(config.runs):
        report = verify(right, law, seed=seed * 1_000_000 + k, **common)
        first[k] = report.p_value
        for column, layer in enumerate(LAYERS):
            # One test of each kind, after one step: the smallest of several would not be uniform.
            layers[k, column] = report.first_stage[f"{layer}: x after 1"]
        progress("p-values", k + 1, config.runs)
    alarms = stages = 0
    for k in range(config.alarms):
        try:
            report = verify(right, law, seed=seed * 1_000_000 + 500_000 + k, level=config.level, **common)
            alarms += report.verdict is Verdict.FAIL
            stages += report.stages > 1
        except LawError:  # an alarm about the law's own draws
            alarms += 1
        progress("false alarms", k + 1, config.alarms)
    return xr.Dataset(
        {
            "p_value": ("run", first),
            "layer_p_value": (("run", "layer"), layers),
            "alarms": alarms,
            "further_stages": stages / config.alarms,
            "runs_at_level": config.alarms,
            "level": config.level,
            "confidence": config.confidence,
            "replicas": config.replicas,
        },
        {"layer": list(LAYERS)},
    )


def _excess(values: np.ndarray) -> float:
    """The smallest binomial p-value, over thresholds, that so many p-values lie at or under one; times their number."""
    thresholds = 10.0 ** -np.arange(0.25, 4.01, 0.25)
    counts = np.array([(values <= t).sum() for t in thresholds])
    return float(min(1.0, binom.sf(counts - 1, len(values), thresholds).min() * len(thresholds)))


def draw(data: xr.Dataset) -> Figure:
    """The distribution functions of the p-values, which must stay under the diagonal."""
    figure, axes = plt.subplots(figsize=(3.4, 2.6))
    n = data.sizes["run"]
    rank = np.arange(1, n + 1) / n
    t = np.logspace(-4, 0, 60)
    upper = binom.ppf(float(data.confidence), n, t) / n
    axes.fill_between(t, np.maximum(t, 0.3 / n), np.maximum(upper, 0.3 / n), color="0.9", label="allowed by chance")
    axes.plot(t, t, color="0.5", linewidth=0.7)
    for layer, colour in zip(data.layer.to_numpy(), ("C0", "C2", "C4"), strict=False):
        values = np.sort(data.layer_p_value.sel(layer=layer).to_numpy())
        axes.step(values, rank, where="post", color=colour, linewidth=0.9, label=f"{layer}, one test")
    axes.step(np.sort(data.p_value.to_numpy()), rank, where="post", color="black", linewidth=1.2, label="first stage")
    level, runs = float(data.level), int(data.runs_at_level)
    rate = int(data.alarms) / runs
    axes.plot([level], [max(rate, 0.5 / runs)], "v", color="C1", markersize=5, label=f"false alarms at {level:g}")
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(1e-4, 1),
        ylim=(0.5 / n, 1.2),
        xlabel="p",
        ylabel="share of runs at or under p",
    )
    axes.legend(loc="upper left", fontsize=5.5)
    return figure


def table(data: xr.Dataset) -> Table:
    """How often p was at most so much."""
    result = Table("p at most", "first stage", *data.layer.to_numpy(), title="calibration", box=SIMPLE, padding=0)
    for threshold in (0.5, 0.1, 0.05, 0.01, 0.001):
        shares = [float((data.layer_p_value.sel(layer=layer) <= threshold).mean()) for layer in data.layer]
        first = float((data.p_value <= threshold).mean())
        result.add_row(f"{threshold:g}", f"{first:.4f}", *(f"{share:.4f}" for share in shares))
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """The p-values are super-uniform, and the scheme keeps its level."""
    n, confidence = data.sizes["run"], float(data.confidence)
    excess = {"first stage": _excess(data.p_value.to_numpy())}
    for layer in data.layer.to_numpy():
        excess[str(layer)] = _excess(data.layer_p_value.sel(layer=layer).to_numpy())
    worst = min(excess, key=lambda name: excess[name])
    alarms, runs, level = int(data.alarms), int(data.runs_at_level), float(data.level)
    most = int(binom.ppf(confidence, runs, level))
    return [
        Claim(
            "verify.super-uniform",
            "First-stage p-values of a right kernel are super-uniform",
            "Gandy and Scott 2020, section 2",
            "holds" if min(excess.values()) > 1 - confidence else "fails",
            "holds",
            f"{n} runs; the largest excess is by chance with probability {excess[worst]:.2g} ({worst})",
            f"{1 - confidence:.0e}; thresholds 1e-4 to 0.56",
        ),
        Claim(
            "verify.level",
            "The sequential scheme keeps its level",
            "Gandy and Scott 2020, section 3",
            "holds" if alarms <= most else "fails",
            "holds",
            f"{alarms} false alarms in {runs} at level {level:g}; {float(data.further_stages):.0%} had a second stage",
            f"at most {most}, binomial at {confidence:g}",
        ),
    ]
