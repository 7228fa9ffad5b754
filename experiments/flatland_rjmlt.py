"""Bitterli et al. 2017, figures 4 and 5, in the plane: acceptance by path length; error against rays, run by run."""

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

import mcmc1d
from experiments.support.flatland_chains import METHODS, MOVES, films, mixed_kernel, mixes
from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, ratio, shown, under
from experiments.support.sweep import Sweep
from experiments.support.verdict import among, verdict
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import RJMLT
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene
from mcmc1d.metropolis import Kernel
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array

SOURCE = "Bitterli et al. 2017"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "door mirror_caustic"
    """Of the convergence."""
    shortest: int = 4
    """Edges of the shortest paths of the convergence."""
    longest: int = 4
    pixels: int = 16
    acceptance_scene: str = "box"
    acceptance_shortest: int = 2
    """The camera does not see the lamp."""
    acceptance_longest: int = 5
    states: int = 2**14
    """Exact ones at each length, with a proposal of one of four kinds each."""
    sigma: float = 0.05
    large: float = 0.1
    """The paper's share of large steps; small ones are what these and the jumps leave."""
    jump: float = 0.05
    runs: int = 64
    """Independent runs of one chain for each path length; 50 in the paper."""
    first: int = 64
    """Mutations of each length, jumps not counted, after which a run's image is looked at first."""
    doublings: int = 7
    level: float = 6.0
    """Standard errors by which what agrees may differ."""


