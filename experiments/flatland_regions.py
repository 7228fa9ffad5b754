"""Hachisuka et al. 2014, figure 6, in the plane: how images converge where a camera sees gloss, and where it does not.

The paper shows close-ups of figure 4 by original MLT and MMLT, and no numbers. Here the pixels are marked that see a
glossy wall in all of their width, and those that see none, and each part's error is drawn against rays, beside that of
BDPT. Scenes, lengths and work are those of `flatland_mmlt`, and differ from the paper as is said there.
"""

from dataclasses import asdict, dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.flatland_equal import Rivalry, critical, judged, log_ratio, mean_ratio, root, squared
from experiments.support.flatland_glossy import GLOSSY_DOOR, marked, with_glossy_door
from experiments.support.flatland_sayings import AGAINST, SOURCE
from experiments.support.flatland_work import Work, draw_errors, gathered, measured
from experiments.support.framework import Claim, between, chosen
from experiments.support.intervals import DECIDES, Ratio, shown
from experiments.support.sweep import Sweep
from experiments.support.verdict import among

PARTS = ("glossy", "diffuse")
INTEGRATORS = ("BDPT", "MLT", "MMLT")


@dataclass(frozen=True)
class Config(Work):
    """The experiment's numbers."""

    scenes: str = GLOSSY_DOOR
    """With a pinhole, of which some pixels see gloss only."""


