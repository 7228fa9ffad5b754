"""Adaptive step size and large-step probability: adaptation that fades keeps the law, one that does not loses it."""

from dataclasses import dataclass

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.adaptation_line import GAINS, LINE, predicted, simulate
from experiments.support.adaptation_ring import KINDS, VALUES, accepted_or_not, adaptive_chain
from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.verify.goodness import cdf_gap, expected_distance, p_value, smallest_gap, total_variation

SOURCE = "Hachisuka et al. 2014, sec. 6"
THEORY = "Roberts, Rosenthal 2007"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    horizon: int = 100_000
    """Steps of the finite chains, whose law is computed."""
    chains: int = 2**17
    steps: int = 512
    bins: int = 32
    points: int = 2**20
    """Of the net that predicts the wrong law on the line."""
    level: float = 1e-6
    """Probability that a right law is rejected by one test."""
    agreement: float = 5e-3
    """Total variation up to which prediction and simulation agree, beyond the simulation's noise."""


PROFILES = {"quick": Config(), "paper": Config(horizon=1_000_000, chains=2**19, steps=2048, points=2**22)}

MARKS = 10.0


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The finite chains' laws, computed; then the line, by simulation and by the operator."""
    pi = VALUES / VALUES.sum()
    marks = np.unique(np.round(MARKS ** np.arange(0, np.log10(config.horizon) + 0.01, 0.25)).astype(int))
    unfading, curves = [], []
    for kind in KINDS:
        adapted, kept = adaptive_chain(*accepted_or_not(kind))
        settings = len(adapted) // len(pi)
        start = np.zeros((settings, len(pi)))
        start[0] = pi
        laws = {}
        for name in ("fading", "not fading"):
            v, found = start.ravel(), []
            for n in range(1, marks[-1] + 1):
                v = v @ adapted if name == "not fading" else (v @ adapted + (n - 1) * (v @ kept)) / n
                if n in marks:
                    found.append(total_variation(v.reshape(settings, -1).sum(0), pi))
            laws[name] = v.reshape(settings, -1).sum(0)
            curves.append(found)
        unfading.append(laws["not fading"])
        progress("finite chains", KINDS.index(kind) + 1, len(KINDS))

    edges = np.linspace(0, 1, config.bins + 1)
    masses = LINE.bin_masses(edges)
    counts, sigmas, rates = [], [], []
    for k, gain in enumerate(GAINS.values()):
        x, log_sigma, rate = simulate(config.chains, config.steps, gain, jax.random.fold_in(jax.random.key(seed), k))
        counts.append(np.histogram(x, edges)[0])
        sigmas.append(float(np.exp(np.median(log_sigma))))
        rates.append(rate)
        progress("line", k + 1, len(GAINS))
    law = predicted(config.points, edges, seed)
    return xr.Dataset(
        {
            "pi": ("state", pi),
            "unfading": (("kind", "state"), np.stack(unfading)),
            "distance": (("kind", "adaptation", "step"), np.reshape(curves, (2, 2, -1))),
            "masses": ("bin", masses / masses.sum()),
            "counts": (("gain", "bin"), np.stack(counts)),
            "sigma": ("gain", sigmas),
            "rate": ("gain", rates),
            "p": ("gain", [p_value(c, masses) for c in counts]),
            "gap": ("gain", [cdf_gap(c, masses) for c in counts]),
            "predicted": ("bin", law),
            "detectable": smallest_gap(config.chains, config.level),
            "level": config.level,
            "agreement": config.agreement,
            "chains": config.chains,
            "steps": config.steps,
        },
        {
            "state": np.arange(len(pi)),
            "kind": list(KINDS),
            "adaptation": ["fading", "not fading"],
            "step": marks,
            "bin": (edges[1:] + edges[:-1]) / 2,
            "gain": list(GAINS),
        },
    )


