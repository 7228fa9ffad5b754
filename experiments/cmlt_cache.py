"""Segovia et al. 2007, section 7.3 and table 1, in the plane: how often a small cache of segments is hit."""

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.segment_cache import Grid, hit_rates
from experiments.support.sweep import Sweep
from experiments.support.verdict import among
from mcmc1d.flatland import Paths
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators import MMLT
from mcmc1d.flatland.scenes import scene
from mcmc1d.metropolis import accept
from mcmc1d.moves import LargeStep, Mixture, MultipleTry, SmallStep, StepAndChange
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
    paths: int = 4096
    """That each method traces in a run."""
    tries: int = 64
    """Candidates of a packet, and camera paths of a tile."""
    length: int = 2
    """Packets of a sub-chain."""
    sigma: float = 0.02
    """Of the candidates."""
    main_sigma: float = 0.05
    large: float = 0.3
    tiles: int = 16
    """Into which the film is cut."""
    virtual: int = 4
    """Light paths that each tile is joined to, before the next."""
    runs: int = 12


PROFILES = {"quick": Config(), "paper": Config(scenes="office lab box", paths=2**14, runs=32)}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

ALGORITHMS = ("MLT", "CMLT", "IR")
SIZES = (4, 16, 128)
TABLE_1 = {"MLT": (0.55, 0.61, 0.62), "CMLT": (0.87, 0.92, 0.99), "IR": (0.87, 0.92, 0.99)}
"""The paper's, of its diffuse office of 35,000 triangles."""


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
        # An impossible proposal may have no vertices, and so no rays.
        tests = [grid.tested(ray) for ray in rays[np.isfinite(rays).all((1, 2))]]
        rates = hit_rates((segment for each in tests for segment in each), SIZES)
        rows.append([*rates.tolist(), float(np.mean([len(each) for each in tests]))])
    return rows


def _chain(config: Config) -> Mixture:
    large, small = StepAndChange(LargeStep()), SmallStep(config.main_sigma)
    return Mixture({"large": (config.large, large), "small": (1 - config.large, small)})


def _alone(key: Key, paths: Paths, config: Config) -> np.ndarray:
    """The rays of a chain's proposals, one path after the other from the sensor on: (rays, 2, 2)."""
    target, (first, second) = MMLT().target(paths), jax.random.split(key)
    start = mcmc1d.exact_start(first, target, 1)
    points = np.asarray(_proposed(second, target, paths, _chain(config), start, config.paths))
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 2)


@eqx.filter_jit
def _proposed(key: Key, target: Multiplexed, paths: Paths, move: Mixture, start: State, steps: int) -> Array:
    """The vertices of every proposal, (steps, vertices, 2)."""

    def step(state: State, key: Key) -> tuple[State, Array]:
        w = jax.random.uniform(key, (move.dim_w(target) + 1,), state.u.dtype)
        proposal = move.propose(target, state, w[:-1])
        x = target.evaluate(proposal.state).seen.x
        return accept(target, state, proposal, w[-1], "plain").state, paths.vertices(x)

    return jax.lax.scan(step, jax.tree.map(lambda leaf: leaf[0], start), jax.random.split(key, steps))[1]


