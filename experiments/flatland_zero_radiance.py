"""Pharr, Jakob, Humphreys, table 16.1, in the plane: how many samples of each integrator carry no radiance."""

from dataclasses import asdict, dataclass
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
from scipy.stats import sem

from experiments.support.flatland_chains import METHODS, Lit, close, films, multiplexed_kernel
from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import among
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import BidirectionalPathTracing, PathTracing
from mcmc1d.flatland.scenes import scene
from mcmc1d.numerics import cast
from mcmc1d.pooled import Pooled
from mcmc1d.random import uniforms
from mcmc1d.types import Array, Key

SOURCE = "Pharr, Jakob, Humphreys, sec. 16.4.2, table 16.1"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "box door mirror_caustic"
    shortest: int = 4
    longest: int = 4
    sigma: float = 0.05
    large: float = 0.1
    samples: int = 2**16
    """Of path tracing and of bidirectional path tracing, of each length."""
    runs: int = 128
    """Chains, from exact starts."""
    mutations: int = 2048
    """Of each chain."""
    level: float = 6.0
    """Standard errors by which what differs must differ."""


PROFILES = {
    "quick": Config(),
    "paper": Config(
        scenes="box door glossy_corner mirror_caustic three_rooms lab",
        shortest=3,
        longest=8,
        runs=256,
        samples=2**20,
        mutations=2**13,
    ),
}

INTEGRATORS = ("PT", "BDPT", "MMLT")
HARD = 0.9
"""A scene is hard, as the paper's two are, where more of path tracing's samples than that are dark at every length."""
_BATCH = 2**14


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The share of each, by scene and length."""
    names, lengths = config.scenes.split(), list(range(config.shortest, config.longest + 1))
    points = [(name, k, asdict(config), seed) for name in names for k in lengths]
    found = np.array(progress.map("scenes and lengths", measure, points), np.float64)
    found = found.reshape(len(names), len(lengths), len(INTEGRATORS), 2)
    dimensions = ("scene", "edges", "integrator")
    return xr.Dataset(
        {"dark": (dimensions, found[..., 0]), "error": (dimensions, found[..., 1]), "level": config.level},
        {"scene": names, "edges": lengths, "integrator": list(INTEGRATORS)},
    )


def measure(name: str, edges: int, fields: dict[str, Any], seed: int) -> list[list[float]]:
    """(Share, standard error) of each integrator; NaN where no light has so many edges.

    A sample of path tracing is a path that hits the lamp or is joined to it, one of bidirectional path tracing a path
    by each technique of one set of numbers, as a renderer makes them: it is dark where none brings light. One of MMLT
    is a proposal.
    """
    config = Config(**fields)
    paths = Paths(scene(name), edges)
    key = jax.random.fold_in(jax.random.key(seed), edges + 100 * sum(name.encode()))
    rows = []
    for k, integrator in enumerate((PathTracing(), BidirectionalPathTracing())):
        lit = _lit(jax.random.fold_in(key, k), Pooled(integrator.target(paths)), config.samples)
        rows.append([1 - lit, float(np.sqrt(lit * (1 - lit) / config.samples))])
    if rows[1][0] == 1:
        return [[np.nan, np.nan]] * len(INTEGRATORS)
    target = BidirectionalPathTracing().target(paths)
    kernel = multiplexed_kernel(config.sigma, config.large, close(target.n_techniques, config.sigma))
    own = jax.random.fold_in(key, len(rows))
    ran = films("chains", own, kernel, target, paths, config.runs, [config.mutations], {METHODS[0]: Lit(config.runs)})
    each = 1 - ran.sums[METHODS[0]] / config.mutations
    return [*rows, [float(each.mean()), float(sem(each.ravel()))]]


def _lit(key: Key, target: Pooled, samples: int) -> float:
    batches = -(-samples // _BATCH)
    return sum(int(_count(key, target, jnp.asarray(k))) for k in range(batches)) / (batches * _BATCH)


@eqx.filter_jit
def _count(key: Key, target: Pooled, batch: Array) -> Array:
    dtype = jnp.zeros(()).dtype
    target = cast(target, dtype)
    u = uniforms(key, batch, (target.multiplexed.dim_u, _BATCH), dtype)
    return (jax.vmap(target.log_f, in_axes=-1)(u) > -jnp.inf).sum()


COLORS = {"PT": "0.7", "BDPT": "0.25", "MMLT": "C0"}


def draw(data: xr.Dataset) -> Figure:
    """The shares by scene, a panel a length."""
    columns = min(3, data.sizes["edges"])
    rows = -(-data.sizes["edges"] // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.4 if columns == 1 else 7.0, 2.2 * rows), squeeze=False)
    place = np.arange(data.sizes["scene"])
    for panel, edges in zip(axes.flat, data.edges.to_numpy(), strict=False):
        for k, (who, color) in enumerate(COLORS.items()):
            one = data.sel(edges=edges, integrator=who)
            panel.bar(place + 0.27 * (k - 1), 100 * one.dark, 0.25, color=color, yerr=100 * one.error, label=who)
        panel.set(title=f"paths of {edges} edges", ylim=(0, 100))
        panel.set_xticks(place, [str(name) for name in data.scene.to_numpy()], fontsize=6)
        panel.minorticks_off()
    for row in axes:
        row[0].set_ylabel("samples without light (%)")
    axes.flat[0].legend(loc="upper left")
    for panel in axes.flat[data.sizes["edges"] :]:
        panel.axis("off")
    return figure


def table(data: xr.Dataset) -> Table:
    """As table 16.1, a row a scene and length."""
    result = Table("scene", "edges", *INTEGRATORS, title="flatland_zero_radiance", box=SIMPLE, padding=0)
    for name in data.scene.to_numpy():
        for edges in data.edges.to_numpy():
            shares = data.dark.sel(scene=name, edges=edges).to_numpy()
            result.add_row(str(name), str(edges), *(f"{share:.1%}" for share in shares))
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """MMLT's share against the others', in hard scenes, at every length that has light."""
    level, claims = float(data.level), []
    dark, names = data.dark.mean("edges"), [str(name) for name in data.scene.to_numpy()]
    of_pt = data.dark.sel(integrator="PT")
    hard = [name for name in names if bool((of_pt.sel(scene=name).dropna("edges") > HARD).all())]
    ours = data.sel(integrator="MMLT", drop=True)
    for who, paper in (
        ("PT", "51.9 against 98.0 %, 62.0 against 95.9 %"),
        ("BDPT", "51.9 against 97.6 %, 62.0 against 97.0 %"),
    ):
        other = data.sel(integrator=who, drop=True)
        noise = np.hypot(ours.error, other.error)
        fewer = ((other.dark - ours.dark > level * noise) | other.dark.isnull()).all("edges")
        words = [
            ("" if name in hard else "easy, ")
            + f"{name}: {float(dark.sel(scene=name, integrator='MMLT')):.1%} against "
            + f"{float(dark.sel(scene=name, integrator=who)):.1%}"
            for name in names
        ]
        claims.append(
            Claim(
                f"plane.zero-radiance-{who.lower()}",
                f"In hard scenes fewer of MMLT's samples carry no radiance than of {who}'s",
                SOURCE,
                among({name: bool(fewer.sel(scene=name)) for name in hard}),
                "holds",
                "; ".join(words) + f"; in the paper {paper}",
                f"{level:.0f} s.e., {float(level * noise.max()):.2%}; hard: over {HARD:.0%} of PT's are dark",
            )
        )
    return claims
