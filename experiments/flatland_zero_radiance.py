"""Pharr, Jakob, Humphreys, table 16.1, in the plane: how many samples of each integrator carry no radiance.

The book's numbers are of two scenes of triangles, over paths of all lengths together; here they are of one length at a
time, of 4 edges alone in the quick profile and of 3 to 8 in the paper one. The chains have pbrt-v3's defaults, small
steps of 0.01 and 30 % large ones; which values the table's renderings had the book does not say. A sample of "BDPT, all
techniques" is what pbrt traces for one sample of a pixel: a path by each technique of one set of numbers, 3k - 1 rays
for k edges before a pinhole. (`flatland_mmlt`'s BDPT is another: one technique at random for each path, at k rays; its
PSSMLT has all techniques, at 3k - 1.) A sample of MMLT costs k rays, one of path tracing k + 1.
"""

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
from scipy.stats import t as student

from experiments.support.flatland_chains import METHODS, Lit, close, films, multiplexed_kernel
from experiments.support.framework import Claim, between, chosen
from experiments.support.sweep import Sweep
from experiments.support.verdict import among
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import BidirectionalPathTracing, PathTracing
from mcmc1d.flatland.scenes import catalogue, scene
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
    sigma: float = 0.01
    large: float = 0.3
    samples: int = 2**16
    """Of path tracing and of bidirectional path tracing, of each length."""
    runs: int = 128
    """Chains, from exact starts."""
    mutations: int = 2048
    """Of each chain."""
    level: float = 1e-4
    """With which a claim fails that is true of all scenes and lengths, or holds that is true of none."""


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

ALL = "BDPT, all techniques"
INTEGRATORS = ("PT", ALL, "MMLT")
HARD = 0.9
"""A scene is hard, as the paper's two are, where more of path tracing's samples than that are dark at every length."""
_BATCH = 2**14


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The share of each, by scene and length."""
    names, lengths = chosen(config.scenes, catalogue()), between(config.shortest, config.longest)
    points = [(name, k, asdict(config), seed) for name in names for k in lengths]
    found = np.array(progress.map("scenes and lengths", measure, points), np.float64)
    found = found.reshape(len(names), len(lengths), len(INTEGRATORS), 2)
    dimensions = ("scene", "edges", "integrator")
    return xr.Dataset(
        {"dark": (dimensions, found[..., 0]), "error": (dimensions, found[..., 1])}
        | {"level": config.level, "runs": config.runs},
        {"scene": names, "edges": lengths, "integrator": list(INTEGRATORS)},
    )


def measure(name: str, edges: int, fields: dict[str, Any], seed: int) -> list[list[float]]:
    """(Share, standard error) of each integrator; NaN where no light has so many edges.

    A sample of path tracing is a path that hits the lamp or is joined to it, one of BDPT a path by each technique of
    one set of numbers: it is dark where none brings light. One of MMLT is a proposal.
    """
    config = Config(**fields)
    paths = Paths(scene(name), edges)
    key = jax.random.fold_in(jax.random.key(seed), edges + 100 * sum(name.encode()))
    rows = []
    for k, integrator in enumerate((PathTracing(), BidirectionalPathTracing())):
        lit = _lit(jax.random.fold_in(key, k), Pooled(integrator.target(paths)), config.samples)
        # Where none was lit, or all were, the share is not known exactly: one more of either.
        share = (lit * config.samples + 1) / (config.samples + 2)
        rows.append([1 - lit, float(np.sqrt(share * (1 - share) / config.samples))])
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


COLORS = {"PT": "0.7", ALL: "0.25", "MMLT": "C0"}


def draw(data: xr.Dataset) -> Figure:
    """The shares by scene, a panel a length."""
    columns = min(3, data.sizes["edges"])
    rows = -(-data.sizes["edges"] // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.4 if columns == 1 else 7.0, 2.2 * rows + 0.3), squeeze=False)
    place = np.arange(data.sizes["scene"])
    for panel, edges in zip(axes.flat, data.edges.to_numpy(), strict=False):
        for k, (who, color) in enumerate(COLORS.items()):
            one = data.sel(edges=edges, integrator=who)
            panel.bar(place + 0.27 * (k - 1), 100 * one.dark, 0.25, color=color, yerr=200 * one.error, label=who)
        panel.set(title=f"paths of {edges} edges", ylim=(0, 107))
        panel.axhline(100, color="0.6", linewidth=0.5, linestyle=":", zorder=0)
        panel.set_xticks(place, [str(name).replace("_", "\n") for name in data.scene.to_numpy()], fontsize=6)
        panel.set_yticks(range(0, 101, 20))
        panel.minorticks_off()
    for row in axes:
        row[0].set_ylabel("dark samples (%); bars: 2 s.e.")
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(COLORS))
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
    claims, mean = [], data.dark.mean("edges")
    lit = [str(name) for name in data.scene.to_numpy() if data.dark.sel(scene=name).notnull().any()]
    of_pt = data.dark.sel(integrator="PT")
    hard = [name for name in lit if bool((of_pt.sel(scene=name).dropna("edges") > HARD).all())]
    ours = data.sel(integrator="MMLT", drop=True)
    level, tests = float(data.level), max(1, len(hard) * data.sizes["edges"])
    # By the chains' freedom, the smaller one.
    far = float(student.isf(level / (2 * tests), int(data.runs) - 1))
    for who, name, paper in (
        ("PT", "pt", "51.9 against 98.0 %, 62.0 against 95.9 %"),
        (ALL, "bdpt", "51.9 against 97.6 %, 62.0 against 97.0 %"),
    ):
        other = data.sel(integrator=who, drop=True)
        noise = np.hypot(ours.error, other.error)
        words = [
            ("" if scene in hard else "easy, ")
            + f"{scene}: {float(mean.sel(scene=scene, integrator='MMLT')):.1%} against "
            + f"{float(mean.sel(scene=scene, integrator=who)):.1%}"
            for scene in lit
        ]
        claims.append(
            Claim(
                f"plane.zero-radiance-{name}",
                f"In hard scenes fewer of MMLT's samples carry no radiance than of those of {who}",
                SOURCE,
                among({scene: _fewer((other.dark - ours.dark).sel(scene=scene), far * noise) for scene in hard}),
                "holds",
                "; ".join(words) + f"; in the book {paper}",
                f"family-wise {level:.0e} over {tests} scenes and lengths (t, {int(data.runs)} chains: {far:.1f} s.e., "
                f"{float(far * noise.max()):.2%} at most); hard: over {HARD:.0%} of PT's are dark",
            )
        )
    return claims


def _fewer(gap: xr.DataArray, blur: xr.DataArray) -> bool | None:
    """Whether a gap is positive at every length that has light; None where its blur does not decide it."""
    gap = gap.dropna("edges")
    blur = blur.sel(scene=gap.scene, edges=gap.edges)
    if bool((gap > blur).all()):
        return True
    return False if bool((gap < -blur).any()) else None
