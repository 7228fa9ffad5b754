"""Hachisuka et al. 2014, figures 1, 4, 5, 9, in the plane: error against rays, samples by technique, effective paths.

Where it differs from the paper. Scenes are walls in the plane, seen by 16 pixels: `glossy_door` stands for figure 1
and, with `glossy_corner` (paper profile), for the bathroom of figure 4; `door` for figure 9; `mirror_caustic` (paper
profile) is ours.
Two walls of `glossy_door` are glossy, with an exponent of 20, where the paper's are "highly glossy". Work is counted in
rays, not in minutes. Paths have 4 edges (paper profile: 3 to 6) where the paper has up to eight bounces; figure 5 shows
the longest, 4 edges (6), where the paper's are "of length six". Runs are of one chain for each length. Original MLT has
the mutations and the shares of `MLT`, which were not tuned for a scene as the paper's were. PSSMLT is Alg. 1's, with
the maximum; with the sum, and path and light tracing, it is ours.
"""

from dataclasses import asdict, dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.flatland_equal import critical, judged, root, squared
from experiments.support.flatland_glossy import GLOSSY_DOOR, with_glossy_door
from experiments.support.flatland_rivals import CHAINS, INTEGRATORS
from experiments.support.flatland_sayings import RIVALRIES, SOURCE
from experiments.support.flatland_work import Work, draw_errors, gathered, measured
from experiments.support.framework import Claim, between, chosen
from experiments.support.sweep import Sweep
from experiments.support.verdict import among, verdict


@dataclass(frozen=True)
class Config(Work):
    """The experiment's numbers."""

    scenes: str = f"door {GLOSSY_DOOR}"


PROFILES = {
    "quick": Config(),
    "paper": Config(
        scenes=f"door {GLOSSY_DOOR} glossy_corner mirror_caustic", shortest=3, longest=6, runs=256, doublings=9,
        samples=2**23,
    ),
}  # fmt: skip

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

SHARP = 0.1
"""The smallest error that an image must let one see in each pixel, of its mean, for it to be called exact."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Every integrator on every scene and path length; the comparison is of all lengths together."""
    names, lengths = chosen(config.scenes, with_glossy_door()), between(config.shortest, config.longest)
    points = [(name, k, asdict(config), seed) for name in names for k in lengths]
    return gathered(progress.map("scenes and lengths", measure, points), names, config)


