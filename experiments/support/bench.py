"""What the benchmark shares: alternating rounds on one pinned core, medians, ratios first; its table and figure."""

import os
import platform
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.sweep import Show

Go = Callable[[int], float]
"""One timed round with a seed: chain steps per second of processor time; it was compiled before.

Processor time, not that of the clock: on a core that others use too, a contestant whose rounds are long is interrupted
more often than one whose rounds are short. On an idle machine the two agree.
"""


@dataclass(frozen=True)
class Config:
    """How much is measured."""

    rounds: int = 5
    """Alternating rounds of every contestant; medians are reported."""
    work: float = 1.0
    """Factor on the length of a round, a few tenths of a second at 1."""


PROFILES = {"quick": Config(), "paper": Config(rounds=9, work=4.0)}


@contextmanager
def pinned() -> Iterator[bool]:
    """On one core, where the system can; afterwards the process may use what it might before."""
    if not hasattr(os, "sched_setaffinity"):
        yield False
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield True
    finally:
        os.sched_setaffinity(0, cores)


def alternate(stage: str, contestants: Mapping[str, Go], rounds: int, show: Show) -> dict[str, list[float]]:
    """Steps a second of everyone in every round; a round is one turn of each, so that a slow spell is shared."""
    found: dict[str, list[float]] = {name: [] for name in contestants}
    total = rounds * len(contestants)
    for seed in range(1, rounds + 1):
        for k, (name, go) in enumerate(contestants.items()):
            found[name].append(go(seed))
            show(stage, (seed - 1) * len(contestants) + k + 1, total)
    return found


def run(config: Config, seed: int, show: Show) -> xr.Dataset:
    """The multiplexed step, the random walk, growth with the problem's size, and what starting and memory cost."""
    found: dict[str, Any] = {}
    with pinned() as one_core:
        # JAX starts with these, and has a thread for each core it finds: more than one on a pinned core, and a step
        # of many small loops, as the library's, took half as long again.
        from experiments.support import bench_growth, bench_start, bench_steps, bench_walks

        for stage, module in (("multiplexed step", bench_steps), ("random walk", bench_walks)):
            contestants = module.contestants(config.work)
            rates = alternate(stage, {n: c.go for n, c in contestants.items()}, config.rounds, show)
            dim = stage.split()[-1]
            found[f"{dim}_rate"] = ((dim, "round"), list(rates.values()))
            found[f"{dim}_time"] = (dim, [c.autocorrelation_time for c in contestants.values()])
            found[dim] = list(contestants)
        for quantity, points in bench_growth.measure(config.rounds, config.work, show).items():
            sizes, times = zip(*points.items(), strict=True)
            found[f"at_{quantity}"] = (f"size_{quantity}", list(sizes))
            found[f"ns_{quantity}"] = (f"size_{quantity}", list(times))
    found |= bench_start.measure(show)
    data = xr.Dataset({name: value for name, value in found.items() if name not in ("step", "walk")})
    return data.assign_coords(step=found["step"], walk=found["walk"]).assign_attrs(pinned=int(one_core), seed=seed)


def machine() -> str:
    """The processor, in its maker's words; what the system knows of it elsewhere."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    flags = next((line for line in lines if line.startswith("flags")), "")
    widest = next((name for name in ("avx512f", "avx2") if f" {name} " in f"{flags} "), "")
    return " ".join(filter(None, [names[0] if names else platform.processor() or platform.machine(), widest]))


def medians(data: xr.Dataset, dim: str) -> dict[str, float]:
    """Each contestant's median steps per second."""
    values = data[f"{dim}_rate"].median("round").to_numpy()
    return dict(zip([str(n) for n in data[dim].to_numpy()], values.tolist(), strict=True))


def ratio(data: xr.Dataset, dim: str, ours: str, theirs: str) -> float:
    """The median over the rounds of the ratio within a round: what slows a whole round down cancels."""
    rates = data[f"{dim}_rate"]
    return float((rates.sel({dim: ours}) / rates.sel({dim: theirs})).median("round"))


