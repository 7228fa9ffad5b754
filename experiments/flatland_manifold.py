"""Hachisuka et al. 2014, figure 7, in the plane: MMLT beside original MLT and manifold exploration, and mixed with it.

The paper has a glossy Cornell box in three minutes, MMLT in its own program and the others in Mitsuba. Here all are one
program at equal rays, from exact starts and with b known, one chain a run. The library's manifold step keeps mirrors
exactly specular, by their images instead of Newton's method; at a glossy wall, where Jakob and Marschner 2012 keep the
half vector near the normal, it moves the vertex along the wall as at any other. So `mirror_caustic` is where it is
theirs, and `glossy_corner` (exponent 60) is nearer to the paper's box, but not to its mutation. A manifold step is a
quarter of the mutations where it is mixed in. MMLT with it, which the paper leaves for others, is the last method.
"""

from dataclasses import asdict, dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.flatland_chains import close, films
from experiments.support.flatland_manifold_results import claims, figure
from experiments.support.framework import between, chosen, numbers
from experiments.support.sweep import Sweep
from mcmc1d.checks import require
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import MLT, BidirectionalPathTracing
from mcmc1d.flatland.mutants.mutations import TakenForSymmetric
from mcmc1d.flatland.mutations import VEACH, ManifoldStep
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import catalogue, scene
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.moves import LargeStep, Mixture, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.state import Multiplexed


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "mirror_caustic glossy_corner"
    shortest: int = 4
    longest: int = 4
    pixels: int = 16
    sigma: float = 0.05
    """Of small steps in each number, and of manifold steps as a share of the wall."""
    large: float = 0.1
    manifold: float = 0.25
    """The share of manifold steps, where they are mixed in."""
    runs: int = 256
    """Of one chain for each path length."""
    budgets: str = "4096 16384"
    """Rays of a run, of each length."""


PROFILES = {
    "quick": Config(),
    "paper": Config(shortest=3, longest=6, runs=512, budgets="4096 16384 65536"),
}

METHODS = ("MMLT", "MMLT, manifold", "MLT", "MLT, manifold")
TWIN = "MLT, wrong"
"""Densities of its proposals are left out of the acceptance ratio."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Every method on every scene; the image is of all lengths together."""
    require(
        config.runs >= 32, f"runs are 32 at least, for a standard error in a pixel that few reach, not {config.runs}"
    )
    names, lengths = chosen(config.scenes, catalogue()), between(config.shortest, config.longest)
    points = [(name, k, asdict(config), seed) for name in names for k in lengths]
    found = progress.map("scenes and lengths", measure, points)
    methods, budgets = [*METHODS, TWIN], numbers("budgets", config.budgets)
    shape = len(names), len(lengths)

    def of(part: str) -> np.ndarray:
        each = np.array([one[part] for one in found], np.float64)
        return each.reshape(*shape, *each.shape[1:])

    mean = of("reference").sum(1).mean(-1)
    relative = of("residual").sum(1) / mean[:, None, None, None, None]
    dims = "scene", "method", "budget", "run"
    return xr.Dataset(
        {
            "mse": (dims, (relative**2).mean(-1)),
            "bias": (("scene", "method", "pixel"), relative[:, :, -1].mean(-2)),
            "bias_error": (
                ("scene", "method", "pixel"),
                relative[:, :, -1].std(-2, ddof=1) / np.sqrt(config.runs),
            ),
            "reference_error": (("scene", "pixel"), of("reference_error").sum(1) / mean[:, None]),
            "accepted": (("scene", "edges", "method", "kind"), of("accepted")),
            "time": (("scene", "edges", "method"), of("time")),
            "share": config.manifold,
        },
        {
            "scene": names,
            "edges": lengths,
            "method": methods,
            "budget": [n * len(lengths) for n in budgets],
            "kind": ["other", "manifold"],
        },
    )


