"""Bitterli et al. 2017, figures 4 and 5 and their videos, in the plane.

RJMLT is the paper's: jumps to technique j with probability w_j, always accepted (section 4). "Uniform jumps" go to
each technique alike: ours, another T of their eq. 14. As in section 7.2 RJMLT makes 10 % large steps, 85 % small ones
and 5 % jumps; MMLT 10 % large and 90 % small ones. What differs from the paper: two dimensions; rays instead of
minutes, of which a jump takes none, so that RJMLT has 1 / 0.95 as many mutations; chains start exactly, one a run and
path length; small steps are normal, with sigma 0.05 (the paper does not say what theirs are); acceptance in `box`, not
in their living room; scenes, lengths and runs as configured (the paper: 8 scenes, all lengths, 50 runs).
"""

from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.flatland_acceptance import PAPER, SHOWN, acceptance_claims, accepted
from experiments.support.flatland_chains import METHODS
from experiments.support.flatland_stability import STATISTICS, compared, converge, stability_claims
from experiments.support.framework import Claim, chosen, numbers
from experiments.support.sweep import Sweep
from mcmc1d.checks import require
from mcmc1d.flatland.scenes import catalogue


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "door mirror_caustic"
    """Of the convergence."""
    lengths: str = "4"
    """Edges of its paths."""
    pixels: int = 16
    acceptance_scene: str = "box"
    acceptance_lengths: str = "2 4 7 10"
    """From 2 edges on: the camera does not see the lamp."""
    states: int = 2**13
    """Exact ones at each length, with a proposal of one of four kinds each."""
    sigma: float = 0.05
    large: float = 0.1
    """The paper's share of large steps; small ones are what these and the jumps leave."""
    jump: float = 0.05
    runs: int = 1024
    """Independent runs of one chain for each path length; 50 in the paper."""
    first: int = 64
    """Mutations of each length, jumps not counted, after which a run's image is looked at first."""
    doublings: int = 6
    batches: int = 16
    """Of 2^16 samples each for b, where images are held to the exact one in absolute scale."""


