"""Segovia et al. 2007, section 7.3 and table 1, in the plane: how often a small cache of segments is hit.

MLT is that of Veach and Guibas 1997: bidirectional mutations, lens, caustic and multi-chain perturbations. CMLT's main
chain takes the bidirectional ones alone, and a packet perturbs the lens sub-path of 256 candidates by 5 % of the film,
as in the paper; of a path that is mutated only the new edges are traced. Not as there: scenes of 799 segments at most,
not of 35,000 and 200,000 triangles, hit by rays in the plane; light of one length; a least recently used cache, where
the paper names no rule, behind a uniform grid; candidates that are independent and traced in the order of the film
instead of jittered; the main chain's own rays, 1 in 1023 mutations, left out; and sizes of tiles and numbers of virtual
lamps, which the paper does not give.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import ttest_1samp, ttest_ind

import mcmc1d
from experiments.support.cmlt_cache_rays import coherent, mlt, radiosity, target
from experiments.support.framework import Claim, chosen
from experiments.support.segment_cache import Grid, hit_rates
from experiments.support.sweep import Sweep
from experiments.support.verdict import among
from mcmc1d.flatland import Paths
from mcmc1d.flatland.scenes import catalogue, scene

SOURCE = "Segovia et al. 2007, sec. 7.3, table 1"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "office"
    edges: int = 3
    cells: int = 256
    """Of the grid, along the scene's longer side."""
    paths: int = 1022
    """That each method traces in a run."""
    tries: int = 256
    """Candidates of a packet."""
    length: int = 2
    """Packets of a sub-chain."""
    sigma: float = 0.05
    """Of the candidates, as a share of the film."""
    tiles: int = 16
    """Into which the film is cut."""
    camera: int = 64
    """Camera paths of a tile."""
    virtual: int = 4
    """Light paths that each tile is joined to, before the next."""
    runs: int = 64


PROFILES = {"quick": Config(), "paper": Config(scenes="office lab box", runs=192)}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

ALGORITHMS = ("MLT", "CMLT", "IR")
SIZES = (4, 16, 128)
TABLE_1 = {"MLT": (0.55, 0.61, 0.62), "CMLT": (0.87, 0.92, 0.99), "IR": (0.87, 0.92, 0.99)}
"""The paper's, of its diffuse office of 35,000 triangles."""
MOST_OF_MLT = 0.79
"""Of MLT's requests by 128 triangles in the paper: the most of its four scenes."""
_TOGETHER = 32
"""Runs that share the search for exact starts, which takes longer than a run."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The hit rates of every run."""
    names = chosen(config.scenes, catalogue())
    firsts = range(0, config.runs, _TOGETHER)
    points = [(name, first, asdict(config), seed) for name in names for first in firsts]
    parts = progress.map("runs", measure, points)
    found = np.array([row for part in parts for row in part])
    found = found.reshape(len(names), config.runs, len(ALGORITHMS), len(SIZES) + 1)
    return xr.Dataset(
        {
            "hits": (("scene", "run", "algorithm", "size"), found[..., :-1]),
            "tests": (("scene", "run", "algorithm"), found[..., -1]),
            "segments": ("scene", [len(scene(name).segments) for name in names]),
        },
        {"scene": names, "algorithm": list(ALGORITHMS), "size": list(SIZES)},
    )


def measure(name: str, first: int, fields: dict[str, Any], seed: int) -> list[list[list[float]]]:
    """Of some runs and each method the hit rates by size, and how many segments a ray is tested against."""
    config = Config(**fields)
    shown = scene(name)
    paths, grid = Paths(shown, config.edges), Grid(shown, config.cells)
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), sum(name.encode())), first)
    begin, *keys = jax.random.split(key, 1 + min(_TOGETHER, config.runs - first))
    starts = mcmc1d.exact_start(begin, target(paths), 2 * len(keys))
    found = []
    for k, own in enumerate(keys):
        single, packed, tiled = jax.random.split(own, len(ALGORITHMS))
        one, other = (jax.tree.map(lambda leaf, n=n: leaf[n], starts) for n in (2 * k, 2 * k + 1))
        rows = []
        for rays in (
            mlt(single, paths, one, config.paths),
            coherent(packed, paths, other, config.paths, config.tries, config.length, config.sigma),
            radiosity(tiled, paths, config.paths, config.tiles, config.camera, config.virtual),
        ):
            tests = [grid.tested(ray) for ray in rays[np.isfinite(rays).all((1, 2))]]
            rates = hit_rates((segment for each in tests for segment in each), SIZES)
            rows.append([*rates.tolist(), float(np.mean([len(each) for each in tests]))])
        found.append(rows)
    return found