PROFILES = {
    "quick": Config(),
    "paper": Config(scenes=f"{GLOSSY_DOOR} glossy_corner", shortest=3, longest=6, runs=256, doublings=9, samples=2**23),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

COMPARABLE = 1.5
"""Errors whose ratio lies between this and its reciprocal are called comparable; ours, for the paper has no number."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The three on every scene and path length, part by part."""
    known, lengths = with_glossy_door(), between(config.shortest, config.longest)
    names = chosen(config.scenes, known)
    for name in names:
        marked(known[name]().with_pixels(config.pixels))  # told at once, not when all has been measured
    points = [(name, k, asdict(config), seed) for name in names for k in lengths]
    found = progress.map("scenes and lengths", measure, points)
    return gathered(found, names, config, regions=True, integrators=INTEGRATORS)


def measure(name: str, edges: int, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """One scene and path length: what JSON can hold of it."""
    return measured(name, edges, Config(**fields), seed, regions=True, integrators=INTEGRATORS)


def draw(data: xr.Dataset) -> Figure:
    """A row a scene: the exact image with its marked pixels, and error against rays in both parts, b known."""
    rows = data.sizes["scene"]
    figure, axes = plt.subplots(rows, 3, figsize=(7.0, 0.6 + 1.8 * rows), squeeze=False)
    for k, row in enumerate(axes):
        here = data.isel(scene=k)
        pixel, truth = np.arange(data.sizes["pixel"]), here.reference.sum("edges")
        seen = [here.member.sel(part=part).to_numpy() for part in PARTS]
        for mine, color, label in zip(
            (*seen, ~np.any(seen, axis=0)), ("C4", "C5", "0.8"), ("gloss only", "no gloss", "both"), strict=True
        ):
            row[0].bar(pixel[mine], truth[mine], 0.9, color=color, label=label)
        row[0].xaxis.set_major_locator(MaxNLocator(integer=True))
        row[0].set(ylabel=f"{here.scene.item()}\nradiance", ylim=(0, 1.25 * float(truth.max())))  # room for the legend
        row[0].legend(
            loc="upper left", title="what a pixel sees", title_fontsize=6, alignment="left", ncols=3, columnspacing=1.0
        )
        for panel, part in zip(row[1:], PARTS, strict=True):
            draw_errors(panel, *squared(here, part, b_known=True))
            panel.set(ylabel="RMS error (% of the part's mean)", title=f"{part} pixels, b known" if k == 0 else "")
    for panel, label in zip(axes[-1], ("pixel", "rays", "rays"), strict=True):
        panel.set_xlabel(label)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(INTEGRATORS))
    return figure


def table(data: xr.Dataset) -> Table:
    """Errors at the most rays, in each part, b known."""
    names = [str(name) for name in data.scene.to_numpy()]
    heads = [f"{name}: {part}" for name in names for part in PARTS]
    result = Table("integrator", *heads, title="flatland_regions", box=SIMPLE, padding=0)
    for who in INTEGRATORS:
        cells = [root(_last(data, name, part, who))[0] for name in names for part in PARTS]
        result.add_row(who, *(f"{cell:.2%}" for cell in cells))
    return result


def _last(data: xr.Dataset, name: str, part: str, who: str) -> np.ndarray:
    """The squared error of each run at the most rays."""
    return squared(data.sel(scene=name), part, b_known=True)[1].sel(integrator=who).isel(budget=-1).to_numpy()


def judge(data: xr.Dataset) -> list[Claim]:
    """MMLT against original MLT where there is gloss and where there is none; and whose error is more even."""
    glossy = Rivalry(
        "plane.mmlt-glossy-pixels",
        "Where the camera sees gloss MMLT's error at equal rays is lower than original MLT's",
        f"{SOURCE}, fig. 1, 4, 6",
        "fails",
        "MMLT",
        ("MLT",),
        (GLOSSY_DOOR, "glossy_corner"),
        b_known=True,
        part="glossy",
    )
    return [*judged([glossy], data), _comparable(data), _uniform(data)]


def _comparable(data: xr.Dataset) -> Claim:
    names = [str(name) for name in data.scene.to_numpy()]

    def of(name: str, miss: float = 0.05) -> Ratio:
        return mean_ratio(_last(data, name, "diffuse", "MMLT"), _last(data, name, "diffuse", "MLT"), miss)

    miss = DECIDES / len(names)
    deciding = {name: of(name, miss) for name in names}
    blind = max(high / middle for middle, _, high in deciding.values())
    return Claim(
        "plane.mmlt-diffuse-pixels",
        "Where the camera sees no gloss MMLT's error at equal rays is comparable with original MLT's, b known",
        f"{SOURCE}, fig. 1",
        among({name: within(1 / COMPARABLE, COMPARABLE, ratio) for name, ratio in deciding.items()}),
        "holds",
        "RMS error, " + "; ".join(f"{name}: MMLT / MLT {shown(of(name))}" for name in names),
        f"comparable is from {1 / COMPARABLE:.2f} to {COMPARABLE:g}, ours; t interval, shown of 95 %, deciding at "
        f"{DECIDES:g} of all scenes, which errs by a factor of {blind:.2f}; {int(data.runs)} runs",
    )


def within(low: float, high: float, found: Ratio) -> bool | None:
    """Whether a ratio is between two limits; None where its interval does not decide it."""
    _, least, most = found
    return True if low < least and most < high else False if most < low or least > high else None


def _uniform(data: xr.Dataset) -> Claim:
    """By how far, in log, the errors of the parts are apart: of MLT more than of MMLT."""
    names, more = [str(name) for name in data.scene.to_numpy()], {}
    far = critical(data, len(names))
    words, blind = [], 0.0
    for name in names:
        gap, doubt = {}, {}
        for who in ("MLT", "MMLT"):
            gap[who], doubt[who] = log_ratio(*(_last(data, name, part, who) for part in PARTS))
        apart, error = abs(gap["MLT"]) - abs(gap["MMLT"]), far * float(np.hypot(*doubt.values()))
        more[name] = True if apart > error else False if apart < -error else None
        blind = max(blind, error)
        words.append(f"{name}: " + ", ".join(f"{who} {np.exp(gap[who]):.2f}" for who in gap))
    return Claim(
        "plane.mmlt-uniform",
        "MMLT converges more uniformly than original MLT: its relative errors with and without gloss are more alike",
        f"{SOURCE}, fig. 6",
        among(more),
        AGAINST,
        "RMS error of glossy pixels over that of diffuse ones: "
        + "; ".join(words)
        + "; MMLT's is more uniform in the paper",
        f"{far:.1f} s.e. (t of {int(data.runs)} runs, 1e-4 of all scenes), either way; sees one "
        f"{np.exp(blind):.2f} times as far from 1 as the other",
    )
