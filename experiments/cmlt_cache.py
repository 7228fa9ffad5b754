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
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.stats import ttest_1samp, ttest_ind

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.segment_cache import Grid, hit_rates
from experiments.support.sweep import Sweep
from experiments.support.verdict import among
from mcmc1d.flatland import Paths
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators import MLT
from mcmc1d.flatland.mutations import VEACH, BidirectionalMutation, LensPerturbation
from mcmc1d.flatland.scenes import scene
from mcmc1d.metropolis import accept
from mcmc1d.moves import Move, MultipleTry, SmallStep
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key

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
    runs: int = 96


PROFILES = {"quick": Config(), "paper": Config(scenes="office lab box", runs=192)}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

ALGORITHMS = ("MLT", "CMLT", "IR")
SIZES = (4, 16, 128)
TABLE_1 = {"MLT": (0.55, 0.61, 0.62), "CMLT": (0.87, 0.92, 0.99), "IR": (0.87, 0.92, 0.99)}
"""The paper's, of its diffuse office of 35,000 triangles."""
MOST_OF_MLT = 0.79
"""Of MLT's requests by 128 triangles in the paper: the most of its four scenes."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The hit rates of every run."""
    names = config.scenes.split()
    points = [(name, k, asdict(config), seed) for name in names for k in range(config.runs)]
    found = np.array(progress.map("runs", measure, points))
    shape = len(names), config.runs, len(ALGORITHMS), len(SIZES) + 1
    found = found.reshape(shape)
    return xr.Dataset(
        {
            "hits": (("scene", "run", "algorithm", "size"), found[..., :-1]),
            "tests": (("scene", "run", "algorithm"), found[..., -1]),
            "segments": ("scene", [len(scene(name).segments) for name in names]),
        },
        {"scene": names, "algorithm": list(ALGORITHMS), "size": list(SIZES)},
    )


def measure(name: str, k: int, fields: dict[str, Any], seed: int) -> list[list[float]]:
    """Of each method the hit rates by size, and how many segments a ray is tested against."""
    config = Config(**fields)
    shown = scene(name)
    paths, grid = Paths(shown, config.edges), Grid(shown, config.cells)
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), sum(name.encode())), k)
    rows = []
    for own, rays_of in zip(jax.random.split(key, len(ALGORITHMS)), (_alone, _packets, _tiles), strict=True):
        rays = rays_of(own, paths, config)
        tests = [grid.tested(ray) for ray in rays[np.isfinite(rays).all((1, 2))]]
        rates = hit_rates((segment for each in tests for segment in each), SIZES)
        rows.append([*rates.tolist(), float(np.mean([len(each) for each in tests]))])
    return rows


def _alone(key: Key, paths: Paths, config: Config) -> np.ndarray:
    """The rays of a chain's proposals, one path after the other from the sensor on: (rays, 2, 2)."""
    target, (first, second) = MLT().target(paths), jax.random.split(key)
    start = mcmc1d.exact_start(first, target, 1)
    return np.asarray(_proposed(second, target, paths, VEACH, start, config.paths)).reshape(-1, 2, 2)


def _traced(paths: Paths, old: Array, new: Array, possible: Array) -> Array:
    """The edges of a new path that a mutation traces, (edges, 2, 2); NaN in place of those that it keeps."""
    before, after = paths.vertices(old), paths.vertices(new)
    kept = jnp.all(jnp.abs(before - after) < _SAME, axis=1)
    edges = jnp.stack([after[:-1], after[1:]], axis=1)
    return jnp.where(((kept[:-1] & kept[1:]) | ~possible)[:, None, None], jnp.nan, edges)


_SAME = 1e-4
"""Vertices nearer to each other than that, in scenes some units wide, are one that was kept: float32 rounds it."""


@eqx.filter_jit
def _proposed(key: Key, target: Multiplexed, paths: Paths, move: Move, start: State, steps: int) -> Array:
    """The edges traced for every proposal, (steps, edges, 2, 2)."""

    def step(state: State, key: Key) -> tuple[State, Array]:
        w = jax.random.uniform(key, (move.dim_w(target) + 1,), state.u.dtype)
        proposal = move.propose(target, state, w[:-1])
        there = target.evaluate(proposal.state).seen.x
        # A mutation that does not apply to the path traces nothing.
        rays = _traced(paths, state.seen.x, there, proposal.log_det > -jnp.inf)
        return accept(target, state, proposal, w[-1], "plain").state, rays

    return jax.lax.scan(step, jax.tree.map(lambda leaf: leaf[0], start), jax.random.split(key, steps))[1]


