"""Paths per second of every integrator of flatland, by one core's own time: what a mutation or a sample costs."""

import time
from dataclasses import dataclass
from functools import partial
from statistics import median

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import INTEGRATORS
from mcmc1d.flatland.integrators.base import exposed
from mcmc1d.flatland.integrators.chains import EachChain, Metropolised
from mcmc1d.flatland.scenes import scene

_CHAINS = 4096
_AIM = 5e6

ALONE = True
"""It measures time: nothing may run beside it."""


@dataclass(frozen=True)
class Config:
    """The experiment's numbers; scenes and integrators are names, or "all"."""

    scenes: str = "box"
    integrators: str = "bdpt mmlt rjmlt"
    edges: int = 3
    log2_samples: int = 20
    rounds: int = 3


PROFILES = {
    "quick": Config(),
    "paper": Config(scenes="box door", integrators="all", log2_samples=22, rounds=5),
}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Time each, one after the other on one core; compilation is left out."""
    scenes = config.scenes.split()
    names = list(INTEGRATORS) if config.integrators == "all" else config.integrators.split()
    points = [(s, name, config.edges, config.log2_samples, config.rounds, seed) for s in scenes for name in names]
    rates = progress.map("speed", rate, points, timed=True)
    return xr.Dataset(
        {"rate": (("scene", "integrator"), np.array(rates).reshape(len(scenes), len(names))), "edges": config.edges},
        {"scene": scenes, "integrator": names},
    )


def rate(name: str, integrator: str, edges: int, log2_samples: int, rounds: int, seed: int) -> float:
    """Paths or mutations per second of processor time, the median of rounds; where one u makes all paths, of u."""
    make = INTEGRATORS[integrator]
    paths, samples = Paths(scene(name), edges), 2**log2_samples
    target, key = make.target(paths), jax.random.key(seed)
    if isinstance(make, Metropolised):
        kernel, start, steps = make.kernel(), mcmc1d.exact_start(key, target, _CHAINS), samples // _CHAINS
        options = {"steps": steps, "chains": _CHAINS, "blocks": 1, "start": start}
        film = {"film": EachChain(paths, _CHAINS)}
        work = partial(mcmc1d.run, kernel=kernel, target=target, estimators=film, **options)
    else:
        work = partial(exposed, target=target, paths=paths, samples=samples, bound=1.0)
    work(jax.random.key(0))
    spent = []
    for k in range(rounds):
        begin = time.process_time()
        work(jax.random.key(k + 1))
        spent.append(time.process_time() - begin)
    return samples / median(spent)


def draw(data: xr.Dataset) -> Figure:
    """Bars, by scene."""
    figure, axes = plt.subplots(figsize=(3.4, 2.4))
    names, width = data.integrator.to_numpy(), 0.8 / data.sizes["scene"]
    for k, name in enumerate(data.scene.to_numpy()):
        axes.bar(np.arange(len(names)) + k * width, data.rate[k] / 1e6, width, label=str(name))
    axes.axhline(_AIM / 1e6, color="0.6", linewidth=0.7, linestyle="--")
    axes.set_xticks(np.arange(len(names)) + 0.4 - width / 2, [str(n) for n in names], rotation=45, ha="right")
    axes.minorticks_off()
    axes.set_ylabel("10⁶ paths a second of one core")
    axes.legend()
    return figure


def table(data: xr.Dataset) -> Table:
    """Millions a second."""
    result = Table("scene", *[str(n) for n in data.integrator.to_numpy()], title="flatland_speed, 10^6/s", box=SIMPLE)
    for k, name in enumerate(data.scene.to_numpy()):
        result.add_row(str(name), *[f"{float(r) / 1e6:.2f}" for r in data.rate[k]])
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """None: how fast a machine is is no claim. The dashed line is what we aim at for MMLT."""
    return []
