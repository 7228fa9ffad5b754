"""Hoberock and Hart 2010, table 1, in the plane: six algorithms at equal rays, with all of its columns."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.flatland import draw_scene
from experiments.support.flatland_stages import METHODS, Contest, Images
from experiments.support.flatland_table1 import claims
from experiments.support.framework import Claim
from experiments.support.intervals import ratio
from experiments.support.sweep import Sweep
from mcmc1d.flatland.integrators import BidirectionalPathTracing, PathTracing
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene
from mcmc1d.numerics import require
from mcmc1d.perception import density_statistics, efficiency, error, visual_error

SOURCE = "Hoberock and Hart 2010"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "box door"
    pixels: int = 32
    runs: int = 16
    at_once: int = 16
    """Runs that one program does side by side."""
    samples: int = 2**13
    """Paths and mutations of each run: rays, divided by the edges of a path."""
    chains: int = 8
    """Of each run."""
    sigma: float = 0.05
    large: float = 0.1
    length: int = 100
    """Of a chain of ERPT, as in the paper."""
    shadows: int = 2**9
    """Proposals of each run that are looked at for their shadow rays."""
    level: float = 6.0
    """Standard errors by which what agrees may differ."""


PROFILES = {
    "quick": Config(),
    "paper": Config(scenes="box lab door three_rooms", runs=256, samples=2**15, shadows=2**11),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

SCENES = {
    "box": (3, PathTracing()),
    "lab": (3, PathTracing()),
    "door": (4, BidirectionalPathTracing()),
    "three_rooms": (5, BidirectionalPathTracing()),
}
"""The edges of the paths, and what makes them: path tracing, but where the camera is far from the light, as there."""
BRIGHT = 50.0
"""The mean of the image in cd/m^2, as a display shows it."""
PARTS = ("image", "density", "acceptance", "shadow")
COLUMNS = ("shadow", "acceptance", "variance", "skew", "kurtosis", "error", "visual")


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Every algorithm on every scene."""
    names = config.scenes.split()
    points = [(name, method, asdict(config), seed) for name in names for method in METHODS]
    exact = dict(zip(names, progress.map("references", reference, [(n, config.pixels) for n in names]), strict=True))
    found = progress.map("algorithms", measure, [(*point, exact[point[0]]) for point in points])
    shape = len(names), len(METHODS), config.runs

    def part(of: str, *more: int) -> np.ndarray:
        return np.array([one[of] for one in found], np.float64).reshape(*shape, *more)

    images, density = part("image", config.pixels), part("density", config.pixels)
    truth = np.array([exact[name] for name in names])
    moments = density_statistics(density)
    columns = {
        "shadow": part("shadow"),
        "acceptance": part("acceptance"),
        **moments._asdict(),
        "error": error(images, truth[:, None, None]),
        "visual": visual_error(images, truth[:, None, None], (BRIGHT / truth.mean(-1))[:, None, None, None]),
    }
    cells = ("scene", "algorithm", "run")
    return xr.Dataset(
        {
            **{name: (cells, value) for name, value in columns.items()},
            "image": ((*cells, "pixel"), images),
            "density": ((*cells, "pixel"), density),
            "exact": (("scene", "pixel"), truth),
            "rays": (("scene", "algorithm"), np.array([one["rays"] for one in found]).reshape(shape[:2])),
            "level": config.level,
        },
        {"scene": names, "algorithm": list(METHODS)},
    )


def reference(name: str, pixels: int) -> list[float]:
    """The exact image of the scene's path length."""
    return image(scene(name).with_pixels(pixels), SCENES[name][0]).values[-1].tolist()