PROFILES = {
    "quick": Config(),
    "paper": Config(
        # Not office, whose exact image is out of reach, nor lab, for its time.
        scenes="furnace box door occluder mirror_caustic glossy_corner open three_rooms",
        lengths="3 4 5 6",
        acceptance_lengths="2 3 4 5 6 7 8 9 10",
        states=2**16,
        runs=512,
        doublings=7,
    ),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Acceptance of each kind of move by path length; the errors of each run of each method on each scene."""
    require(config.doublings >= 4, f"doublings are 4 at least, for three looks, not {config.doublings}")
    known = catalogue()
    names, scene = chosen(config.scenes, known), config.acceptance_scene
    require(scene in known, f"there is no {scene}; known: {', '.join(known)}")
    edges, lengths = (numbers(of, getattr(config, of)) for of in ("acceptance_lengths", "lengths"))
    steps = [config.first * 2**k for k in range(config.doublings + 1)]
    moves = config.sigma, config.large, config.jump
    asked = [(k, scene, config.pixels, config.states, moves, seed) for k in edges]
    rates = progress.map("acceptance", accepted, asked)
    points = [(name, lengths, config.pixels, config.runs, steps, moves, config.batches, seed) for name in names]
    errors = progress.map("convergence", converge, points)
    rate, found = ({part: np.array([one[part] for one in rows]) for part in rows[0]} for rows in (rates, errors))
    by_move, by_pixel = ("edges", "move"), ("scene", "method", "pixel")
    ratio = ("statistic", "rival", "scene", "look", "end")
    return xr.Dataset(
        {
            **{part: (by_move, rate[part]) for part in ("acceptance", "acceptance_error", "proposals")},
            **{part: ("edges", rate[part]) for part in ("predicted", "predicted_error")},
            **{part: (by_pixel, found[part]) for part in ("spread", "excess", "twin", "detectable")},
            "squared": (("scene", "method", "mutations", "run"), found["squared"]),
            "rays": (("scene", "mutations"), found["rays"]),
            "ratio": (ratio, compared(found["squared"], found["flickers"])),
        },
        {
            "edges": edges,
            "move": list(SHOWN),
            "scene": names,
            "method": list(METHODS),
            "rival": list(METHODS[1:]),
            "mutations": steps,
            "statistic": list(STATISTICS),
        },
    )


STYLES: dict[str, tuple[str, Any]] = {
    "MMLT": ("C0", "-"),
    "MMLT, any technique": ("C0", "--"),
    "RJMLT": ("C2", "-"),
    "RJMLT, uniform jumps": ("C2", "--"),
}


def draw(data: xr.Dataset) -> Figure:
    """Acceptance by path length; by scene, the squared error's mean and spread, and that of pixels from run to run."""
    scenes = data.scene.to_numpy()
    columns = min(4, len(scenes) + 1)
    rows = -(-(len(scenes) + 1) // columns)
    figure, axes = plt.subplots(2 * rows, columns, figsize=(7.0, 3.6 * rows), squeeze=False)
    for panel in axes.flat:
        panel.axis("off")
    _draw_acceptance(axes[0, 0], data)
    for k, name in enumerate(scenes, 1):
        above, below = axes[2 * (k // columns), k % columns], axes[2 * (k // columns) + 1, k % columns]
        _draw_scene(above, below, data.sel(scene=name))
        above.set_title(str(name).replace("_", " "))
    axes[1, 0].legend(*axes[0, 0].get_legend_handles_labels(), loc="upper left", handlelength=2.4)
    lines = [Line2D([], [], color=color, linestyle=dashes) for color, dashes in STYLES.values()]
    lines.append(Line2D([], [], color="0.5", linestyle=":"))
    labels = [*STYLES, "standard deviation over runs (MMLT, RJMLT)"]
    figure.legend(lines, labels, loc="outside lower center", ncols=5, handlelength=2.4)
    return figure


def _draw_acceptance(panel: Axes, data: xr.Dataset) -> None:
    labels = ("small step, kept", "small step, changed", "jump (RJMLT)", "uniform jump (ours)")
    for move, label, style in zip(
        SHOWN, labels, (("C0", "s-"), ("C0", "v--"), ("C2", "o-"), ("C2", "^--")), strict=True
    ):
        here = 100 * data.acceptance.sel(move=move)
        panel.plot(data.edges, here, style[1], color=style[0], markersize=3, label=label)
    panel.plot(data.edges, 100 * data.predicted, "_", color="black", markersize=7, label="uniform, predicted")
    panel.plot(PAPER[0], 100 * PAPER[1], "x", color="black", markersize=4, label="changed, in the paper")
    panel.axis("on")
    panel.set(xlabel="edges", ylabel="acceptance (%)", ylim=(0, 105), yticks=range(0, 101, 20))
    panel.set_xticks(data.edges.to_numpy())


def _draw_scene(above: Axes, below: Axes, data: xr.Dataset) -> None:
    for method, (color, dashes) in STYLES.items():
        of = {"method": method}  # `method=` is xarray's own argument
        squared = data.squared.sel(of)
        above.plot(data.rays, squared.mean("run"), color=color, linestyle=dashes)
        if method in METHODS[:3:2]:
            above.plot(data.rays, squared.std("run", ddof=1), color=color, linestyle=":")
        below.plot(100 * data.spread.sel(of), color=color, linestyle=dashes, drawstyle="steps-mid")
    for panel in (above, below):
        panel.axis("on")
    above.set(xscale="log", yscale="log", xlabel="rays", ylabel="squared error / mean²")
    below.set(xlabel="pixel", ylabel="s.d. over runs (% of pixel)", yscale="log")
    low, high = below.get_ylim()
    ticks = [t for t in (2, 5, 10, 20, 30, 50, 100, 200, 300, 500, 1000) if low < t < high]
    below.set_yticks(ticks, [str(t) for t in ticks])
    below.yaxis.set_minor_locator(NullLocator())
    below.set_xticks(range(0, data.sizes["pixel"], 5))


def table(data: xr.Dataset) -> Table:
    """At the most rays: squared error, its standard deviation over runs, and the spread of pixels from run to run."""
    result = Table(
        "scene", "method", "MSE", "s.e.", "s.d. over runs", "pixel, run to run", title="flatland_rjmlt", box=SIMPLE,
        padding=0,
    )  # fmt: skip
    for name in data.scene.to_numpy():
        for method in METHODS:
            here = data.sel({"scene": name, "method": method})
            squared, spread = here.squared.isel(mutations=-1), here.spread
            mean, deviation = float(squared.mean()), float(squared.std(ddof=1))
            error = deviation / np.sqrt(data.sizes["run"])
            middle, worst = float(spread.median()), float(spread.max())
            cells = f"{mean:.4g}", f"{error:.2g}", f"{deviation:.3g}", f"{middle:.0%} (median), {worst:.0%} (worst)"
            result.add_row(str(name), method, *cells)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Acceptance by kind of move; the images' exactness, errors and stability against MMLT's."""
    return acceptance_claims(data) + stability_claims(data)