def measure(name: str, edges: int, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """One scene and length: by how much each run's image is off, acceptance, and autocorrelation times.

    The time: how many mutations are worth an exact sample, from the variance of the runs' pixels together.
    """
    config = Config(**fields)
    of = scene(name).with_pixels(config.pixels)
    truth, paths = image(of, edges), Paths(of, edges)
    reference = truth.values[-1]
    target = BidirectionalPathTracing().target(paths)
    key = jax.random.fold_in(jax.random.key(seed), edges + 100 * sum(name.encode()))
    start = mcmc1d.exact_start(jax.random.fold_in(key, 0), target, config.runs)
    residual, accepted, time = [], [], []
    for k, method in enumerate((*METHODS, TWIN)):
        kernel, each = _kernel(config, target, paths, method)
        steps = [int(rays / each) for rays in numbers("budgets", config.budgets)]
        own, asked = jax.random.fold_in(key, 1 + k), {"kinds": mcmc1d.Acceptance()}
        ran = films(method, own, kernel, target, paths, config.runs, steps, asked, start)
        residual.append(config.pixels * reference.mean() * ran.films - reference)
        accepted.append(_accepted(kernel.kinds, ran.sums["kinds"]))
        share = reference / reference.sum()
        time.append(steps[-1] * ran.films[-1].var(0, ddof=1).sum() / (share * (1 - share)).sum())
    parts = {
        "residual": residual,
        "accepted": accepted,
        "time": time,
        "reference": reference,
        "reference_error": truth.errors[-1],
    }
    return {part: np.asarray(value).tolist() for part, value in parts.items()}


def _accepted(kinds: tuple[str, ...], sums: Any) -> tuple[float, float]:
    """The acceptance of all other mutations, and of manifold steps; NaN where there are none."""
    accepted, proposed = (np.asarray(part, np.float64) for part in sums)
    manifold = np.array([kind == "manifold" for kind in kinds])
    parts = [(accepted[of].sum(), proposed[of].sum()) for of in (~manifold, manifold)]
    one, other = (a / p if p else np.nan for a, p in parts)
    return one, other


def _kernel(config: Config, target: Multiplexed, paths: Paths, method: str) -> tuple[Kernel, float]:
    """A method's kernel, and its rays for a mutation on average. With or without manifold steps it is one program."""
    share = config.manifold if method.endswith("manifold") else 0.0
    step = share, ManifoldStep(config.sigma)
    if method.startswith("MMLT"):
        small = StepAndChange(SmallStep(config.sigma), TechniqueChange(close(target.n_techniques, config.sigma)))
        others = {
            "large": ((1 - share) * config.large, StepAndChange(LargeStep())),
            "small": ((1 - share) * (1 - config.large), small),
        }
        return Metropolis(Mixture({**others, "manifold": step})), _rays(paths, share, float(paths.edges))
    move = Mixture({"veach": (1 - share, VEACH), "manifold": step})
    mistake = jnp.asarray(1.0 if method == TWIN else 0.0)
    mixed = dict(zip(VEACH.names, (float(p) for p in VEACH.probabilities), strict=True))
    return Metropolis(TakenForSymmetric(move, mistake)), _rays(paths, share, MLT().rays(target, paths, mixed)[0])


def _rays(paths: Paths, share: float, of_others: float) -> float:
    """A manifold step looks along the edges of the vertex that it moves; before mirrors it counts as a whole path."""
    k, places = paths.edges, paths.sensor.places
    own = k if paths.walls.mirrors else (2 * k - 1 + places) / (k + places)
    return (1 - share) * of_others + share * own


def draw(data: xr.Dataset) -> Figure:
    """Error against rays, a panel a scene, and acceptance."""
    return figure(data, METHODS)


def table(data: xr.Dataset) -> Table:
    """At the most rays: error, its spread over runs, acceptance and autocorrelation time of the longest paths."""
    result = Table(
        "scene", "method", "RMS error", "spread of MSE", "accepted", "manifold", "time", title="flatland_manifold",
        box=SIMPLE, padding=0,
    )  # fmt: skip
    for name in data.scene.to_numpy():
        for method in METHODS:
            one = data.sel({"scene": name, "method": method}).isel(budget=-1, edges=-1)
            other, manifold = one.accepted.to_numpy()
            mean, spread = float(one.mse.mean()), float(one.mse.std(ddof=1))
            result.add_row(
                str(name), method, f"{mean**0.5:.2%}", f"{spread / mean:.0%}", f"{other:.1%}",
                "" if np.isnan(manifold) else f"{manifold:.1%}", f"{float(one.time):.0f}",
            )  # fmt: skip
    return result


def judge(data: xr.Dataset) -> list:
    """Exact images, and who is better than whom at equal rays."""
    return claims(data, METHODS, TWIN)