def measure(name: str, method: str, fields: dict[str, Any], seed: int, exact: list[float]) -> dict[str, Any]:
    """All runs of one algorithm on one scene: what JSON can hold of them."""
    c, (edges, of) = Config(**fields), SCENES[name]
    shown = scene(name).with_pixels(c.pixels)
    common = np.array(exact), c.at_once, c.samples, c.chains, c.sigma, c.large, c.length, c.shadows
    contest = Contest(shown, edges, of, *common)
    key = jax.random.fold_in(jax.random.key(seed), METHODS.index(method) + 100 * sum(name.encode()))
    made: Callable[..., Images] = {"path": contest.path, "ERPT": contest.redistribution}.get(
        method, lambda key: contest.staged(key, method)
    )
    require(c.runs % c.at_once == 0, f"runs, {c.runs}, must be a multiple of at_once, {c.at_once}")
    found = [made(jax.random.fold_in(key, k)) for k in range(c.runs // c.at_once)]
    rays = edges * np.mean([one.samples for one in found])
    parts = {part: np.concatenate([getattr(one, part) for one in found]).tolist() for part in PARTS}
    return {"rays": float(rays), **parts}


def draw(data: xr.Dataset) -> Figure:
    """A row a scene: the scene, a run of each over the exact image, its samples, errors; below, the table."""
    rows = data.sizes["scene"]
    lines = rows * len(METHODS)
    figure = plt.figure(figsize=(7.0, 1.75 * rows + 0.105 * lines + 0.55))
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.75 * rows + 0.2, 0.105 * lines + 0.35))
    axes = parts[0].subplots(rows, 4, squeeze=False, width_ratios=(2.0, 2.6, 2.6, 2.6))
    shown: list[Any] = [None, None]
    for k, row in enumerate(axes):
        here = data.isel(scene=k)
        name = str(here.scene.item())
        draw_scene(row[0], scene(name), legend=False)
        row[0].set_title(f"{name}, {SCENES[name][0]} edges")
        truth = here.exact.to_numpy()
        images, density = here.image.isel(run=0).to_numpy() / truth, here.density.isel(run=0)
        even = (density / density.mean("pixel")).to_numpy()
        for panel, values, cmap, limits in ((row[1], images, "PuOr", (0.5, 2)), (row[2], even, "viridis", (0.1, 10))):
            norm = LogNorm(*limits)
            kind = 0 if panel is row[1] else 1
            shown[kind] = panel.imshow(np.clip(values, *limits), norm=norm, cmap=cmap, aspect="auto")
            panel.set_yticks(range(len(METHODS)), list(METHODS) if kind == 0 else [])
            panel.set(xticks=[], xlabel="film" if k == rows - 1 else "")
            panel.tick_params(length=0)
        place = np.arange(len(METHODS))
        for shift, (column, color, label) in enumerate(
            (("visual", "C0", "visual error"), ("error", "C1", "squared error"))
        ):
            found = [ratio(here[column].sel(algorithm=m).to_numpy(), _of(here, column)) for m in METHODS]
            middle, low, high = np.array(found).T
            own = METHODS.index("MLT")
            spread = np.array([middle - low, high - middle])
            spread[:, own] = 0  # against itself
            row[3].errorbar(middle, place + 0.24 * shift - 0.12, xerr=spread, fmt="os"[shift], color=color,
                            markersize=3, capsize=1.5, linewidth=0.9, label=label)  # fmt: skip
        row[3].axvline(1, color="0.6", linewidth=0.5)
        row[3].set(xscale="log", ylim=(len(METHODS) - 0.5, -0.5))
        row[3].set_yticks(place, list(METHODS))
        strip = row[1].inset_axes((0, 1.03, 1, 0.12))
        strip.imshow(np.log10(truth)[None], cmap="gray", aspect="auto")
        strip.set_yticks([0], ["exact"])
        strip.set(xticks=[])
        strip.tick_params(length=0)
        ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if _inside(t, row[3].get_xlim())]
        row[3].set_xticks(ticks, [f"{t:g}" for t in ticks])
        row[3].minorticks_off()
    axes[0, 1].set_title("one run over the exact image", pad=18)
    axes[0, 2].set_title("its samples over their mean")
    axes[0, 3].set_title("error over that of MLT")
    axes[-1, 3].set_xlabel(f"{data.sizes['run']} runs, 95 % intervals")
    axes[-1, 3].legend(loc="upper center", bbox_to_anchor=(0.5, -0.32), ncols=2)
    for kind, ticks in ((0, (0.5, 1, 2)), (1, (0.1, 1, 10))):
        bar = parts[0].colorbar(shown[kind], ax=axes[:, 1 + kind], location="bottom", aspect=30, pad=0.02)
        bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
        bar.ax.minorticks_off()
    _draw_table(parts[1].subplots(), data)
    return figure


def _of(here: xr.Dataset, column: str) -> np.ndarray:
    return here[column].sel(algorithm="MLT").to_numpy()


def _inside(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


HEADS = ("scene", "alg.", "rays", "shdw", "acc.", "var.", "skew", "kur.", "error", "eff.", "VErr.", "VEff.")


def cells(data: xr.Dataset) -> list[list[str]]:
    """Table 1, a row an algorithm: means of the runs, and of the errors also the standard error of that mean."""
    rows = []
    for name in data.scene.to_numpy():
        for method in METHODS:
            here = data.sel(scene=name, algorithm=method)
            mean = {column: float(here[column].mean()) for column in COLUMNS}
            spread = {column: float(here[column].std(ddof=1)) / here.sizes["run"] ** 0.5 for column in COLUMNS}
            rays, relative = float(here.rays), float(here.exact.mean()) ** 2
            rows.append(
                [
                    str(name),
                    method,
                    f"{rays / 1000:.1f}k",
                    f"{mean['shadow']:.1%}",
                    "N/A" if method == "path" else f"{mean['acceptance']:.1%}",
                    *(f"{mean[column]:.3f}" for column in ("variance", "skew", "kurtosis")),
                    f"{mean['error'] / relative:.4f}±{spread['error'] / relative:.4f}",
                    f"{float(efficiency(mean['error'] / relative, rays)):.2e}",
                    f"{mean['visual']:.3f}±{spread['visual']:.3f}",
                    f"{float(efficiency(mean['visual'], rays)):.2e}",
                ]
            )
    return rows


def _draw_table(axes: Any, data: xr.Dataset) -> None:
    places = np.array([0, 7.5, 20, 27, 33.5, 40.5, 47.5, 54.5, 67.5, 77, 89.5, 100]) / 100
    rows = cells(data)
    axes.set(xlim=(0, 1), ylim=(len(rows) + 0.4, -1.1))
    axes.axis("off")
    for y, row in enumerate((HEADS, *rows), start=-1):
        for k, (x, text) in enumerate(zip(places, row, strict=True)):
            if k == 0 and y > 0 and y % len(METHODS):
                continue
            weight = "bold" if y < 0 else "normal"
            axes.text(x, y + 0.5, text, ha="left" if k < 2 else "right", va="center", fontsize=6, fontweight=weight)
    for y in range(0, len(rows) + 1, len(METHODS)):
        axes.axhline(y, color="0.4", linewidth=0.5)


def table(data: xr.Dataset) -> Table:
    """Table 1 with all its columns; errors over the square of the mean."""
    result = Table(*HEADS, box=SIMPLE, padding=0, title=f"flatland_hoberock: table 1, {data.sizes['run']} runs")
    for row in cells(data):
        result.add_row(*row)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """What the paper says of its table, each against the runs."""
    return claims(data, SOURCE)
