"""Paths per second of every integrator of flatland, by one core's own time, and how much of the core that takes."""

import time
from dataclasses import dataclass
from functools import partial
from statistics import median

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim, chosen
from experiments.support.roofline import operations, roof
from experiments.support.sweep import Sweep
from mcmc1d.estimators import added, empty
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import INTEGRATORS, Integrator
from mcmc1d.flatland.integrators.chains import EachChain, Metropolised
from mcmc1d.flatland.sampling import exposed
from mcmc1d.flatland.scenes import catalogue, scene
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.starts import uniform_states
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key

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
    scenes, names = chosen(config.scenes, catalogue()), chosen(config.integrators, INTEGRATORS)
    points = [(s, name, config.edges, config.log2_samples, config.rounds, seed) for s in scenes for name in names]
    found = np.array(progress.map("speed", rate, points, timed=True)).reshape(len(scenes), len(names), 3)
    cells = ("scene", "integrator")
    each = {of: (cells, found[..., k]) for k, of in enumerate(("rate", "operations", "roof"))}
    return xr.Dataset({**each, "edges": config.edges}, {"scene": scenes, "integrator": names})


def rate(
    name: str, integrator: str, edges: int, log2_samples: int, rounds: int, seed: int
) -> tuple[float, float, float]:
    """Paths or mutations per second of processor time, the median of rounds; the operations of each; the core's roof.

    Where one u makes all paths, of u. The roof is measured at once, because a core's speed changes with its neighbours.
    """
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
    return samples / median(spent), work_of(make, target, paths), roof()


_LANES = 256


def work_of(make: Integrator, target: Multiplexed, paths: Paths) -> float:
    """The operations of one path or mutation: random numbers, the path, its light, densities, and the film.

    What is seldom chosen (a jump) counts for one in sixteen, which is how it is batched.
    """
    key, dtype = jax.random.key(0), jnp.float32
    target, paths = cast((target, paths), dtype)
    start = State(jnp.zeros(_LANES, jnp.int32), jnp.full((target.dim_u, _LANES), 0.5, dtype))
    looked = partial(jax.vmap, in_axes=-1, out_axes=-1)

    def sample(key: Key) -> Array:
        numbers = uniforms(key, 0, (target.dim_u + 1, _LANES), dtype)
        seen = uniform_states(target, numbers[0], numbers[1:]).seen
        light = jnp.where(looked(paths.pixel)(seen.x) == jnp.arange(paths.sensor.pixels)[:, None], seen.log_c, 0)
        return jnp.exp(light[0]) + light.sum(0) + (light * light).sum(0)

    def mutation(state: State, key: Key) -> Array:
        assert isinstance(make, Metropolised)
        kernel, film = cast((make.kernel(), EachChain(paths, _LANES)), dtype)
        steps = looked(partial(kernel.step, target))(state, uniforms(key, 0, (kernel.dim_w(target), _LANES), dtype))
        return added(film, empty(film, target, kernel, dtype), steps)

    if isinstance(make, Metropolised):
        return operations(mutation, looked(target.evaluate)(start), key) / _LANES
    return operations(sample, key) / _LANES


def draw(data: xr.Dataset) -> Figure:
    """Bars, by scene, and over each the share of what the core could do."""
    figure, axes = plt.subplots(figsize=(3.4, 2.4))
    names, width = data.integrator.to_numpy(), 0.8 / data.sizes["scene"]
    for k, name in enumerate(data.scene.to_numpy()):
        bars = axes.bar(np.arange(len(names)) + k * width, data.rate[k] / 1e6, width, label=str(name))
        axes.bar_label(bars, [f"{100 * share:.0f}" for share in _share(data)[k]], fontsize=4, padding=1)
    axes.axhline(_AIM / 1e6, color="0.6", linewidth=0.7, linestyle="--")
    axes.set_xticks(np.arange(len(names)) + 0.4 - width / 2, [str(n) for n in names], rotation=45, ha="right")
    axes.minorticks_off()
    axes.set_ylabel("10⁶ paths a second of one core")
    axes.legend(title="over bars, % of the multiply-adds' rate", title_fontsize=5, fontsize=6)
    return figure


def _share(data: xr.Dataset) -> np.ndarray:
    return (data.rate * data.operations / data.roof).to_numpy()


def table(data: xr.Dataset) -> Table:
    """Millions a second, the operations of each, and their share of what a core does at most."""
    title = f"flatland_speed; a core's roof: {float(data.roof.median()) / 1e9:.0f} 10^9 operations/s"
    result = Table("scene", "integrator", "10^6/s", "operations", "of the roof", title=title, box=SIMPLE)
    for (row, column), share in np.ndenumerate(_share(data)):
        rate, work = float(data.rate[row, column]) / 1e6, float(data.operations[row, column])
        names = str(data.scene.to_numpy()[row]), str(data.integrator.to_numpy()[column])
        result.add_row(*names, f"{rate:.2f}", f"{work:.0f}", f"{share:.0%}")
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """None: how fast a machine is is no claim. The dashed line is what we aim at for MMLT."""
    return []
