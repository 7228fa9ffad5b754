"""Noise-aware Metropolis: each step of its target, what it gains, and which estimate of the noise is right."""

from dataclasses import dataclass
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import spearmanr

from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, Ratio, ratio, shown, under
from experiments.support.scenes import glints, room, walk
from experiments.support.stage_methods import BRIGHT, DARK, PAPER
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.image import Film
from mcmc1d.perception import downsampled, noise_target, tvi, visual_error
from mcmc1d.rendering import Renderer, Scene
from mcmc1d.stages import MultiStage, NoiseAware, plan


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    replicas: int = 10
    """Seeds of each method, scene and exposure."""
    samples: int = 2**16
    runs: int = 96
    """Independent runs whose spread is the true error of a pixel."""
    run_samples: int = 2**13
    batches: int = 16


PROFILES = {"quick": Config(), "paper": Config(replicas=50, samples=2**18, runs=512, run_samples=2**16, batches=32)}

SCENES = {"room": room, "glints": glints}
METHODS = ("MLT", "multi-stage", "noise-aware, integral", "noise-aware, contribution")
LEVELS = {"bright": BRIGHT, "dark": DARK}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Visual errors at two exposures; estimates of the variance against the truth; the steps of one target."""
    key = jax.random.key(seed)
    visual = np.zeros((len(SCENES), len(LEVELS), len(METHODS), config.replicas))
    for i, make in enumerate(SCENES.values()):
        scene = make()
        exact = scene.exact()
        for k, method in enumerate(METHODS):
            film = None
            for j, level in enumerate(LEVELS.values()):
                exposure = level / exact.mean()
                if film is None or k > 1:  # only the noise-aware ones depend on the exposure
                    film = render(scene, method, config, exposure, jax.random.fold_in(key, 100 * i + 10 * j + k))
                visual[i, j, k] = visual_error(film.image(), exact, exposure)
                progress("visual error", (i * len(METHODS) + k) * len(LEVELS) + j + 1, visual[..., 0].size)
    estimates = _variances(config, jax.random.fold_in(key, 1000))
    progress("variance", 1, 1)
    steps = _steps(config, jax.random.fold_in(key, 2000))
    return xr.Dataset(
        {
            "visual": (("scene", "level", "algorithm", "replica"), visual),
            **{name: ("pixel", value) for name, value in estimates.items()},
            **{name: (("row", "column"), value) for name, value in steps.items()},
        },
        {"scene": list(SCENES), "level": list(LEVELS), "algorithm": list(METHODS)},
    )


def render(scene: Scene, method: str, config: Config, exposure: float, key) -> Film:
    """One method at the given work, b exact."""
    renderer, adapt = Renderer(scene, walk(), config.replicas, 4), MultiStage(scene.pixels)
    if method == "MLT":
        return renderer.plain(key, config.samples).film
    if method == "multi-stage":
        return renderer.render(key, plan(scene.pixels.side, config.samples), adapt).film
    kind = "integral" if method.endswith("integral") else "contribution"
    importance = NoiseAware(adapt, exposure, kind)
    return renderer.render(key, plan(scene.pixels.side, config.samples), importance).film


def _variances(config: Config, key) -> dict[str, np.ndarray]:
    """The variance of a pixel after one run: by independent runs; estimated within one, by batch means and by sums.

    A run is one chain, continued from batch to batch (`Renderer.batches`); the estimates are means over the runs.
    """
    scene = glints()
    renderer = Renderer(scene, walk(), config.runs, 1)
    films = renderer.batches(key, config.run_samples, config.batches)
    images = np.stack([film.image() for film in films])  # (batches, runs, pixels)
    whole = films[0]
    for film in films[1:]:
        whole = whole.plus(film)
    batch = images.var(0, ddof=1) / config.batches
    running = whole.variance("contribution") / whole.samples
    inside = whole.variance("integral") / whole.samples
    return {
        "exact": scene.exact(),
        "true_variance": whole.image().var(0, ddof=1),
        "batch_means": batch.mean(0),
        "running": running.mean(0),
        "inside": inside.mean(0),
        "batch_means_one": batch[0],
        "running_one": running[0],
        "inside_one": inside[0],
    }


def _steps(config: Config, key) -> dict[str, np.ndarray]:
    """The steps of figure 5, of one seed of the room halfway, at the full resolution."""
    scene = room()
    renderer = Renderer(scene, walk(), 1, 4)
    side, exposure = scene.pixels.side, LEVELS["bright"] / scene.exact().mean()
    film = renderer.render(key, plan(side, config.samples // 2), MultiStage(scene.pixels)).film
    mean, variance = film.image().reshape(1, side, side), film.variance().reshape(1, side, side)
    return {
        "step_mean": mean[0],
        "step_rms": np.sqrt(variance)[0],
        "step_tvi": tvi(exposure * downsampled(mean, 2, 4))[0],
        "step_visible": (np.sqrt(variance) / tvi(exposure * downsampled(mean, 2, 4)))[0],
        "step_target": noise_target(mean, variance, 2, exposure=exposure)[0],
    }


def draw(data: xr.Dataset) -> Figure:
    """The steps of the target; below, visual errors, and the estimates of the variance against the truth."""
    figure = plt.figure(figsize=(7.0, 3.6))
    parts: Any = figure.subfigures(2, 1, height_ratios=(1, 1.35))
    upper, lower = parts
    steps = {
        "step_mean": "mean, log",
        "step_rms": "RMS, log",
        "step_tvi": "tvi, downsampled, log",
        "step_visible": "RMS / tvi, log",
        "step_target": "limited, clamped, filtered",
    }
    for axis, (name, title) in zip(upper.subplots(1, len(steps)), steps.items(), strict=True):
        values = data[name].to_numpy()
        small = values[values > 0].min() if np.any(values > 0) else 1.0
        shown = axis.imshow(np.log10(np.maximum(values, small)).T if "log" in title else values.T, origin="lower")
        axis.set(xticks=[], yticks=[])
        axis.set_title(title, fontsize=6)
        bar = upper.colorbar(shown, ax=axis, shrink=0.75, pad=0.02)
        bar.ax.tick_params(labelsize=5)
    left, right = lower.subplots(1, 2, width_ratios=(1.25, 1))
    place, labels = 0, []
    for scene in data.scene.to_numpy():
        for level in data.level.to_numpy():
            here = data.visual.sel(scene=scene, level=level)
            plain = here.sel(algorithm="MLT").to_numpy()
            for k, method in enumerate(METHODS[1:]):
                middle, low, high = ratio(here.sel(algorithm=method).to_numpy(), plain)
                x = place + 0.27 * (k - 1)
                left.bar(x, middle, 0.25, color=f"C{k}", label=method if place == 0 else None)
                left.errorbar(x, middle, [[middle - low], [high - middle]], color="black", linewidth=0.7)
            labels.append(f"{scene}\n{level}")
            place += 1
    left.axhline(1, color="0.5", linewidth=0.5)
    left.set_xticks(range(place), labels)
    left.set(ylabel="visual error / that of MLT", title="equal work, 95 % intervals")
    left.set_ylim(0, 1.25 * left.get_ylim()[1])
    left.legend(loc="upper left", ncols=3)
    x = (np.arange(data.sizes["pixel"]) + 0.5) / data.sizes["pixel"]
    truth = data.true_variance.to_numpy()
    styles = {
        "batch_means": ("C0", "batch means"),
        "running": ("C1", "of f / p, running"),
        "inside": ("C2", "of f in the pixel, running (Eq. 2)"),
    }
    for name, (colour, label) in styles.items():
        right.plot(x, data[name] / truth, color=colour, linewidth=0.9, label=label)
    right.axhline(1, color="0.5", linewidth=0.5)
    right.set(xlabel="x (glints; hard paths on the right half)", ylabel="estimated / true variance of a pixel")
    right.set(yscale="log", xlim=(0, 1), ylim=(1e-6, 4), title="batch means and running variances")
    right.legend(loc="lower right")
    return figure


def _agreement(data: xr.Dataset, name: str) -> tuple[float, float, float]:
    """Estimate / truth: its geometric mean, and how far it varies over the pixels; one run's rank correlation.

    How far: the 95th percentile over the 5th, 1 where estimate and truth are proportional.
    """
    truth = data.true_variance.to_numpy()
    found = data[name].to_numpy() / truth
    low, high = np.percentile(found, [5, 95])
    rank: Any = spearmanr(data[f"{name}_one"].to_numpy(), truth)
    return float(np.exp(np.mean(np.log(found)))), float(high / low), float(rank.statistic)


def table(data: xr.Dataset) -> Table:
    """Visual errors, and how the estimates of the variance agree with the truth."""
    result = Table("scene", "level", *METHODS, box=SIMPLE)
    result.title = f"noise_aware: visual error in just noticeable differences, {data.sizes['replica']} seeds"
    for scene in data.scene.to_numpy():
        for level in data.level.to_numpy():
            here = data.visual.sel(scene=scene, level=level)
            cells = (f"{float(here.sel(algorithm=m).mean()):.4g}" for m in METHODS)
            result.add_row(str(scene), str(level), *cells)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Where noise-aware helps, where it does not, and which estimate of the variance is right."""
    held = f"95 % t interval, {data.sizes['replica']} seeds; that of {1 - DECIDES:.2%} decides"

    def against(scene: str, level: str, other: str, miss: float = 0.05) -> Ratio:
        here = data.visual.sel(scene=scene, level=level)
        return ratio(here.sel(algorithm=METHODS[2]).to_numpy(), here.sel(algorithm=other).to_numpy(), miss)

    claims = [
        Claim(
            f"imp.noise-aware-{scene}",
            f"Noise-aware lowers the visual error against plain MLT at equal work, in the light ({scene})",
            f"{PAPER}, table 1",
            verdict(under(1, against(scene, "bright", "MLT", DECIDES))),
            "holds",
            f"times {shown(against(scene, 'bright', 'MLT'))}; against multi-stage times "
            f"{shown(against(scene, 'bright', 'multi-stage'))}",
            held,
        )
        for scene in SCENES
    ]
    batch, running, inside = (_agreement(data, name) for name in ("batch_means", "running", "inside"))
    return [
        *claims,
        Claim(
            "imp.noise-aware-dark",
            "Noise-aware lowers the visual error in the dark as well, where the eye's threshold is constant (room)",
            f"ours; {PAPER}, sec. 5.3",
            verdict(under(1, against("room", "dark", "MLT", DECIDES))),
            "fails",
            f"times {shown(against('room', 'dark', 'MLT'))}",
            held,
        ),
        Claim(
            "imp.running-variance",
            "The running variance is proportional to the squared error of the pixels, unlike batch means (glints)",
            f"{PAPER}, sec. 4.3.3 to 4.3.5",
            "open" if not 0.5 < batch[0] < 1.5 else "fails" if min(running[1], inside[1]) > 2 * batch[1] else "holds",
            "fails",
            f"of the true variance: batch means {batch[0]:.2f} on average, 95th over 5th percentile {batch[1]:.1f}; "
            f"running {running[0]:.2f}, {running[1]:.0f} (f / p) and {inside[0]:.3f}, {inside[1]:.0f} (Eq. 2); rank "
            f"correlation of one run {batch[2]:.2f}, {running[2]:.2f}, {inside[2]:.2f}",
            f"{data.sizes['pixel']} pixels; twice the batch means' percentiles, which must be right on average",
        ),
    ]
