"""Table 1 in the plane as a figure, with a run of each algorithm above it, and as text."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.flatland import draw_scene
from experiments.support.flatland_table1 import REGIMES
from experiments.support.intervals import geometric, ratio
from experiments.support.stage_methods import METHODS
from mcmc1d.flatland.scenes import scene
from mcmc1d.perception import efficiency

HEADS = ("scene", "alg.", "rays", "shdw", "acc.", "var.", "skew", "kur.", "error", "eff.", "VErr.", "VEff.")
NOTE = "acc., var., error and VErr.: geometric means of the runs, as the ratios above, errors with 95 % intervals"

_PANELS = (
    ("PuOr", (0.25, 4), "image / exact (log)", ("black", "#00a5a5")),
    ("viridis", (0.1, 10), "samples / their mean (log)", ("white", "#e00000")),
)
"""Colours, limits, what is shown, and the colours of what is under and over the limits."""


def draw_table1(data: xr.Dataset, edges: dict[str, int]) -> Figure:
    """A row a scene: the scene, a run of each over the exact image, its samples, errors; below, the table."""
    rows = data.sizes["scene"]
    lines = rows * len(METHODS)
    heights = 1.75 * rows + 0.55, 0.105 * lines + 0.5
    figure = plt.figure(figsize=(7.0, sum(heights)))
    parts: Any = figure.subfigures(2, 1, height_ratios=heights)
    axes = parts[0].subplots(rows, 4, squeeze=False, width_ratios=(1.7, 2.6, 2.6, 2.6))
    shown: list[Any] = [None, None]
    for k, row in enumerate(axes):
        here, last = data.isel(scene=k), k == rows - 1
        name = str(here.scene.item())
        draw_scene(row[0], scene(name), legend=False)
        row[0].set_title(f"{name}, {edges[name]} edges\n(there: {REGIMES[name]})")
        truth, density = here.exact.to_numpy(), here.density.isel(run=0)
        films = here.image.isel(run=0).to_numpy() / truth, (density / density.mean("pixel")).to_numpy()
        for kind, (panel, values) in enumerate(zip(row[1:3], films, strict=True)):
            shown[kind] = _film(panel, values, kind)
            panel.set_yticks(range(len(METHODS)), list(METHODS) if kind == 0 else [])
            panel.set_xticks((0, 0.5, 1), ("0", "0.5", "1") if last else [])
            panel.set_xlabel("film" if last else "")
        _strip(row[1], truth)
        _errors(row[3], here)
    axes[0, 1].set_title("one run over the exact image", pad=24)
    axes[0, 2].set_title("its samples over their mean")
    axes[0, 3].set_title("error over that of MLT")
    axes[-1, 3].set_xlabel(f"ratio of geometric means\n({data.sizes['run']} runs, 95 % intervals)")
    axes[-1, 3].legend(loc="upper center", bbox_to_anchor=(0.5, -0.42), ncols=2, columnspacing=1.0)
    for kind, (_, (low, high), label, _) in enumerate(_PANELS):
        bar = parts[0].colorbar(
            shown[kind], ax=axes[:, 1 + kind], location="bottom", aspect=30, pad=0.02, extend="both", label=label
        )
        bar.set_ticks((low, 1, high), labels=[f"{t:g}" for t in (low, 1, high)])
        bar.ax.minorticks_off()
    _draw_table(parts[1].subplots(), data)
    return figure


def _film(panel: Axes, values: np.ndarray, kind: int) -> Any:
    """A row an algorithm; zero is under the limits, which a logarithm does not know."""
    cmap, (low, high), _, (under, over) = _PANELS[kind]
    colours = plt.get_cmap(cmap).with_extremes(under=under, over=over)
    where = (0, 1, len(METHODS) - 0.5, -0.5)
    panel.tick_params(axis="y", length=0)
    return panel.imshow(
        np.maximum(values, 1e-9),
        norm=LogNorm(low, high),
        cmap=colours,
        aspect="auto",
        extent=where,
        interpolation="none",
    )


def _strip(panel: Axes, truth: np.ndarray) -> None:
    strip = panel.inset_axes((0, 1.03, 1, 0.12))
    strip.imshow(np.log10(truth)[None], cmap="gray", aspect="auto")
    strip.set_yticks([0], ["exact, log"])
    strip.set(xticks=[])
    strip.tick_params(length=0)
    span = f"black {truth.min():.2g}, white {truth.max():.2g}"
    strip.text(0.5, 1.1, span, transform=strip.transAxes, ha="center", va="bottom", fontsize=5.5)


def _errors(axes: Axes, here: xr.Dataset) -> None:
    place, own = np.arange(len(METHODS)), METHODS.index("MLT")
    for shift, (column, color, label) in enumerate((("visual", "C0", "visual"), ("error", "C1", "squared"))):
        values = {m: here[column].sel(algorithm=m).to_numpy() for m in METHODS}
        middle, low, high = np.array([ratio(values[m], values["MLT"]) for m in METHODS]).T
        spread = np.array([middle - low, high - middle])
        spread[:, own] = 0  # against itself
        axes.errorbar(middle, place + 0.24 * shift - 0.12, xerr=spread, fmt="os"[shift], color=color,
                      markersize=3, capsize=1.5, linewidth=0.9, label=label)  # fmt: skip
    axes.axvline(1, color="0.6", linewidth=0.5)
    axes.set(xscale="log", ylim=(len(METHODS) - 0.5, -0.5))
    axes.set_yticks(place, [])
    low, high = axes.get_xlim()
    ticks = [t for t in (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()


def cells(data: xr.Dataset) -> list[list[str]]:
    """Table 1, a row an algorithm; see `NOTE`. Shadow rays, skew and kurtosis: arithmetic means of the runs."""
    rows = []
    for name in data.scene.to_numpy():
        for method in METHODS:
            here = data.sel(scene=name, algorithm=method)
            rays, relative = float(here.rays), {"error": float(here.exact.mean()) ** 2, "visual": 1.0}
            shadow, skew, kurtosis = (float(here[column].mean()) for column in ("shadow", "skew", "kurtosis"))
            errors = {column: geometric(here[column].to_numpy()) for column in relative}
            rows.append(
                [
                    str(name),
                    method,
                    f"{rays / 1000:.1f}k",
                    f"{shadow:.1%}" if np.isfinite(shadow) else "N/A",
                    "N/A" if method == "path" else f"{_middle(here.acceptance):.1%}",
                    *(f"{value:.3f}" for value in (_middle(here.variance), skew, kurtosis)),
                ]
            )
            for column, scale in relative.items():
                middle, _, high = (float(value) / scale for value in errors[column])
                rows[-1].append(f"{middle:.3g} ×÷{high / middle:.2f}")
                rows[-1].append(f"{float(efficiency(middle, rays)):.2e}")
    return rows


def _middle(values: xr.DataArray) -> float:
    """The geometric mean; zero where one of them is."""
    found = values.to_numpy()
    return float(np.exp(np.log(found).mean())) if np.all(found > 0) else 0.0


def _draw_table(axes: Axes, data: xr.Dataset) -> None:
    places = np.array([0, 8.5, 23, 30, 36.5, 43, 49.5, 56, 69.5, 78, 91, 100]) / 100
    rows = cells(data)
    axes.set(xlim=(0, 1), ylim=(len(rows) + 1.4, -1.1))
    axes.axis("off")
    for y, row in enumerate((HEADS, *rows), start=-1):
        for k, (x, text) in enumerate(zip(places, row, strict=True)):
            if k == 0 and y > 0 and y % len(METHODS):
                continue
            weight = "bold" if y < 0 else "normal"
            axes.text(x, y + 0.5, text, ha="left" if k < 2 else "right", va="center", fontsize=6, fontweight=weight)
    for y in range(0, len(rows) + 1, len(METHODS)):
        axes.axhline(y, color="0.4", linewidth=0.5)
    axes.text(0, len(rows) + 0.8, NOTE, ha="left", va="center", fontsize=6)


def table1(data: xr.Dataset) -> Table:
    """Table 1 with all its columns."""
    result = Table(*HEADS, box=SIMPLE, padding=0, title=f"flatland_hoberock: table 1, {data.sizes['run']} runs; {NOTE}")
    for row in cells(data):
        result.add_row(*row)
    return result


__all__ = ["cells", "draw_table1", "table1"]
