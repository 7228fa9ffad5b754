"""Hachisuka et al. 2014, figure 8, in the plane: light from mirror to wall to mirror, which no two walks join to make.

The paper has a box of Hachisuka et al. 2008 in 45 minutes, by original MLT, MMLT and progressive photon mapping. Here
the pinhole sees a caustic on the floor directly (3 edges) and in a mirror (4 edges); of the latter only a walk from the
pinhole that comes upon the lamp by itself makes a path, and the lamp is made narrow. Photons keep one radius, where the
paper's shrinks. Equal is the work in rays, not the time. Chains are spared the search for a start: it is exact, drawn
from the technique that makes paths; but b is estimated from a quarter of the rays by BDPT, as the paper does at the
start, where it is said to be: a run whose samples find no path has a black image, as it had no start.
"""

from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.flatland_caustic import blurred, caustic, exact, found
from experiments.support.flatland_chains import close, films, multiplexed_kernel
from experiments.support.flatland_rivals import contributions
from experiments.support.flatland_sds_claims import claims
from experiments.support.flatland_sds_figure import figure
from experiments.support.framework import numbers
from experiments.support.sweep import Sweep
from mcmc1d.checks import require
from mcmc1d.flatland import Paths, Scene
from mcmc1d.flatland.integrators import MLT, BidirectionalPathTracing, PhotonDensity
from mcmc1d.flatland.mutations import VEACH, ManifoldStep
from mcmc1d.flatland.sampling import bootstrap
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.moves import Mixture
from mcmc1d.numerics import cast
from mcmc1d.starts import exact_start
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    widths: str = "0.1 0.01 0.001"
    """Of the lamp, whose flux stays the same."""
    radii: str = "0.02 0.05 0.1 0.2"
    radius: float = 0.05
    """That is compared with chains, chosen before they were run."""
    pixels: int = 32
    sigma: float = 0.05
    large: float = 0.1
    manifold: float = 0.25
    """The share of manifold steps, where MLT has them."""
    runs: int = 64
    """Of one chain each, and as many of photons."""
    budgets: str = "32768 65536"
    """Rays of a run; of the quick profile's smaller one a half is spent on b, for samples come by 4096."""
    samples: int = 2**18
    """Independent ones, of what each technique makes."""
    passes: int = 2**13
    """Of photons, in the images that show the bias."""


PROFILES = {
    "quick": Config(),
    "paper": Config(runs=256, budgets="65536 131072 262144", samples=2**22, passes=2**17),
}