PROFILES = {
    "quick": Config(),
    "paper": Config(
        scenes="door glossy_corner mirror_caustic box three_rooms",
        shortest=3,
        longest=6,
        acceptance_longest=10,
        states=2**18,
        runs=256,
        doublings=10,
    ),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

MARGIN = 1.25
"""Of non-inferiority: the ratio of errors up to which RJMLT counts as no worse."""
SHOWN = ("keep", "change", "jump", "aimed")
"""The moves whose acceptance is shown."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Acceptance of each kind of move by path length; the error of each run of each method on each scene."""
    fields, edges = asdict(config), list(range(config.acceptance_shortest, config.acceptance_longest + 1))
    found = progress.map("acceptance", accepted, [(k, fields, seed) for k in edges])
    names, lengths = config.scenes.split(), list(range(config.shortest, config.longest + 1))
    residuals = progress.map("convergence", converge, [(name, k, fields, seed) for name in names for k in lengths])
    shape = len(names), len(lengths), len(METHODS), config.doublings + 1, config.runs, config.pixels
    residual = np.reshape([one["residual"] for one in residuals], shape).sum(1)  # of the image of all lengths
    mean = np.reshape([one["mean"] for one in residuals], shape[:2]).sum(1)
    relative = residual / mean[:, None, None, None, None]
    steps = config.first * 2 ** np.arange(config.doublings + 1)
    measured = {name: [one[name] for one in found] for name in ("acceptance", "error", "predicted", "predicted_error")}
    return xr.Dataset(
        {
            "acceptance": (("edges", "move"), np.array(measured["acceptance"])),
            "acceptance_error": (("edges", "move"), np.array(measured["error"])),
            "predicted": ("edges", measured["predicted"]),
            "predicted_error": ("edges", measured["predicted_error"]),
            "mse": (("scene", "method", "mutations", "run"), (relative**2).mean(-1)),
            "spread": (("scene", "method", "mutations"), np.sqrt(relative.var(-2, ddof=1).mean(-1))),
            "bias": (("scene", "method", "pixel"), relative[:, :, -1].mean(-2)),
            "bias_error": (
                ("scene", "method", "pixel"),
                relative[:, :, -1].std(-2, ddof=1) / np.sqrt(config.runs),
            ),
            "rays": ("mutations", sum(lengths) * steps),
            "level": config.level,
        },
        {"edges": edges, "move": list(SHOWN), "scene": names, "method": list(METHODS)},
    )


def accepted(edges: int, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """Figure 4 at one path length: a proposal from each of many exact states, as a chain makes them on average."""
    config = Config(**fields)
    paths = Paths(scene(config.acceptance_scene).with_pixels(config.pixels), edges)
    target, key = RJMLT().target(paths), jax.random.fold_in(jax.random.key(seed), edges)
    change = mixes(target.n_techniques, config.sigma, config.large, config.jump)[METHODS[0]][1]
    kernel = mixed_kernel(config.sigma, {move: 1 / len(SHOWN) for move in SHOWN}, change)
    states = mcmc1d.exact_start(jax.random.fold_in(key, 0), target, config.states)
    w = jax.random.uniform(jax.random.fold_in(key, 1), (config.states, kernel.dim_w(target)), states.u.dtype)
    kind, chance, predicted = (np.asarray(part) for part in _proposals(kernel, target, states, w))
    each = [chance[kind == MOVES.index(move)].astype(np.float64) for move in SHOWN] + [predicted.astype(np.float64)]
    mean, error = [float(a.mean()) for a in each], [float(sem(a)) for a in each]
    return {"acceptance": mean[:-1], "error": error[:-1], "predicted": mean[-1], "predicted_error": error[-1]}


@eqx.filter_jit
def _proposals(kernel: Kernel, target: Multiplexed, states: State, w: Array) -> tuple[Array, Array, Array]:
    """Of each state: which kind of move is proposed, with what chance it is accepted, and that of a uniform jump.

    The last is predicted, from the weights at x alone: sum_ij min(w_i, w_j) / n, whichever technique made x.
    """

    def one(state: State, w: Array) -> tuple[Array, Array, Array]:
        info = kernel.step(target, state, w).info
        share = jnp.exp(jnp.stack(list(target.log_weights(state.seen.x, state.seen.log_p))))
        predicted = jnp.minimum(share[:, None], share[None]).sum() / target.n_techniques
        return info.kind[0], info.acceptance[0], predicted

    return jax.vmap(one)(states, w)


def converge(name: str, edges: int, fields: dict[str, Any], seed: int) -> dict[str, Any]:
    """Of one scene and length: by how much each run's image is off, (methods, checkpoints, runs, pixels)."""
    config = Config(**fields)
    shown = scene(name).with_pixels(config.pixels)
    paths, reference = Paths(shown, edges), image(shown, edges).values[-1]
    steps = config.first * 2 ** np.arange(config.doublings + 1)
    if reference.max() < 1e-12:  # a length without light
        return {"residual": np.zeros((len(METHODS), len(steps), config.runs, config.pixels)).tolist(), "mean": 0.0}
    target = RJMLT().target(paths)
    key = jax.random.fold_in(jax.random.key(seed), edges + 100 * sum(name.encode()))
    residual = []
    for k, (method, mix) in enumerate(mixes(target.n_techniques, config.sigma, config.large, config.jump).items()):
        # A jump traces no ray: at equal work there are more mutations.
        walked = 1 - config.jump if method.startswith("RJMLT") else 1.0
        checkpoints = np.round(steps / walked).astype(int).tolist()
        own = jax.random.fold_in(key, k)
        ran = films(method, own, mixed_kernel(config.sigma, *mix), target, paths, config.runs, checkpoints, {})
        # b as the reference has it, as in the paper (section 7.2).
        residual.append(config.pixels * reference.mean() * ran.films - reference)
    return {"residual": np.stack(residual).tolist(), "mean": float(reference.mean())}


STYLES = {"MMLT": ("C1", "-"), "MMLT, any technique": ("C4", "--"), "RJMLT": ("C0", "-"), "RJMLT, aimed": ("C2", "-.")}


def draw(data: xr.Dataset) -> Figure:
    """Acceptance by path length; for each scene the mean squared error against rays and its spread over runs."""
    scenes = data.sizes["scene"]
    columns = min(3, scenes + 1)
    rows = -(-(scenes + 1) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(7.0, 2.2 * rows), squeeze=False)
    left = axes.flat[0]
    labels = ("small step, technique kept", "small step, changed", "jump, uniform", "jump, aimed")
    for move, label, color, mark in zip(SHOWN, labels, ("C4", "C1", "C0", "C2"), "sv^o", strict=True):
        left.plot(data.edges, 100 * data.acceptance.sel(move=move), f"{mark}-", color=color, markersize=3, label=label)
    left.plot(data.edges, 100 * data.predicted, "_", color="black", markersize=7, label="jump, predicted")
    left.set(xlabel="edges", ylabel="acceptance (%)", ylim=(0, 205), yticks=range(0, 101, 20))  # room for the legend
    left.set_xticks(data.edges.to_numpy())
    left.legend(loc="upper left", handlelength=1.8)
    for panel, name in zip(axes.flat[1:], data.scene.to_numpy(), strict=False):
        here = data.mse.sel(scene=name)
        for method, (color, dashes) in STYLES.items():
            mse = here.sel({"method": method})
            mean, spread = mse.mean("run"), mse.std("run", ddof=1)
            low = np.maximum(mean - spread, 0.1 * mean)  # a spread over the mean has no lower end on a log axis
            panel.fill_between(data.rays, low, mean + spread, color=color, alpha=0.15, linewidth=0)
            panel.plot(data.rays, mean, color=color, linestyle=dashes, label=method)
        panel.set(xscale="log", yscale="log", xlabel="rays", ylabel="MSE (of the squared mean)", title=str(name))
    axes.flat[1].legend(loc="lower left")
    for panel in axes.flat[scenes + 1 :]:
        panel.axis("off")
    return figure


def table(data: xr.Dataset) -> Table:
    """At the most rays: mean squared error, its spread over runs, and the spread of a pixel from run to run."""
    result = Table(
        "scene", "method", "MSE", "s.e.", "spread of MSE", "pixel, run to run", title="flatland_rjmlt", box=SIMPLE,
        padding=0,
    )  # fmt: skip
    for name in data.scene.to_numpy():
        for method in METHODS:
            mse = data.mse.sel({"scene": name, "method": method}).isel(mutations=-1)
            mean, sd = float(mse.mean()), float(mse.std(ddof=1))
            spread = float(data.spread.sel({"scene": name, "method": method}).isel(mutations=-1))
            error = sd / np.sqrt(data.sizes["run"])
            result.add_row(str(name), method, f"{mean:.4g}", f"{error:.2g}", f"{sd / mean:.0%}", f"{spread:.2%}")
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Acceptance by kind of move, the images' exactness, the error and its spread against MMLT's."""
    level = float(data.level)
    rate = {move: data.acceptance.sel(move=move).to_numpy() for move in SHOWN}
    blur = {move: data.acceptance_error.sel(move=move).to_numpy() for move in SHOWN}
    first, last = int(data.edges[0]), int(data.edges[-1])
    gap = (rate["keep"] - rate["change"]) / np.hypot(blur["keep"], blur["change"])
    falls = (rate["keep"][0] - rate["keep"][-1]) / np.hypot(blur["keep"][0], blur["keep"][-1])
    noise = np.hypot(blur["jump"], data.predicted_error.to_numpy())
    off = float(np.max(np.abs(rate["jump"] - data.predicted.to_numpy()) / noise))

    def ends(move: str) -> str:
        return f"{rate[move][0]:.1%} at {first} edges, {rate[move][-1]:.1%} at {last}"

    claims = [
        Claim(
            "plane.rjmlt-small-steps",
            "The acceptance of small steps falls with length where the technique is kept, and is lower where not",
            f"{SOURCE}, fig. 4 (1 % at 10 edges where it changes)",
            verdict(float(gap.min()) > level and falls > level),
            "holds",
            f"kept: {ends('keep')}; changed: {ends('change')}",
            f"{level:.0f} s.e., {level * max(blur['keep'].max(), blur['change'].max()):.2%}",
        ),
        Claim(
            "plane.rjmlt-jumps-accepted",
            "Jumps to any technique alike are nearly always accepted",
            f"{SOURCE}, fig. 4 (close to 100 %)",
            verdict(bool(rate["jump"].min() > 0.95)),
            "fails",
            f"{ends('jump')}; the weights predict it, {off:.1f} s.e. off at most",
            f"95 %; the prediction, sum_ij min(w_i, w_j) / n, to {level * float(noise.max()):.2%}",
        ),
        Claim(
            "plane.rjmlt-jump-law",
            "A jump is accepted as the weights of exact samples say, and the path's geometry does not matter",
            f"{SOURCE}, eq. 14",
            verdict(off < level),
            "holds",
            f"{off:.1f} standard errors at most over {data.sizes['edges']} lengths",
            f"{level:.0f} s.e., {level * float(noise.max()):.2%}",
        ),
        Claim(
            "plane.rjmlt-aimed-accepted",
            "Jumps aimed by the weights are always accepted",
            f"{SOURCE}, sec. 4, eq. 14",
            verdict(bool(rate["aimed"].min() > 0.999)),
            "holds",
            ends("aimed"),
            "99.9 %: in float32 an inverse is a little off, and may leave the cube",
        ),
    ]
    bias = float((np.abs(data.bias) / data.bias_error).max())
    claims.append(
        Claim(
            "plane.rjmlt-exact",
            "MMLT and RJMLT agree with the exact image in every pixel",
            "ours, flatland",
            verdict(bias < level),
            "holds",
            f"{bias:.1f} standard errors at most",
            f"{level:.0f} s.e., {float(level * data.bias_error.mean('pixel').max()):.1%} of the mean",
        )
    )
    runs = data.sizes["run"]
    mse = data.mse.isel(mutations=-1)
    mean, sd = mse.mean("run"), mse.std("run", ddof=1)
    of_plain, its_spread = (x.sel({"method": METHODS[0]}) for x in (mean, sd))  # `method=` is xarray's own argument
    for method in METHODS[2:]:
        found, spread = (x.sel({"method": method}) for x in (mean, sd))
        of_mmlt, of_its = ((x / y).to_series().to_dict() for x, y in ((found, of_plain), (spread, its_spread)))
        own, plain = (mse.sel({"method": m}) for m in (method, METHODS[0]))
        pairs = {str(k): (own.sel(scene=k).to_numpy(), plain.sel(scene=k).to_numpy()) for k in of_mmlt}
        claims.append(
            Claim(
                f"plane.{method.lower().replace(', ', '-')}-convergence",
                f"At equal rays {method}'s squared error is at most {MARGIN:g} times MMLT's (geometric mean)",
                f"{SOURCE}, fig. 5",
                among({name: under(MARGIN, ratio(above, below, DECIDES)) for name, (above, below) in pairs.items()}),
                "holds",
                "; ".join(
                    f"{name}: times {shown(ratio(above, below))}; MSE {of_mmlt[name]:.2f} of MMLT's, its spread "
                    f"{of_its[name]:.2f}"
                    for name, (above, below) in pairs.items()
                ),
                f"t interval of {runs} runs, shown of 95 %, deciding at {DECIDES:g}",
            )
        )
    return claims
