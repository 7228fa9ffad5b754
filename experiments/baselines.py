"""emcee, BlackJAX and this library's moves on one line and one banana: what an independent sample costs each."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.samplers import (
    Method,
    Size,
    autocorrelation_time,
    blackjax_nuts,
    blackjax_walk,
    emcee_stretch,
    library,
)
from experiments.support.sweep import Sweep
from mcmc1d.moves import LargeStep, Mixture, MultipleTry, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.moves.multiple_try import by_target
from mcmc1d.targets import Banana, GaussianMixture, Target
from mcmc1d.techniques import MarginalConditional, PiecewiseConstant, Rectangle, Technique, Uniform
from mcmc1d.verify.goodness import p_value, smallest_gap, total_variation


@dataclass(frozen=True)
class Config(Size):
    """The experiment's numbers."""

    repeats: int = 3
    """Of every method, with other numbers; medians are reported."""
    large: float = 0.1
    """Probability of a large step, where there are any."""
    level: float = 1e-6
    """Of the test of last states, for each method."""


PROFILES = {"quick": Config(), "paper": Config(chains=1024, steps=5000, repeats=5, ensembles=16, ensemble_steps=5000)}

TRIES = 4
BOUNDED = "two modes"
"""Where small steps alone exceed what large ones are bounded by; on the banana nothing could."""


class Case(NamedTuple):
    """A target, what covers its domain, a coarse importance map beside that, and step sizes."""

    target: Target
    whole: Technique
    coarse: Technique
    sigma: float
    """Of a small step in u; a random walk in x gets it times the sides of the domain."""
    scale: float
    """Of NUTS's leapfrog, in x: on the banana under 2 noise / sqrt(1 + x0^2) = 0.25 at x0 = 3, where it is unstable."""


def cases() -> dict[str, Case]:
    """Two modes on the line, and a banana."""
    line, bent = GaussianMixture([0.25, 0.7], [0.05, 0.08], [0.4, 0.6]), Banana()
    edges = np.linspace(0, 1, 9)
    x, y = (np.linspace(bent.lower[k], bent.upper[k], 9) for k in range(2))
    table = bent.bin_masses((x, y))
    return {
        "two modes": Case(line, Uniform(), PiecewiseConstant(edges, line.bin_masses(edges) + 0.01), 0.1, 0.05),
        "banana": Case(
            bent,
            Rectangle(bent.lower, bent.upper),
            MarginalConditional(table + 0.003 * table.sum(), bent.lower, bent.upper),
            0.12,
            0.15,
        ),
    }


def methods(config: Config, case: Case) -> dict[str, Method]:
    """Name -> a function of the seed."""
    small, q = SmallStep(case.sigma), config.large
    one = mcmc1d.Multiplexed(case.target, case.whole)
    two = mcmc1d.Multiplexed(case.target, (case.whole, case.coarse))
    change = StepAndChange(LargeStep())
    with_jumps = Mixture({"large": (q, change), "small": (0.7 - q, small), "jump": (0.3, ReversibleJump())})
    both = Mixture({"large": (q, LargeStep()), "small": (1 - q, small)})
    tries = MultipleTry(SmallStep(2 * case.sigma), TRIES, by_target)
    return {
        "emcee stretch": emcee_stretch(config, one),
        "BlackJAX random walk": blackjax_walk(config, one, case.sigma),
        "BlackJAX NUTS": blackjax_nuts(config, one, case.scale),
        "small": library(config, one, small, 1),
        "small + large": library(config, one, both, 1),
        # A jump keeps x and evaluates nothing.
        "+ reversible jumps": library(config, two, with_jumps, 0.7),
        f"multiple-try, {TRIES}": library(config, one, tries, 2 * TRIES - 1),
    }


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Every method on every target, `repeats` times; compiling is not timed."""
    found: dict[str, list] = {name: [] for name in ("time", "evaluations", "rate", "tv", "p", "states")}
    names: list[str] = []
    bounds = []
    for name, case in cases().items():
        edges, masses = _bins(case.target)
        bounds.append(_bound(config, case))
        todo = methods(config, case)
        names = list(todo)
        for k, method in enumerate(todo.values()):
            if not names[k].startswith(("emcee", "BlackJAX")):  # those have been compiled
                method(100 * seed + config.repeats)
            walks = [method(100 * seed + repeat) for repeat in range(config.repeats)]
            times = [max(autocorrelation_time(walk.x[..., d]) for d in range(walk.x.shape[-1])) for walk in walks]
            rates = [walk.x.shape[0] * walk.x.shape[1] / t / walk.seconds for walk, t in zip(walks, times, strict=True)]
            last = np.sum([_counts(walk.x[-1], edges) for walk in walks], axis=0)
            everything = np.sum([_counts(walk.x.reshape(-1, walk.x.shape[-1]), edges) for walk in walks], axis=0)
            values = {
                "time": np.median(times),
                "evaluations": np.median([walk.evaluations for walk in walks]),
                "rate": np.median(rates),
                "tv": total_variation(everything / np.sum(everything), masses),
                "p": p_value(last, masses) if np.sum(last) == sum(walk.x.shape[1] for walk in walks) else 0.0,
                "states": np.sum(last),
            }
            for key, value in values.items():
                found[key].append(float(value))
            progress(name, k + 1, len(todo))
    shape = (len(cases()), len(names))
    variables = {key: (("target", "sampler"), np.reshape(values, shape)) for key, values in found.items()}
    return xr.Dataset(
        variables | {"bound": ("target", bounds), "level": config.level, "large": config.large},
        {"target": list(cases()), "sampler": names},
    )


def _bins(target: Target) -> tuple[list[np.ndarray], np.ndarray]:
    """The edges along each coordinate, and the exact masses, which sum to one."""
    corners = [np.atleast_1d(np.asarray(corner, np.float64)) for corner in target.domain]
    edges = [np.linspace(a, b, 21 if len(corners[0]) == 1 else 9) for a, b in zip(*corners, strict=True)]
    masses = target.bin_masses(edges[0] if len(edges) == 1 else (edges[0], edges[1]))
    return edges, masses / masses.sum()


def _counts(x: np.ndarray, edges: list[np.ndarray]) -> np.ndarray:
    return np.histogramdd(x, edges)[0]


def _bound(config: Config, case: Case) -> float:
    """2 / (q beta) - 1, beta the smallest ratio of the uniform density to the target's: see `judge`."""
    corners = [np.atleast_1d(np.asarray(corner, np.float64)) for corner in case.target.domain]
    fine = [np.linspace(a, b, 1001 if len(corners[0]) == 1 else 401) for a, b in zip(*corners, strict=True)]
    points = np.stack(np.meshgrid(*fine, indexing="ij"), -1).reshape(-1, len(fine))
    log_f = jax.vmap(case.target.log_f)(jnp.asarray(points[:, 0] if len(fine) == 1 else points))
    b = case.target.bin_masses(fine[0][[0, -1]] if len(fine) == 1 else (fine[0][[0, -1]], fine[1][[0, -1]])).sum()
    beta = b / (float(np.exp(log_f).max()) * np.prod(corners[1] - corners[0]))
    return float(2 / (config.large * beta) - 1)