def _packets(key: Key, paths: Paths, config: Config) -> np.ndarray:
    """The rays of sub-chains of multiple-try: a packet's first edges in the order of the film, then its second ones."""
    target, each = MMLT().target(paths), 2 * config.tries - 1
    packets = -(-config.paths // each)
    mains = -(-packets // config.length)
    first, second = jax.random.split(key)
    start = mcmc1d.exact_start(first, target, 1)
    inner = MultipleTry(SmallStep(config.sigma), config.tries)
    points = np.asarray(_packed(second, target, paths, _chain(config), inner, start, mains, config.length))
    packed = points.reshape(-1, 2, config.tries, *points.shape[-2:])  # packets, families, tries, vertices, 2
    rays = np.stack([packed[..., :-1, :], packed[..., 1:, :]], axis=-2)
    return np.moveaxis(rays, 3, 2).reshape(-1, 2, 2)


@eqx.filter_jit
def _packed(
    key: Key,
    target: Multiplexed,
    paths: Paths,
    main: Mixture,
    inner: MultipleTry,
    start: State,
    mains: int,
    length: int,
) -> Array:
    """The vertices of candidates and competitors, (mains, length, 2, tries, vertices, 2)."""

    def packet(state: State, key: Key) -> tuple[State, Array]:
        w = jax.random.uniform(key, (inner.dim_w(target) + 1,), state.u.dtype)
        proposal, looked_at = inner.propose_packet(target, state, w[:-1])
        families = []
        for family in (looked_at.candidates, looked_at.competitors):
            order = jnp.argsort(jax.vmap(paths.film)(family.seen.x))
            families.append(jax.vmap(paths.vertices)(family.seen.x[order]))
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
    passes = -(-config.paths // (config.tries * virtual))
    places = jax.random.randint(tile, (passes,), 0, films)
    film = (places[:, None] + (jnp.arange(config.tries) + 0.5) / config.tries) / films
    points = np.asarray(_joined(technique, paths, film, lights))  # passes, tries, virtual, vertices, 2
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
    """Hit rates by the cache's size, a panel a scene; the paper's, dotted."""
    n = data.sizes["scene"]
    figure, axes = plt.subplots(1, n, figsize=(3.4 if n == 1 else 7.0, 2.3), squeeze=False, sharey=True)
    place = np.arange(len(SIZES))
    for panel, name in zip(axes[0], data.scene.to_numpy(), strict=True):
        hits = 100 * data.hits.sel(scene=name)
        for who, color, mark, by in zip(ALGORITHMS, ("C1", "C0", "0.4"), "s^o", (-0.06, 0, 0.06), strict=True):
            one = hits.sel(algorithm=who)
            error = one.std("run", ddof=1) / np.sqrt(data.sizes["run"])
            panel.errorbar(place + by, one.mean("run"), error, color=color, marker=mark, markersize=4, label=who)
            panel.plot(place + by, 100 * np.array(TABLE_1[who]), ":", color=color, linewidth=1)
        panel.set_xticks(place, [str(size) for size in SIZES])
        panel.minorticks_off()
        panel.set(xlabel="segments in the cache", title=str(name), ylim=(None, 101))
    axes[0, 0].set_ylabel("hits (%)")
    axes[0, 0].legend(loc="lower right")
    return figure


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


def judge(data: xr.Dataset) -> list[Claim]:
    """Packets against single paths, and against the tiles of instant radiosity."""
    runs = data.sizes["run"]
    mean, error = data.hits.mean("run"), data.hits.std("run", ddof=1) / np.sqrt(runs)
    names = [str(name) for name in data.scene.to_numpy()]

    def rates(who: str, name: str) -> str:
        return " / ".join(f"{rate:.0%}" for rate in mean.sel({"algorithm": who, "scene": name}).to_numpy())

    def apart(other: str, name: str) -> tuple[np.ndarray, np.ndarray]:
        """By how much CMLT's rates are above another's, by size, and 5 standard errors of that."""
        one, two = ({"algorithm": who, "scene": name} for who in ("CMLT", other))
        return (mean.sel(one) - mean.sel(two)).to_numpy(), 5 * np.hypot(error.sel(one), error.sel(two)).to_numpy()

    higher, alike, decided, noise = {}, {}, {}, {}
    for name in names:
        (above, least), (beside, blur) = apart("MLT", name), apart("IR", name)
        higher[name], alike[name] = bool((above > least).all()), bool((np.abs(beside) + blur < _ALIKE).all())
        decided[name] = alike[name] or bool((np.abs(beside) - blur > _ALIKE).any())
        noise[name] = float(max(least.max(), blur.max()))
    worst = max(noise.values())
    sizes = " / ".join(str(size) for size in SIZES)
    return [
        Claim(
            "cmlt.cache-mlt",
            f"A cache of {sizes} segments is hit more often by packets of multiple-try than by single mutations",
            SOURCE,
            among(higher),
            "holds",
            "; ".join(f"{name}: {rates('CMLT', name)} against {rates('MLT', name)}" for name in names)
            + "; in the paper 87 / 92 / 99 % against 55 / 61 / 62 %",
            f"5 s.e. of {runs} runs, {worst:.1%}",
        ),
        Claim(
            "cmlt.cache-ir",
            "It is hit about as often as by the tiles of instant radiosity",
            SOURCE,
            among(alike) if all(decided.values()) else "open",
            # In the plane a tile sees a wall or two, not dozens of triangles, so that tiles are all hits.
            "fails",
            "; ".join(f"{name}: {rates('CMLT', name)} against {rates('IR', name)}" for name in names)
            + "; in the paper the same to 1 %",
            f"{_ALIKE:.0%}, and 5 s.e. of {runs} runs, {worst:.1%}, to decide",
        ),
    ]