def draw(data: xr.Dataset) -> Figure:
    """Hit rates by the cache's size, a panel a scene; beside the office's the paper's."""
    n = data.sizes["scene"]
    figure, axes = plt.subplots(1, n, figsize=(3.4 if n == 1 else 7.0, 2.6), squeeze=False, sharey=True)
    place = np.arange(len(SIZES))
    for panel, name in zip(axes[0], data.scene.to_numpy(), strict=True):
        for who, color, mark, by in zip(ALGORITHMS, ("C1", "C0", "0.4"), "s^o", (-0.06, 0, 0.06), strict=True):
            one = 100 * data.hits.sel(scene=name, algorithm=who)
            error = 2 * one.std("run", ddof=1) / np.sqrt(data.sizes["run"])
            panel.errorbar(place + by, one.mean("run"), error, color=color, marker=mark, markersize=4, label=who)
            if name == "office":
                panel.plot(
                    place + by,
                    100 * np.array(TABLE_1[who]),
                    ":",
                    color=color,
                    linewidth=1,
                    marker=mark,
                    markersize=3,
                    markerfacecolor="none",
                )
        panel.set_xticks(place, [str(size) for size in SIZES])
        panel.minorticks_off()
        segments = int(data.segments.sel(scene=name))
        panel.set(xlabel="segments in the cache", title=f"{name}, {segments} segments", ylim=(None, 101))
    axes[0, 0].set_ylabel("hits (%); bars: 2 s.e.")
    axes[0, 0].plot([], [], ":", color="0.2", marker="o", markersize=3, markerfacecolor="none", label=_PAPERS)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2 if n == 1 else 4)
    return figure


_PAPERS = "the paper's (35,000 triangles)"


def table(data: xr.Dataset) -> Table:
    """As the paper's table 1."""
    result = Table(
        "scene", "algorithm", *(f"{size}" for size in SIZES), "tests a ray", title="cmlt_cache", box=SIMPLE, padding=0
    )
    mean = partial(xr.DataArray.mean, dim="run")
    for name in data.scene.to_numpy():
        for who in ALGORITHMS:
            here = data.sel({"scene": name, "algorithm": who})
            rates = mean(here.hits).to_numpy()
            result.add_row(str(name), who, *(f"{rate:.1%}" for rate in rates), f"{float(mean(here.tests)):.1f}")
    return result


_ALIKE = 0.05
"""By so much two rates may differ and be about the same."""
_LEVEL = 1e-4
"""With which a claim's intervals miss, all sizes and scenes together."""


def _inside(low: np.ndarray, high: np.ndarray, least: float, most: float) -> bool | None:
    """Whether all lie between two limits; None where the intervals do not decide it."""
    if ((low >= least) & (high <= most)).all():
        return True
    return False if ((high < least) | (low > most)).any() else None


def judge(data: xr.Dataset) -> list[Claim]:
    """Packets against single paths, and against the tiles of instant radiosity; single paths and a large cache."""
    runs, names = data.sizes["run"], [str(name) for name in data.scene.to_numpy()]
    mean = data.hits.mean("run")
    each = 1 - _LEVEL / (len(SIZES) * len(names))

    def rates(who: str, name: str) -> str:
        return " / ".join(f"{rate:.0%}" for rate in mean.sel({"algorithm": who, "scene": name}).to_numpy())

    def beside(who: str, other: str) -> str:
        return "; ".join(f"{name}: {rates(who, name)} against {rates(other, name)}" for name in names)

    def above(other: str, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Intervals of how far CMLT's rates are above another's, by size."""
        one, two = (data.hits.sel(algorithm=who, scene=name).transpose("run", "size") for who in ("CMLT", other))
        return _interval(ttest_ind(one, two, equal_var=False), each)

    def width(intervals: Iterable[tuple[np.ndarray, np.ndarray]]) -> str:
        widest = max(float((high - low).max()) for low, high in intervals) / 2
        return f"intervals of {runs} runs (Welch's t, family-wise {_LEVEL:.0e}), ± {widest:.1%} at most"

    mlt, ir = ({name: above(other, name) for name in names} for other in ("MLT", "IR"))
    large = {
        name: _interval(ttest_1samp(data.hits.sel(algorithm="MLT", scene=name, size=SIZES[-1]), 0), each)
        for name in names
    }
    sizes = " / ".join(str(size) for size in SIZES)
    return [
        Claim(
            "cmlt.cache-mlt",
            f"A cache of {sizes} segments is hit more often by packets of multiple-try than by single mutations",
            SOURCE,
            among({name: _inside(*found, 0, 1) for name, found in mlt.items()}),
            "holds",
            beside("CMLT", "MLT") + "; in the paper's office 87 / 92 / 99 % against 55 / 61 / 62 %",
            width(mlt.values()),
        ),
        Claim(
            "cmlt.cache-ir",
            f"It is hit about as often, to {_ALIKE:.0%}, as by the tiles of instant radiosity",
            SOURCE,
            among({name: _inside(*found, -_ALIKE, _ALIKE) for name, found in ir.items()}),
            "holds",
            beside("CMLT", "IR") + "; in the paper the same to 1 %",
            width(ir.values()),
        ),
        Claim(
            "cmlt.cache-mlt-large",
            f"Of single mutations' requests {SIZES[-1]} segments hold {MOST_OF_MLT:.0%} at most, as in all its scenes",
            SOURCE,
            among({name: _inside(*found, 0, MOST_OF_MLT) for name, found in large.items()}),
            # A scene of the plane is small: so many are a large share of the segments that are ever near a ray.
            "fails",
            "; ".join(
                f"{name}: {float(mean.sel(algorithm='MLT', scene=name, size=SIZES[-1])):.0%}, of "
                f"{int(data.segments.sel(scene=name))} segments"
                for name in names
            )
            + "; in the paper 62, 45, 79 and 77 %, of 35,000 and 200,000 triangles",
            width(large.values()),
        ),
    ]


def _interval(test: Any, confidence: float) -> tuple[np.ndarray, np.ndarray]:
    found = test.confidence_interval(confidence)
    return np.asarray(found.low), np.asarray(found.high)