def measure(name: str, edges: int, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """One scene and path length: what JSON can hold of it."""
    return measured(name, edges, Config(**fields), seed)


def draw(data: xr.Dataset) -> Figure:
    """A row a scene: error against rays, in bands of 95 %; what techniques contribute and sample, by pixel too."""
    rows = data.sizes["scene"]
    figure, axes = plt.subplots(
        rows, 5, figsize=(7.0, 0.6 + 1.45 * rows), squeeze=False, width_ratios=(3.2, 2.6, 1.9, 1.9, 1.9)
    )
    for k, row in enumerate(axes):
        here = data.isel(scene=k)
        draw_errors(row[0], *squared(here))
        row[0].set_ylabel(f"{here.scene.item()}\nRMS error (% of mean)")
        used = here.isel(edges=-1).dropna("technique", subset=["contribution"])
        n, edges = used.sizes["technique"], int(here.edges[-1])
        walked = np.arange(n) + edges + 2 - n  # vertices from the sensor: from 1 for a pinhole, from 0 for a wall
        _draw_shares(row[1], used, [f"{edges + 1 - t},{t}" for t in walked])
        shown = (used.contribution_film, used.usage_film, used.placed_film)
        norm = Normalize(0, 100 * float(max(film.max() for film in shown)))
        titles = ("contribution", "samples, MMLT", "samples, PSSMLT")
        for panel, film, title in zip(row[2:], shown, titles, strict=True):
            panel.pcolormesh(100 * film, cmap="cividis", norm=norm)
            panel.set_yticks(np.arange(n) + 0.5, [str(t) for t in walked])
            panel.set_xticks([0, data.sizes["pixel"] // 2, data.sizes["pixel"]])
            panel.set_title(title if k == 0 else "")
        row[2].set_ylabel("t (vertices from sensor)")
        figure.colorbar(ScalarMappable(norm, "cividis"), ax=row[4], label="% of all", fraction=0.12, aspect=12)
    for panel, label in zip(axes[-1], ("rays", "technique s,t", "pixel", "pixel", "pixel"), strict=True):
        panel.set_xlabel(label)
    axes[0, 0].set_title(f"b from {float(data.spent_on_b):.0%} of a chain's rays")
    axes[0, 1].set_title(f"paths of {int(data.edges[-1])} edges")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    more, names = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles + more, labels + names, loc="outside lower center", ncols=6)
    return figure


def _draw_shares(panel: Axes, used: xr.Dataset, techniques: list[str]) -> None:
    """Figure 5's rows as bars; PSSMLT makes as many samples by each technique, by construction."""
    place = np.arange(len(techniques))
    bars = ((used.contribution, "0.6", "contribution"), (used.usage, "C0", "samples, MMLT"))
    for left, (value, color, label) in zip((-0.2, 0.2), bars, strict=True):
        panel.bar(place + left, 100 * value, 0.38, color=color, label=label)
    equal = "samples, PSSMLT (by construction)"
    panel.axhline(100 / len(techniques), color="C1", linestyle="--", linewidth=0.8, label=equal)
    panel.set_xticks(place, techniques, fontsize=5)
    panel.set_ylabel("share (%)")


def table(data: xr.Dataset) -> Table:
    """Errors at equal rays with b known, and effective path ratios of the longest paths."""
    names = [str(name) for name in data.scene.to_numpy()]
    result = Table(
        "integrator", *(f"{n}: error" for n in names), *(f"{n}: effective" for n in names), title="flatland_mmlt",
        box=SIMPLE, padding=0,
    )  # fmt: skip
    for who in INTEGRATORS:
        last = (squared(data.sel(scene=n), b_known=True)[1].sel(integrator=who).isel(budget=-1) for n in names)
        cells = [f"{root(each.to_numpy())[0]:.2%}" for each in last]
        for name in names:
            lit = data.effective.sel(scene=name).isel(edges=-1)
            cells.append(f"{float(lit[CHAINS.index(who)]):.2%}" if who in CHAINS else "")
        result.add_row(who, *cells)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Exact images, usage that follows contribution, effective paths, and who is better at equal rays."""
    return [_exact(data), _usage(data), _effective(data), *judged(RIVALRIES, data)]


def _exact(data: xr.Dataset) -> Claim:
    """Each pixel, and the image's mean: of a chain it tests the integral that was estimated apart."""
    truth, doubt = data.reference.sum("edges"), data.reference_error.sum("edges")
    value, noise = data.value.sum("edges"), np.sqrt((data.error**2).sum("edges"))
    mean, mean_noise = truth.mean("pixel"), np.sqrt((data.mean_error**2).sum("edges"))
    far = critical(data, value.size + mean_noise.size)

    def off(image: xr.DataArray) -> tuple[float, xr.DataArray]:
        """The pixel and the mean that are furthest off, beyond the reference's doubt, in standard errors."""
        of_mean = (np.abs(image.mean("pixel") - mean) - doubt.mean("pixel")) / mean_noise
        return float(((np.abs(image - truth) - doubt) / noise).max()), of_mean

    worst, of_mean = off(value)
    least = ((far * noise + doubt) / np.maximum(truth, mean)).max("pixel")
    of_means = (far * mean_noise + doubt.mean("pixel")) / mean
    # PSSMLT with the maximum, multiplied by b where its own integral belongs.
    twin = off((data.value / data.scale).sum("edges"))[1].sel(integrator="PSSMLT, max")
    seen = float(twin.max())  # where one technique makes most of the light the maximum is nearly the sum
    right, sharp = max(worst, float(of_mean.max())) < far, float(least.max()) <= SHARP
    dull = ", ".join(f"{who} {float(one.max()):.0%}" for who, one in least.groupby("integrator", squeeze=False))
    return Claim(
        "plane.mmlt-exact",
        "All integrators agree with the exact image in every pixel and in its mean, in absolute scale",
        "ours, flatland",
        verdict((True if sharp and seen > far else None) if right else False),
        "holds",
        f"{worst:.1f} standard errors at most in a pixel, {float(of_mean.max()):.1f} in the mean; PSSMLT, max times b "
        f"is {seen:.0f} off in {twin.idxmax('scene').item()}",
        f"{far:.1f} s.e. (t of {int(data.runs)} runs, 1e-4 of {value.size + mean_noise.size} tests); sees in the worst "
        f"pixel, of it or of the image's mean where that is brighter: {dull}; in the mean "
        f"{float(of_means.max()):.1%}; open where a pixel's is over "
        f"{SHARP:.0%}",
    )


def _usage(data: xr.Dataset) -> Claim:
    noise = np.hypot(data.usage_error, data.contribution_error)
    lit = noise > 0
    far = critical(data, int(lit.sum()))
    z = (np.abs(data.usage - data.contribution) / noise).where(lit)
    equal = (np.abs(1 / data.usage.notnull().sum("technique") - data.contribution) / noise).where(lit)
    twin = float(equal.max("technique").min())
    shares = data.contribution.isel(edges=-1)
    return Claim(
        "plane.mmlt-usage",
        "MMLT's samples per technique are proportional to the technique's contribution",
        f"{SOURCE}, fig. 5 (there paths of length six)",
        verdict(float(z.max()) < far, True if twin > far else None),
        "holds",
        f"{float(z.max()):.1f} s.e. at most; shares of paths of {int(data.edges[-1])} edges from "
        f"{float(shares.min()):.1%} to {float(shares.max()):.1%}; equal shares, PSSMLT's, are {twin:.0f} s.e. off "
        "in any scene, or more",
        f"{far:.1f} s.e. (t of {int(data.runs)} chains, 1e-4 of {int(lit.sum())} shares); sees "
        f"{float(far * noise.max()):.1%} of all samples",
    )


def _effective(data: xr.Dataset) -> Claim:
    last = data.isel(edges=-1).assign_coords(chain=list(CHAINS))
    ratio, error = last.effective, last.effective_error
    mine, rivals = {"chain": "MMLT"}, {"chain": list(CHAINS[:2])}
    apart, noise = ratio.sel(mine) - ratio.sel(rivals), np.hypot(error.sel(mine), error.sel(rivals))
    far = critical(data, apart.size)
    higher = {
        str(name): _signed(apart.sel(scene=name).to_numpy(), far * noise.sel(scene=name).to_numpy())
        for name in data.scene.to_numpy()
    }
    return Claim(
        "plane.mmlt-effective-paths",
        "MMLT's effective path ratio is higher than PSSMLT's",
        f"{SOURCE}, sec. 5 (fig. 1's scene: 29.75 % against 11.81 %, 2.5 times)",
        among(higher),
        "holds",
        "; ".join(
            "{}: {MMLT:.1%} against {PSSMLT, max:.1%} ({by:.1f} times) and, with the sum, {PSSMLT, sum:.1%}; any "
            "technique {MMLT, any technique:.1%}".format(name, by=of["MMLT"] / of["PSSMLT, max"], **of)
            for name, of in (
                (str(name), dict(zip(CHAINS, ratio.sel(scene=name).to_numpy(), strict=True)))
                for name in data.scene.to_numpy()
            )
        ),
        f"{far:.1f} s.e. (t of {int(data.runs)} runs, 1e-4 of {apart.size} tests), {float(far * noise.max()):.2%}",
    )


def _signed(difference: np.ndarray, doubt: np.ndarray) -> bool | None:
    """Whether all differences are positive beyond doubt; False where one is negative beyond it."""
    return False if np.any(difference < -doubt) else True if np.all(difference > doubt) else None