def _packets(key: Key, paths: Paths, config: Config) -> np.ndarray:
    """The rays of sub-chains of multiple-try: a packet's first edges in the order of the film, then its second ones."""
    target, each = MLT().target(paths), 2 * config.tries - 1
    mains = -(-config.paths // (each * config.length))
    first, second = jax.random.split(key)
    start = mcmc1d.exact_start(first, target, 1)
    inner = MultipleTry(LensPerturbation(SmallStep(config.sigma)), config.tries)
    moves = _Moves(BidirectionalMutation(), inner, config.length)
    # (mains, packets, families, tries, edges, 2, 2): edge by edge within a family.
    rays = np.asarray(_packed(second, target, paths, moves, start, mains))
    return np.moveaxis(rays, 4, 3).reshape(-1, 2, 2)


class _Moves(NamedTuple):
    main: Move
    inner: MultipleTry
    length: int


@eqx.filter_jit
def _packed(key: Key, target: Multiplexed, paths: Paths, moves: _Moves, start: State, mains: int) -> Array:
    """The edges traced for candidates and competitors, (mains, length, 2, tries, edges, 2, 2)."""
    main, inner, length = moves

    def packet(state: State, key: Key) -> tuple[State, Array]:
        w = jax.random.uniform(key, (inner.dim_w(target) + 1,), state.u.dtype)
        proposal, looked_at = inner.propose_packet(target, state, w[:-1])
        families = []
        for family in (looked_at.candidates, looked_at.competitors):
            order = jnp.argsort(jax.vmap(paths.film)(family.seen.x))
            # All keep the same end of the path; what lies under a horizon, or in a shadow, is traced as well.
            possible = jnp.isfinite(family.seen.x).all(-1)
            rays = jax.vmap(partial(_traced, paths, state.seen.x))(family.seen.x, possible)
            families.append(rays[order])
        return accept(target, state, proposal, w[-1], "plain").state, jnp.stack(families)

    def step(state: State, key: Key) -> tuple[State, Array]:
        own, rest = jax.random.split(key)
        w = jax.random.uniform(own, (main.dim_w(target) + 1,), state.u.dtype)
        state = accept(target, state, main.propose(target, state, w[:-1]), w[-1], "plain").state
        return state, jax.lax.scan(packet, state, jax.random.split(rest, length))[1]

    return jax.lax.scan(step, jax.tree.map(lambda leaf: leaf[0], start), jax.random.split(key, mains))[1]


def _tiles(key: Key, paths: Paths, config: Config) -> np.ndarray:
    """The rays of instant radiosity: a tile's camera rays, then those to each of its virtual lamps; the next tile.

    Virtual lamps are the last vertices before the camera's own of light paths, whose rays come before all tiles.
    """
    films, virtual = config.tiles, config.virtual
    shared, tile = jax.random.split(key)
    technique = Bidirectional(paths, (2,))
    lights = jax.random.uniform(shared, (virtual, technique.dim_u - 1))
    passes = -(-config.paths // (config.camera * virtual))
    places = jax.random.randint(tile, (passes,), 0, films)
    film = (places[:, None] + (jnp.arange(config.camera) + 0.5) / config.camera) / films
    points = np.asarray(_joined(technique, paths, film, lights))  # passes, camera, virtual, vertices, 2
    to_lamps = points[0, 0, :, 2:]
    rays = [np.stack([to_lamps[:, 1:], to_lamps[:, :-1]], axis=2).reshape(-1, 2, 2)[::-1]]
    for one in points:
        rays.append(one[:, 0, :2])
        rays += [one[:, k, 1:3] for k in range(virtual)]
    return np.concatenate(rays)


@eqx.filter_jit
def _joined(technique: Bidirectional, paths: Paths, film: Array, lights: Array) -> Array:
    def one(film: Array, light: Array) -> Array:
        return paths.vertices(technique.forward(jnp.zeros((), jnp.int32), jnp.concatenate([film[None], light]))[0])

    return jax.vmap(jax.vmap(jax.vmap(one, (None, 0)), (0, None)), (0, None))(film, lights)


def draw(data: xr.Dataset) -> Figure:
    """Hit rates by the cache's size, a panel a scene; beside the office's the paper's."""
    n = data.sizes["scene"]
    figure, axes = plt.subplots(1, n, figsize=(3.4 if n == 1 else 7.0, 2.4), squeeze=False, sharey=True)
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
    axes[0, 0].legend(loc="lower right")
    return figure


_PAPERS = "the paper's office, 35,000 triangles"


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
