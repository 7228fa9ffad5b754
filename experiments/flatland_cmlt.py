"""Segovia et al. 2007, figure 5 in the plane: the size of the candidates' step, and what packets deposit."""

from dataclasses import dataclass
from typing import Literal, get_args

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import t as student

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.flatland.integrators import CoherentMLT
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene

Deposit = Literal["centre", "published", "chosen"]
NAMES = {"centre": "auxiliary centre", "published": "as published", "chosen": "two states"}
SIGMAS = (0.003, 0.01, 0.03, 0.1, 0.3)
SOURCE = "Segovia et al. 2007, sec. 7.1, fig. 5"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scene: str = "box"
    edges: int = 2
    pixels: int = 32
    tries: int = 64
    """Candidates of a packet."""
    length: int = 4
    """Steps of a sub-chain."""
    paths: int = 2048
    """That each chain traces, candidates, competitors and centres included."""
    chains: int = 512
    """Each of which makes an image: the error is that of one chain's."""
    runs: int = 8
    """Renderings, whose spread is the error's own error."""


PROFILES = {"quick": Config(), "paper": Config(runs=64)}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Each deposit at each size, several times."""
    of = scene(config.scene).with_pixels(config.pixels)
    exact = image(of, config.edges)
    deposits = get_args(Deposit)
    points = [(d, s, config.tries, config.length, config.paths, config.chains) for d in deposits for s in SIGMAS]
    shape = (len(deposits), len(SIGMAS), config.runs)
    mean, error = np.zeros((*shape, config.pixels)), np.zeros(shape)
    rays = np.zeros(shape)
    for k, point in enumerate(points):
        at = np.unravel_index(k, shape[:2])
        for r in range(config.runs):
            layer = rendered(*point, of, config.edges, jax.random.fold_in(jax.random.key(seed), 1000 * k + r))
            b = layer.normaliser
            factor = layer.scale * (1.0 if b is None else b.mean)
            mean[at][r] = layer.value
            error[at][r] = np.sqrt((factor**2 * layer.deposits.variance).mean())
            rays[at][r] = layer.rays / config.chains
        progress("sizes of the step", k + 1, len(points))
    dims = ("deposit", "sigma", "run")
    return xr.Dataset(
        {
            "mean": ((*dims, "pixel"), mean),
            "error": (dims, error),
            "rays": (dims, rays),
            "exact": ("pixel", exact.values[config.edges - 1]),
            "known": ("pixel", exact.errors[config.edges - 1]),
            "tries": config.tries,
        },
        {"deposit": list(deposits), "sigma": list(SIGMAS)},
    )


def rendered(deposit: Deposit, sigma: float, tries: int, length: int, paths: int, chains: int, of, edges, key) -> Layer:
    """The light of `edges` edges by chains that trace so many paths each, whatever a packet takes."""
    packet = tries if deposit == "centre" else 2 * tries - 1
    steps = max(1, round(paths / (1 + length * packet)))
    method = CoherentMLT(deposit=deposit, tries=tries, length=length, sigma=sigma, chains=chains)
    return method.render(key, of, edges, steps * chains)


def _bias(data: xr.Dataset, deposit: str) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel at the size where the mean over all runs is known best: relative to the exact one, with its s.e."""
    own = data.sel(deposit=deposit)
    sigma = own.error.mean("run").idxmin("sigma")
    values, exact = own["mean"].sel(sigma=sigma), data.exact.to_numpy()
    error = np.hypot(values.std("run", ddof=1).to_numpy() / np.sqrt(values.sizes["run"]), data.known.to_numpy())
    scale = np.maximum(exact, exact.mean())
    return (values.mean("run").to_numpy() - exact) / scale, error / scale