def draw(data: xr.Dataset) -> Figure:
    """Effective samples an evaluation, and a second, of every method on either target."""
    figure, axes = plt.subplots(1, 2, figsize=(7.0, 2.1), sharey=True)
    y = np.arange(data.sizes["sampler"])
    per_evaluation = 1 / (data.time * data.evaluations)
    for axis, values, label in zip(
        axes,
        (per_evaluation, data.rate),
        ("effective samples per evaluation", "effective samples per second"),
        strict=True,
    ):
        for target, mark, shift in zip(data.target.to_numpy(), ("o", "s"), (-0.12, 0.12), strict=True):
            axis.plot(values.sel(target=target), y + shift, mark, markersize=4, label=str(target))
        axis.set(xscale="log", xlabel=label)
        axis.grid(axis="y", color="0.9", linewidth=0.5)
        axis.set_axisbelow(True)
    axes[0].set_yticks(y, [str(name) for name in data.sampler.to_numpy()])
    axes[0].invert_yaxis()
    axes[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def table(data: xr.Dataset) -> Table:
    """One row for each method and target."""
    result = Table("target", "method", "IAT", "eval/step", "ESS/eval", "ESS/s", "TV", "p last", box=SIMPLE, padding=0)
    result.title = "baselines: medians; IAT in steps, of the slower coordinate"
    for target in data.target.to_numpy():
        for name in data.sampler.to_numpy():
            here = data.sel(target=target, sampler=name)
            result.add_row(
                str(target),
                str(name),
                f"{float(here.time):.1f}",
                f"{float(here.evaluations):.1f}",
                f"{1 / float(here.time * here.evaluations):.2g}",
                f"{float(here.rate):.2g}",
                f"{float(here.tv):.4f}",
                f"{float(here.p):.2g}",
            )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """All agree with the exact law; large steps keep the autocorrelation time under what theory says.

    A reversible kernel with P >= q beta pi has no eigenvalue beyond 1 - q beta but 1 itself; independent proposals p of
    probability q give beta = min p / pi (Mengersen and Tweedie 1996), and no function's autocorrelation time is
    then over (1 + lambda) / (1 - lambda).
    """
    claims = []
    for target in data.target.to_numpy():
        here = data.sel(target=target)
        name = str(target).replace(" ", "-")
        worst = int(np.argmin(here.p.to_numpy()))
        level = float(data.level)
        gaps = [smallest_gap(int(n), level) for n in (here.states.min(), here.states.max())]
        claims.append(
            Claim(
                f"baselines.law-{name}",
                f"emcee, BlackJAX and this library's moves agree with the exact law ({target})",
                "ours; emcee 3, BlackJAX 1",
                "holds" if float(here.p.min()) >= level else "fails",
                "holds",
                f"smallest p {float(here.p.min()):.2g} ({here.sampler.to_numpy()[worst]}), of {here.sizes['sampler']}; "
                f"TV {float(here.tv.min()):.4f} to {float(here.tv.max()):.4f}",
                f"last states, level {level:.0e} each; a CDF gap of {gaps[0]:.2f} (emcee) or {gaps[1]:.2f} seen with "
                "probability 0.99",
            )
        )
        if target != BOUNDED:
            continue
        alone = float(here.time.sel(sampler="small"))
        measured, bound = float(here.time.sel(sampler="small + large")), float(here.bound)
        claims.append(
            Claim(
                f"baselines.large-step-{name}",
                f"Large steps bound every autocorrelation time by 2 / (q beta) - 1 ({target})",
                "Mengersen and Tweedie 1996",
                "holds" if measured <= bound else "fails",
                "holds",
                f"{measured:.1f} steps, bound {bound:.1f}; small steps alone {alone:.1f}",
                f"the exact bound, q = {float(data.large)}, beta from the maximum of f on a fine grid",
            )
        )
    return claims