def draw(data: xr.Dataset) -> Figure:
    """The wrong laws on the ring, the distance from the law against the steps, and the wrong law on the line."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7.0, 2.2))
    x = data.state.to_numpy()
    left.bar(x, data.pi, 0.8, color="0.8", label="exact")
    for kind, mark, colour in zip(data.kind.to_numpy(), "os", ("C1", "C3"), strict=True):
        left.plot(x, data.unfading.sel(kind=kind), mark, color=colour, markersize=3.5, label=f"adapts the {kind}")
    left.set(xlabel="state of the ring", ylabel="probability", ylim=(0, 0.62), title="adaptation that does not fade")
    left.legend()
    for kind, colour in zip(data.kind.to_numpy(), ("C1", "C3"), strict=True):
        for adaptation, style in (("not fading", "-"), ("fading", "--")):
            here = data.distance.sel(kind=kind, adaptation=adaptation)[1:]  # the first step starts exactly
            middle.plot(data.step[1:], here, style, color=colour, label=f"{kind}, {adaptation}")
    middle.set(xscale="log", yscale="log", xlabel="step n", ylabel="TV from the law", ylim=(1e-11, 1))
    middle.legend(loc="lower left")
    width = 1 / data.sizes["bin"]
    counts = data.counts.sel(gain="not fading").to_numpy()
    right.bar(data.bin, counts / counts.sum() / width, width, color="C1", alpha=0.5, linewidth=0, label="simulated")
    right.plot(data.bin, data.masses / width, color="black", linewidth=0.8, label="f / b")
    right.plot(data.bin, data.predicted / width, color="C3", linestyle=(0, (3, 1)), label="operator")
    right.set(xlabel="x", ylabel="density", title="step size, not fading, on the line")
    right.legend()
    return figure


def table(data: xr.Dataset) -> Table:
    """The line: final step size, acceptance, distance from the law."""
    result = Table(
        "adaptation", "step size", "acceptance", "TV", "CDF gap", "p", title="adaptation", box=SIMPLE, padding=0
    )
    for gain in data.gain.to_numpy():
        here = data.sel(gain=gain)
        distance = total_variation(here.counts.to_numpy() / here.counts.to_numpy().sum(), data.masses.to_numpy())
        cells = f"{float(here.sigma):.3f}", f"{float(here.rate):.3f}", f"{distance:.4f}", f"{float(here.gap):.4f}"
        result.add_row(str(gain), *cells, f"{float(here.p):.2g}")
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """What fades keeps the law, at a rate of 1 / n; what does not loses it, by as much as the operator says."""
    level, steps = float(data.level), int(data.steps)
    held = f"level {level:.0e}; detects a CDF gap of {float(data.detectable):.4f} after {steps} steps w.p. 0.99"
    final = {
        (k, a): float(data.distance.sel(kind=k, adaptation=a)[-1]) for k in KINDS for a in ("fading", "not fading")
    }
    horizon = int(data.step[-1])
    masses = data.masses.to_numpy()
    share = {str(g): c / c.sum() for g, c in zip(data.gain.to_numpy(), data.counts.to_numpy(), strict=True)}
    distance = {name: total_variation(law, masses) for name, law in share.items()}
    p = {str(g): float(data.p.sel(gain=g)) for g in data.gain.to_numpy()}
    apart = total_variation(share["not fading"], data.predicted.to_numpy())
    noise = expected_distance(np.sqrt(masses * (1 - masses) / float(data.chains)))

    def slope(kind: str) -> float:
        late = data.step.to_numpy() >= 100
        here = data.distance.sel(kind=kind, adaptation="fading").to_numpy()[late]
        return float(np.polyfit(np.log(data.step.to_numpy()[late]), np.log(here), 1)[0])

    slopes = [slope(kind) for kind in KINDS]
    return [
        Claim(
            "adaptation.fading",
            "A step size that is adapted less and less (gain 1 / n, bounded) keeps the law",
            f"{SOURCE}; {THEORY}",
            verdict(final[KINDS[0], "fading"] < 1e-4 and p["fading"] >= level),
            "holds",
            f"ring: TV {final[KINDS[0], 'fading']:.1e} after {horizon} steps; line: TV {distance['fading']:.4f}, "
            f"p {p['fading']:.2g} (no adaptation: p {p['none']:.2g})",
            f"computed, 1e-4; {held}",
        ),
        Claim(
            "adaptation.not-fading",
            "A step size may go on adapting with a constant gain",
            f"ours; {THEORY}",
            verdict(final[KINDS[0], "not fading"] < 1e-4 and p["not fading"] >= level),
            "fails",
            f"ring: TV {final[KINDS[0], 'not fading']:.4f}; line: TV {distance['not fading']:.4f}, "
            f"p {'under 1e-300' if p['not fading'] < 1e-300 else format(p['not fading'], '.1g')}",
            f"computed, 1e-4; {held}",
        ),
        Claim(
            "adaptation.large-fading",
            "A large-step probability that is adapted less and less keeps the law",
            f"{SOURCE}; {THEORY}",
            verdict(final[KINDS[1], "fading"] < 1e-4),
            "holds",
            f"ring: TV {final[KINDS[1], 'fading']:.1e} after {horizon} steps",
            "computed, 1e-4",
        ),
        Claim(
            "adaptation.large-not-fading",
            "A large-step probability may go on adapting",
            f"ours; {THEORY}",
            verdict(final[KINDS[1], "not fading"] < 1e-4),
            "fails",
            f"ring: TV {final[KINDS[1], 'not fading']:.4f}",
            "computed, 1e-4",
        ),
        Claim(
            "adaptation.rate",
            "The bias of fading adaptation falls as its gain, 1 / n",
            f"ours; {THEORY}",
            verdict(max(abs(s + 1) for s in slopes) < 0.1),
            "holds",
            f"TV falls as n^{slopes[0]:.3f} and n^{slopes[1]:.3f}",
            "exponent within 0.1 of -1; computed laws from step 100 on",
        ),
        Claim(
            "adaptation.operator",
            "The operator on (x, step size) predicts the law that adaptation without fading has",
            "ours",
            verdict(apart < float(data.agreement) + 2 * noise),
            "holds",
            f"TV {apart:.4f} between predicted and simulated, {distance['not fading']:.4f} from f / b",
            f"TV {float(data.agreement):.0e} beyond twice the simulation's noise, {noise:.4f}",
        ),
    ]