def draw(data: xr.Dataset) -> Figure:
    """One chain's error against the size; how far the mean of all chains is off."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 2.5))
    scale = float(data.exact.mean())
    for k, deposit in enumerate(data.deposit.to_numpy()):
        own = data.error.sel(deposit=deposit) / scale
        spread = own.std("run", ddof=1) / np.sqrt(data.sizes["run"])
        marks = {"color": f"C{(0, 1, 2)[k]}", "markersize": 3, "linewidth": 1, "label": NAMES[str(deposit)]}
        left.errorbar(data.sigma, own.mean("run"), 2 * spread, fmt="o^s"[k] + "-", **marks)
        if deposit != "chosen":
            bias, error = _bias(data, str(deposit))
            right.errorbar(np.arange(bias.size), bias, 2 * error, fmt="o^s"[k], **marks | {"linewidth": 0.7})
    left.set(xscale="log", yscale="log", xlabel="sigma of the candidates", ylabel="error of one chain / mean of image")
    left.set_title(f"{int(data.tries)} candidates, equal numbers of paths", fontsize=7)
    left.set_yticks([0.3, 0.5, 1, 2, 4], ["0.3", "0.5", "1", "2", "4"])
    left.set_xticks(data.sigma, [f"{s:g}" for s in data.sigma.to_numpy()])
    left.minorticks_off()
    left.legend()
    right.axhline(0, color="0.6", linewidth=0.6, zorder=0)
    right.yaxis.set_major_locator(MultipleLocator(0.04))
    right.yaxis.set_major_formatter("{x:+.0%}")
    right.set(xlabel="pixel", ylabel="mean of all chains, off by")
    right.legend()
    return figure


def table(data: xr.Dataset) -> Table:
    """The errors."""
    result = Table("deposit", *[f"sigma {s:g}" for s in data.sigma.to_numpy()], title="flatland_cmlt", box=SIMPLE)
    scale = float(data.exact.mean())
    for deposit in data.deposit.to_numpy():
        own = data.error.sel(deposit=deposit).mean("run") / scale
        result.add_row(NAMES[str(deposit)], *[f"{float(e):.2f}" for e in own])
    return result


def _ratio(above: xr.DataArray, below: xr.DataArray) -> tuple[float, float]:
    """Of two means over runs, and its standard error."""
    means, n = [part.mean("run").item() for part in (above, below)], above.sizes["run"]
    errors = [
        part.std("run", ddof=1).item() / np.sqrt(n) / mean for part, mean in zip((above, below), means, strict=True)
    ]
    ratio = means[0] / means[1]
    return ratio, ratio * float(np.hypot(*errors))


def judge(data: xr.Dataset) -> list[Claim]:
    """Too small an area is poor; too large a one as well; the published deposit misses the exact image."""
    found = []
    rays = f"{float(data.rays.min()):.0f} to {float(data.rays.max()):.0f} rays a chain"
    for name in ("centre", "published"):
        own = data.error.sel(deposit=name)
        best = own.mean("run").idxmin("sigma")
        ratio, error = _ratio(own.isel(sigma=0), own.sel(sigma=best))
        found.append((f"{NAMES[name]}: {ratio:.2f} ± {error:.2f} times that at {best.item():g}", ratio - 5 * error > 1))
    (bias, error), (fair, small) = (_bias(data, name) for name in ("published", "centre"))
    far = float(student.isf(1e-4 / (2 * fair.size), data.sizes["run"] - 1))
    k = int(np.argmax(np.abs(bias)))
    return [
        Claim(
            "plane.cmlt-small-sigma",
            f"Many candidates ({int(data.tries)}) in too small an area ({float(data.sigma[0]):g}) do poorly",
            SOURCE,
            verdict(all(true for _, true in found)),
            "holds",
            f"the error of one chain, {'; '.join(text for text, _ in found)}",
            f"5 s.e. of {data.sizes['run']} runs; {rays}",
        ),
        Claim(
            "plane.cmlt-published",
            "In the plane, all candidates deposited as published give the exact image",
            "Segovia et al. 2007, sec. 5.2",
            verdict(bool((np.abs(bias) <= 6 * error).all())),
            "fails",
            f"a pixel is off by {bias[k]:+.0%} ± {error[k]:.0%}",
            f"6 s.e. of {data.sizes['run']} runs",
        ),
        Claim(
            "plane.cmlt-centre",
            "In the plane, packets around an auxiliary centre do",
            "Tjelmeland 2004; Calderhead 2014",
            verdict(bool((np.abs(fair) <= far * small).all())),
            "holds",
            f"{float((np.abs(fair) / small).max()):.1f} standard errors at most",
            f"{far:.1f} s.e. of {data.sizes['run']} runs (t, family-wise 1e-4), {far * float(small.max()):.0%} at most",
        ),
    ]
