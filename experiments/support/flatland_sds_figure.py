"""The figure of `flatland_sds`."""

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.support.flatland import draw_paths, draw_scene
from mcmc1d.flatland import Scene

STYLES = {"MMLT": ("C0", "-"), "MLT": ("C1", "--"), "MLT, manifold": ("C3", "-.")}
PHOTONS = "C2"


def figure(data: xr.Dataset, scene: Scene) -> Figure:
    """Above: the scene, what runs see, the bias; below: errors against rays, a panel a lamp."""
    result, axes = plt.subplots(2, 3, figsize=(7.0, 4.6))
    draw_scene(axes[0, 0], scene)
    draw_paths(axes[0, 0], data.path.to_numpy(), linewidth=0.4, alpha=0.7)
    axes[0, 0].set_title("mirror, floor, mirror")
    _images(axes[0, 1], data)
    _bias(axes[0, 2], data)
    for k, (panel, width) in enumerate(zip(axes[1], data.width.to_numpy(), strict=False)):
        _errors(panel, data.sel(edges=4, width=width))
        panel.set(title=f"in the mirror, lamp of {width:g}", xlabel="rays", ylabel="" if k else "RMS error (% of mean)")
    low = min(panel.get_ylim()[0] for panel in axes[1])
    high = max(panel.get_ylim()[1] for panel in axes[1])
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000) if low < tick < high]
    for panel in axes[1]:
        panel.set_ylim(low, high)
        panel.set_yticks(ticks, [str(tick) for tick in ticks])
        panel.set_xticks(data.budget.to_numpy(), [str(rays) for rays in data.budget.to_numpy()])
        panel.minorticks_off()
    handles, labels = axes[1, 0].get_legend_handles_labels()
    result.legend(handles, labels, loc="outside lower center", ncols=4)
    return result


def _images(panel: Axes, data: xr.Dataset) -> None:
    """Of the narrowest lamp: the exact image, and the band of the middle half of the runs."""
    here = data.sel(edges=4).isel(width=int(np.argmin(data.width.to_numpy())))
    pixel = np.arange(data.sizes["pixel"] + 1)
    photons = here.photon_film.sel(radius=data.of, method="nearest")
    for name, film, color in (("photons", photons, PHOTONS), ("MMLT", here.film.sel({"method": "MMLT"}), "C0")):
        low, middle, high = (film.quantile(q, "run") for q in (0.25, 0.5, 0.75))
        panel.stairs(high, pixel, baseline=low.to_numpy(), fill=True, color=color, alpha=0.3)
        panel.stairs(middle, pixel, color=color, label=f"{name}, median of runs")
    panel.stairs(here.reference, pixel, color="black", linestyle=":", label="exact")
    panel.set(xlabel="pixel", ylabel="radiance", title=f"in the mirror, lamp of {float(here.width):g}", xlim=(14, 32))
    panel.set_ylim(0, 1.6 * float(here.reference.max()))
    panel.legend(loc="upper left")


def _bias(panel: Axes, data: xr.Dataset) -> None:
    """What was found less what is exact, and what is predicted."""
    here = data.sel(edges=4, width=data.middle)
    place = np.arange(data.sizes["pixel"]) + 0.5
    for k, radius in enumerate(data.radius.to_numpy()):
        one = here.sel(radius=radius)
        color = f"C{k}"
        panel.plot(place, one.predicted - one.reference, color=color)
        off = one.photons - one.reference
        panel.errorbar(place, off, 2 * one.photons_error, fmt=".", color=color, markersize=3, label=f"{radius:g}")
    panel.set(xlabel="pixel", ylabel="photons less exact", title="bias by radius; lines: predicted", xlim=(14, 32))
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.5 * (high - low))  # room for the legend
    panel.legend(loc="upper left", ncols=2, title="radius", title_fontsize=6)


def _errors(panel: Axes, data: xr.Dataset) -> None:
    """Root mean square errors of all runs; of photons one line for each radius; thin: chains to which b is known."""
    for method, (color, dashes) in STYLES.items():
        of = {"method": method}
        error = 100 * np.sqrt(data.mse.sel(of).mean("run"))
        panel.plot(data.budget, error, color=color, linestyle=dashes, marker="o", markersize=3, label=method)
        known = 100 * np.sqrt(data.mse_known.sel(of).mean("run"))
        label = "thin: b known" if method == "MMLT" else None
        panel.plot(data.budget, known, color=color, linestyle=dashes, linewidth=0.5, label=label)
    for k, radius in enumerate(data.radius.to_numpy()):
        error = 100 * np.sqrt(data.photon_mse.sel(radius=radius).mean("run"))
        mark = "sv^Dxo"[k % 6]
        panel.plot(data.budget, error, color=PHOTONS, marker=mark, markersize=3, label=f"photons, radius {radius:g}")
    panel.set(xscale="log", yscale="log")


__all__ = ["figure"]