def headline(data: xr.Dataset) -> dict[str, float]:
    """The ratios that are claimed; NaN where a contestant was not at hand."""
    steps, walks = ([str(n) for n in data[dim].to_numpy()] for dim in ("step", "walk"))
    time = dict(zip(walks, data.walk_time.to_numpy().tolist(), strict=True))
    result = {}
    for source in ("threefry", "hash32"):
        for other in ("C", "Numba", "NumPy"):
            here = other in steps
            result[f"multiplexed step, {source} / {other}"] = ratio(data, "step", source, other) if here else np.nan
        for other in (name for name in walks if name not in ("threefry", "hash32")):
            plain = ratio(data, "walk", source, other)
            result[f"random walk, {source} / {other}"] = plain
            result[f"  in effective samples a second, {source} / {other}"] = plain * time[other] / time[source]
    result["two cores / one"] = float(data.two_cores) if "two_cores" in data else np.nan
    return result


def table(data: xr.Dataset) -> Table:
    """Ratios first, then each contestant."""
    result = Table("what", "value", box=SIMPLE, padding=0, title="bench: medians of alternating rounds")
    for name, value in headline(data).items():
        result.add_row(name, "-" if np.isnan(value) else f"{value:.3g}")
    for dim in ("step", "walk"):
        for k, (name, value) in enumerate(medians(data, dim).items()):
            time = float(data[f"{dim}_time"][k])
            more = "" if np.isnan(time) else f", {value / time:.3g} effective samples/s"
            result.add_row(f"{dim}: {name}", f"{value:.3g} steps/s{more}")
    for name in ("import_s", "compile_cold_s", "compile_cached_s"):
        result.add_row(name, f"{float(data[name]):.2f}")
    result.add_row("peak memory, MiB, by steps", ", ".join(f"{v:.0f}" for v in data.memory_mib.to_numpy()))
    return result


def draw(data: xr.Dataset) -> Figure:
    """Steps per second of every contestant; the time of a step against each size; memory against steps."""
    figure, axes = plt.subplots(3, 3, figsize=(7.0, 5.0))
    for axis, dim in zip(axes.flat, ("step", "walk"), strict=False):
        rates = data[f"{dim}_rate"].to_numpy() / 1e6
        y = np.arange(len(rates))
        axis.barh(y, np.median(rates, axis=1), color="C0", alpha=0.6)
        axis.plot(rates, np.repeat(y[:, None], rates.shape[1], 1), ".", color="black", markersize=2)
        axis.set_yticks(y, [str(name) for name in data[dim].to_numpy()], fontsize=5)
        axis.set(xscale="log", xlabel=f"10⁶ steps/s, {'multiplexed step' if dim == 'step' else 'random walk'}")
        axis.set_xlim(0.5 * rates.min(), 1.3 * rates.max())
        _few_ticks(axis.xaxis)
        axis.invert_yaxis()
    quantities = [str(name)[3:] for name in data.data_vars if str(name).startswith("ns_")]
    for axis, quantity in zip(axes.flat[2:], quantities, strict=False):
        axis.plot(data[f"at_{quantity}"], data[f"ns_{quantity}"], "o-", markersize=3)
        at = data[f"at_{quantity}"].to_numpy()
        axis.set(xscale="log", yscale="log", xlabel=quantity, ylabel="ns a step")
        axis.set_xticks(at, [f"{size:g}" for size in at], fontsize=6)
        axis.xaxis.set_minor_locator(NullLocator())
        axis.set_ylim(0.6 * float(data[f"ns_{quantity}"].min()), 1.6 * float(data[f"ns_{quantity}"].max()))
        _few_ticks(axis.yaxis)
    memory = axes[2, 2]
    memory.plot(data.memory_steps, data.memory_mib, "o-", markersize=3)
    memory.set(xscale="log", xlabel="steps", ylabel="peak memory, MiB", ylim=(0, 1.2 * float(data.memory_mib.max())))
    return figure


def _few_ticks(axis: Axis) -> None:
    """On a logarithmic axis: 1, 2 and 5 of each decade, as numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())
    axis.set_tick_params(labelsize=6)