CHAINS = ("MMLT", "MLT", "MLT, manifold")
EDGES = (3, 4)
SPENT_ON_B = 0.25
"""Of a run's rays."""
_BATCH = 2**14
_LANES = 2**12
"""Samples for b are taken by as many."""
_CHAIN_ROWS = {"": "mse", ", b known": "mse_known"}
_PATHS = 12
"""That are drawn."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Of 4 edges every lamp; of 3 the one in the middle, and of it the bias of photons."""
    widths = numbers("widths", config.widths, float)
    require(config.radius in _radii(config), f"radius is one of the radii, {config.radii}, not {config.radius}")
    middle = widths[len(widths) // 2]
    points = [(middle, EDGES[0], asdict(config), seed), *((w, EDGES[1], asdict(config), seed) for w in widths)]
    direct, *hidden = (_dataset(one) for one in progress.map("lamps", measure, points))
    direct, seen = direct.expand_dims(width=[middle]), xr.concat(hidden, "width").assign_coords(width=widths)
    # Of 3 edges under the other lamps, and of a fifth technique there, there are no numbers.
    data = xr.concat([direct, seen], "edges", join="outer").sel(width=widths)
    (bias,) = progress.map("bias", blur, [(middle, asdict(config), seed)])
    return data.assign(
        {name: (("radius", "pixel"), np.array(bias[name])) for name in ("photons", "photons_error", "predicted")}
        | {"path": (("path", "vertex", "axis"), np.array(bias["paths"])), "of": config.radius, "middle": middle}
    ).assign_coords(edges=list(EDGES), method=list(CHAINS), radius=_radii(config), budget=_budgets(config))


def _radii(config: Config) -> list[float]:
    return numbers("radii", config.radii, float)


def _budgets(config: Config) -> list[int]:
    return numbers("budgets", config.budgets)


def _dataset(one: dict[str, Any]) -> xr.Dataset:
    by_run = {"mse": ("method", "budget", "run"), "mse_known": ("method", "budget", "run"), "b": ("budget", "run")}
    others = {
        "reference": ("pixel",),
        "reference_error": ("pixel",),
        "contribution": ("technique",),
        "tried": (),
        "size": ("budget",),
        "photon_mse": ("radius", "budget", "run"),
        "film": ("method", "run", "pixel"),
        "photon_film": ("radius", "run", "pixel"),
        "chance": (),
    }
    data = xr.Dataset({name: (dims, np.array(one[name])) for name, dims in (by_run | others).items()})
    return data.assign_coords(technique=np.arange(data.sizes["technique"]))


def measure(width: float, edges: int, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """What techniques make of one length, and the squared error of every run, over the squared mean."""
    config = Config(**fields)
    scene = caustic(width, config.pixels)
    truth = exact(scene)
    reference, paths = truth.values[edges - 1], Paths(scene, edges)
    target = BidirectionalPathTracing().target(paths)
    key = jax.random.fold_in(jax.random.key(seed), edges + 100 * round(1e4 * width))
    every = np.ones(target.n_techniques, bool)
    batches = -(-config.samples // _BATCH)
    total = contributions(jax.random.fold_in(key, 0), target, paths, every, batches, _BATCH)[0].sum(0)
    tried = batches * _BATCH
    b, n = float(reference.mean()), target.n_techniques
    start = _start(jax.random.fold_in(key, 1), target, edges, config.runs)
    budgets, each = _budgets(config), {"MMLT": float(edges), **_rays_of_mlt(target, paths, config.manifold)}
    sizes = [max(1, int(SPENT_ON_B * rays / edges / _LANES)) * _LANES for rays in budgets]
    estimated = np.array(
        [_estimates(jax.random.fold_in(key, 2 + k), target, size, config.runs) for k, size in enumerate(sizes)]
    )
    mse, known, film = [], [], []
    for k, method in enumerate(CHAINS):
        steps = [int((rays - size * edges) / each[method]) for rays, size in zip(budgets, sizes, strict=True)]
        kernel = _kernel(config, n, method)
        ran = films(method, jax.random.fold_in(key, 100 + k), kernel, target, paths, config.runs, steps, {}, start)
        images = config.pixels * estimated[:, :, None] * ran.films
        mse.append(_squared(images, reference))
        known.append(_squared(config.pixels * b * ran.films, reference))
        film.append(images[-1])
    photons = [
        [_photons(config, scene, edges, radius, rays, jax.random.fold_in(key, 200 + k)) for rays in budgets]
        for k, radius in enumerate(_radii(config))
    ]
    parts = {
        "reference": reference,
        "reference_error": truth.errors[edges - 1],
        "contribution": total.sum(1) / tried,
        "tried": tried / n,
        "b": estimated,
        "size": sizes,
        "mse": mse,
        "mse_known": known,
        "film": film,
        "photon_mse": _squared(np.array(photons), reference),
        "photon_film": np.array(photons)[:, -1],
        "chance": found(b, width) / n if edges == EDGES[-1] else np.nan,
    }
    return {name: np.asarray(value).tolist() for name, value in parts.items()}


def _squared(images: np.ndarray, reference: np.ndarray) -> np.ndarray:
    return ((images - reference) ** 2).mean(-1) / reference.mean() ** 2


def _start(key: Key, target: Multiplexed, edges: int, count: int) -> State:
    """Exact states; of 4 edges all are of the technique that walks from the pinhole only, or `run` tells otherwise."""
    return exact_start(key, target, count, index=target.n_techniques - 1 if edges == EDGES[-1] else None)


def _estimates(key: Key, target: Multiplexed, size: int, runs: int) -> list[float]:
    """Of each run, b by samples of its own."""
    return [float(bootstrap(jax.random.fold_in(key, k), target, size, np.inf).mean[0]) for k in range(runs)]


def _kernel(config: Config, techniques: int, method: str) -> Kernel:
    if method == "MMLT":
        return multiplexed_kernel(config.sigma, config.large, close(techniques, config.sigma))
    share = config.manifold if method.endswith("manifold") else 0.0
    return Metropolis(Mixture({"veach": (1 - share, VEACH), "manifold": (share, ManifoldStep(config.sigma))}))


def _rays_of_mlt(target: Multiplexed, paths: Paths, manifold: float) -> dict[str, float]:
    """Of a mutation on average; a manifold step is counted as a whole path, as perturbations are before mirrors."""
    mixed = dict(zip(VEACH.names, (float(p) for p in VEACH.probabilities), strict=True))
    veach = MLT().rays(target, paths, mixed)[0]
    return {"MLT": veach, "MLT, manifold": (1 - manifold) * veach + manifold * paths.edges}


def _photons(config: Config, scene: Scene, edges: int, radius: float, rays: int, key: Key) -> list[list[float]]:
    """The images of all runs, of so many rays each."""
    density = PhotonDensity(radius=radius, photons=config.pixels, cameras=config.pixels)
    samples = int(rays / density.rays(Paths(scene, edges)) * density.cameras)
    seen = [density.render(jax.random.fold_in(key, k), scene, edges, samples).value for k in range(config.runs)]
    return np.array(seen).tolist()


def blur(width: float, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """Long images by photons of each radius, of 4 edges, and what they should be; and paths of that length."""
    config, edges = Config(**fields), EDGES[-1]
    scene, key = caustic(width, config.pixels), jax.random.fold_in(jax.random.key(seed), 1)
    layers = [
        PhotonDensity(radius=radius, photons=config.pixels, cameras=config.pixels).render(
            jax.random.fold_in(key, k), scene, edges, config.passes * config.pixels
        )
        for k, radius in enumerate(_radii(config))
    ]
    paths = Paths(scene, edges)
    start = _start(jax.random.fold_in(key, 99), BidirectionalPathTracing().target(paths), edges, _PATHS)
    parts = {
        "photons": [layer.value for layer in layers],
        "photons_error": [layer.error for layer in layers],
        "predicted": [blurred(scene, radius, edges) for radius in _radii(config)],
        "paths": _vertices(paths, start.seen.x),
    }
    return {name: np.asarray(value).tolist() for name, value in parts.items()}


@eqx.filter_jit
def _vertices(paths: Paths, x: Array) -> Array:
    return jax.vmap(cast(paths, x.dtype).vertices)(x)


def draw(data: xr.Dataset) -> Figure:
    """The scene, images, the bias by radius, and the error against rays."""
    return figure(data, caustic(float(data.middle), data.sizes["pixel"]))


def table(data: xr.Dataset) -> Table:
    """Root mean square errors at the most rays, over the mean, by lamp; and what shares of runs are black."""
    columns = {f"lamp of {width:g}": data.sel(edges=4, width=width) for width in data.width.to_numpy()}
    columns["seen directly"] = data.sel(edges=3, width=data.middle)
    result = Table("RMS error", *columns, title="flatland_sds", box=SIMPLE, padding=0)
    rows = {f"{m}{known}": (name, {"method": m}) for known, name in _CHAIN_ROWS.items() for m in CHAINS}
    rows |= {f"photons, {r:g}": ("photon_mse", {"radius": r}) for r in data.radius.to_numpy()}
    for row, (name, of) in rows.items():
        errors = (float(one[name].sel(of).isel(budget=-1).mean("run")) ** 0.5 for one in columns.values())
        result.add_row(row, *(f"{error:.1%}" for error in errors))
    black = (float((one.b.isel(budget=-1) == 0).mean("run")) for one in columns.values())
    result.add_row("runs without a path", *(f"{share:.0%}" for share in black))
    return result


judge = claims
