"""What Hachisuka et al. 2014 say of manifold exploration, held to runs in the plane, and its figure."""

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from scipy.stats import t as student

from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, ratio, shown, under
from experiments.support.verdict import among, verdict

SOURCE = "Hachisuka et al. 2014"
# What was found in the plane, where theory says nothing; the second scene is the paper's kind.
_EXPECTED = {
    "mmlt-against-mlt-manifold": "fails",
    "manifold-against-mmlt": "holds if the scene is mirror_caustic",
}
STYLES = {
    "MMLT": ("C0", "-", "o"),
    "MMLT, manifold": ("C0", "--", "s"),
    "MLT": ("C1", "-", "^"),
    "MLT, manifold": ("C1", "--", "v"),
}


def claims(data: xr.Dataset, methods: Sequence[str], twin: str) -> list[Claim]:
    """Exact images, seen by a twin that is wrong; squared errors at the most rays, in pairs of methods."""
    names, runs = [str(name) for name in data.scene.to_numpy()], data.sizes["run"]
    last = data.mse.isel(budget=-1)
    pairs = (
        ("manifold-mlt", "Manifold steps lower the squared error of original MLT", "sec. 5, fig. 7", 3, 2),
        ("mmlt-against-mlt-manifold", "MMLT's squared error is lower than original MLT's", "sec. 5, fig. 7", 0, 2),
        (
            "manifold-against-mmlt",
            "MMLT does not outperform manifold exploration: MLT with it errs less",
            "sec. 5",
            3,
            0,
        ),
        ("mmlt-manifold", "Manifold steps lower the squared error of MMLT", "sec. 7 (left open there); ours", 1, 0),
    )
    miss = DECIDES / (len(pairs) * len(names))
    found = [_exact(data, list(methods), twin)]
    for name, statement, where, above, below in pairs:
        both = {
            scene: [last.sel({"scene": scene, "method": methods[m]}).to_numpy() for m in (above, below)]
            for scene in names
        }
        found.append(
            Claim(
                f"plane.{name}",
                f"{statement}, at equal rays",
                f"{SOURCE}, {where}",
                among({scene: under(1, ratio(a, b, miss)) for scene, (a, b) in both.items()}),
                _EXPECTED.get(name, "holds"),
                "; ".join(
                    f"{scene}: times {shown(ratio(a, b))}, of means {a.mean() / b.mean():.2f}"
                    for scene, (a, b) in both.items()
                )
                + f"; {int(data.budget[-1]):.2g} rays",
                f"geometric means of {runs} runs, t interval shown of 95 %, deciding at {DECIDES:g} of all comparisons",
            )
        )
    return found


_SHARP = 0.1
"""Of the image's mean: the error that must be seen in any pixel, or nothing was decided."""


def _exact(data: xr.Dataset, methods: list[str], twin: str) -> Claim:
    """Every method in every pixel; the twin is to be seen in one scene at least, or nothing was decided."""
    off = np.abs(data.bias) / (data.bias_error + data.reference_error)
    cells = data.sizes["scene"] * len(methods) * data.sizes["pixel"]
    level = float(student.isf(DECIDES / (2 * cells), data.sizes["run"] - 1))
    right, wrong = float(off.sel({"method": methods}).max()), off.sel({"method": twin}).max("pixel")
    sees = float((level * data.bias_error.sel({"method": methods}) + data.reference_error).max())
    seen = bool((wrong > level).any()) and sees <= _SHARP
    return Claim(
        "plane.manifold-exact",
        "MMLT and MLT, with manifold steps and without, agree with the exact image in every pixel",
        "ours, flatland",
        "fails" if right > level else verdict(True if seen else None),
        "holds",
        f"{right:.1f} standard errors at most; MLT without its proposals' densities (a twin) "
        + ", ".join(f"{float(z):.0f} in {name}" for name, z in zip(data.scene.to_numpy(), wrong, strict=True)),
        f"{level:.1f} s.e. of {data.sizes['run']} runs (t, family-wise {DECIDES:g}), {sees:.0%} of the mean in the "
        f"worst pixel (open above {_SHARP:.0%})",
    )


def figure(data: xr.Dataset, methods: Sequence[str]) -> Figure:
    """A panel a scene, of error against rays with the runs' middle half; below, acceptance and autocorrelation time."""
    scenes = data.sizes["scene"]
    result, axes = plt.subplots(1, scenes + 2, figsize=(7.0, 2.4), width_ratios=[1.3] * scenes + [1, 1])
    for k, name in enumerate(data.scene.to_numpy()):
        for method in methods:
            color, dashes, mark = STYLES[method]
            error = 100 * np.sqrt(data.mse.sel({"scene": name, "method": method}))
            low, high = (error.quantile(q, "run") for q in (0.25, 0.75))
            axes[k].fill_between(data.budget, low, high, color=color, alpha=0.12, linewidth=0)
            mean = np.sqrt((error**2).mean("run"))
            axes[k].plot(data.budget, mean, color=color, linestyle=dashes, marker=mark, markersize=3, label=method)
        axes[k].set(xscale="log", yscale="log", xlabel="rays", title=str(name))
        _plain(axes[k].yaxis, (2, 5, 10, 20, 30, 50, 100, 200))
        _plain(axes[k].xaxis, data.budget.to_numpy().tolist())
    axes[0].set_ylabel("RMS error (% of mean)")
    place, last = np.arange(len(methods)), data.isel(edges=-1)
    for k, name in enumerate(data.scene.to_numpy()):
        here, shift = last.sel(scene=name), 0.4 * (k - (scenes - 1) / 2)
        shade = str(0.35 + 0.35 * k)
        for kind, hatch in (("other", ""), ("manifold", "////")):
            rates = 100 * here.accepted.sel({"method": list(methods), "kind": kind}).to_numpy()
            offset = shift + (0.1 if kind == "manifold" else -0.1)
            axes[-2].bar(place + offset, rates, 0.18, color=shade, hatch=hatch, edgecolor="white", linewidth=0.3)
        axes[-1].bar(place + shift, here.time.sel({"method": list(methods)}), 0.36, color=shade, label=str(name))
    for panel in axes[-2:]:
        panel.set_xticks(place, [m.replace(", ", ",\n") for m in methods], rotation=90)
        panel.minorticks_off()
    edges = int(data.edges[-1])
    axes[-2].set(ylabel="accepted (%)", title=f"acceptance, {edges} edges\n(hatched: manifold steps)")
    axes[-1].set(yscale="log", ylabel="mutations", title=f"autocorrelation time,\n{edges} edges")
    axes[-1].set_ylim(top=4 * axes[-1].get_ylim()[1])
    _plain(axes[-1].yaxis, (10, 20, 50, 100, 200, 500))
    axes[-1].legend(loc="upper right")
    handles, labels = axes[0].get_legend_handles_labels()
    result.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return result


def _plain(axis: Axis, ticks: Sequence[float]) -> None:
    """Those of the ticks that lie on the axis, as plain numbers, and no others."""
    low, high = axis.get_view_interval()
    shown_ticks = [tick for tick in ticks if low <= tick <= high]
    axis.set_ticks(shown_ticks, labels=[f"{tick:g}" for tick in shown_ticks])
    axis.set_minor_locator(NullLocator())


__all__ = ["claims", "figure"]
