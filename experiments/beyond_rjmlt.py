"""Beyond reversible jump MLT, section 8: jumps between dimensions, two samples at once, steps sized by the Jacobian."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.beyond_rjmlt_dimensions import RIGHT, TRANSDIMENSIONAL, LineAndSquare, kernels
from experiments.support.beyond_rjmlt_pairs import HalfTheAngles, pairs
from experiments.support.beyond_rjmlt_scaled import SCALED_AT, SIZES, SMOOTH, TECHNIQUES, UnaccountedStep, times
from experiments.support.framework import Claim
from experiments.support.long import long_run
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, passes, verdict
from mcmc1d import verify
from mcmc1d.moves.scaled import ScaledStep
from mcmc1d.state import Multiplexed
from mcmc1d.techniques.gaussian import BoxMuller
from mcmc1d.types import Array, Float
from mcmc1d.verify.goodness import expected_distance, total_variation

SOURCE = "Bitterli et al. 2017"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    replicas: int = 2**15
    """Of each verification."""
    chains: int = 2**12
    """Of the simulations that count how often each dimension is visited."""
    steps: int = 256
    points: int = 2**15
    """Of a net of the transition operators."""


PROFILES = {"quick": Config(), "paper": Config(replicas=2**19, chains=2**15, steps=2048, points=2**18)}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Verifications, shares of the square, operators."""
    cells, reports = [], []
    todo = kernels()
    for k, (name, move) in enumerate(todo.items()):
        simulated = long_run(
            f"jumps, {name}",
            jax.random.fold_in(jax.random.key(seed), k),
            move,
            TRANSDIMENSIONAL,
            steps=config.steps,
            chains=config.chains,
            blocks=16,
            estimators={"cells": mcmc1d.Expectation(_cell)},
        )
        cells.append([simulated.mean("cells"), simulated.standard_error("cells")])
        if name in RIGHT:
            reports.append(verify.verify(move, TRANSDIMENSIONAL, replicas=config.replicas, seed=seed, name=name))
        progress("jumps between dimensions", k + 1, len(todo))
    technique = BoxMuller((0.0, 0.3), 0.8)
    banana, move = pairs(technique)
    reports.append(verify.verify(move, banana, replicas=config.replicas, seed=seed, name="Box-Muller"))
    progress("two samples at once", 1, 1)
    contracts = [verify.check_technique(t, dtypes=(np.float64,)) for t in (technique, HalfTheAngles())]
    trips = [max(c.error for c in found.checks if "inverse(forward" in c.equation) for found in contracts]
    target, edges = Multiplexed(SMOOTH, TECHNIQUES["poor match"]), np.linspace(0, 1, 21)
    step = ScaledStep(SCALED_AT)
    reports.append(verify.verify(step, target, replicas=config.replicas, seed=seed))
    progress("steps by the Jacobian", 1, 1)
    laws = [
        verify.transition_operator(move, target, points=config.points).law_of(edges)
        for move in (step, UnaccountedStep(step))
    ]
    masses = SMOOTH.bin_masses(edges)
    return xr.Dataset(
        {
            "cells": (("jump", "moment", "cell"), np.array(cells)),
            "cells_exact": ("cell", LineAndSquare().cells.ravel()),
            "verdict": ("verified", [r.verdict.value for r in reports]),
            "p": ("verified", [r.p_value for r in reports]),
            "gap": ("verified", [r.gap for r in reports]),
            "contract": ("inverse", [bool(found) for found in contracts]),
            "round_trip": ("inverse", trips),
            "scaled_law": (("step", "bin"), np.array([law.masses.sum(0) for law in laws])),
            "noise": ("step", [law.noise for law in laws]),
            "exact": ("bin", masses / masses.sum()),
            "time": (("technique", "kind", "size"), times()),
        },
        {
            "jump": list(todo),
            "moment": ["mean", "error"],
            "verified": [*RIGHT, "Box-Muller", "scaled step"],
            "inverse": ["right", "half the angles"],
            "step": ["scaled", "taken for symmetric"],
            "technique": list(TECHNIQUES),
            "kind": ["fixed in u", "fixed in x"],
            "size": SIZES,
        },
    )


def _cell(x: Float[Array, " 2"]) -> Float[Array, " 32"]:
    """One in the cell of x, zero elsewhere."""
    column, row = jnp.clip((4 * x).astype(jnp.int32), 0, jnp.array([7, 3]))
    return (jnp.arange(32) == 4 * column + row).astype(x.dtype)


def cell_error(data: xr.Dataset, jump: str) -> tuple[float, float, float]:
    """The total variation of the cells' law, what mere noise makes it, and the largest error in standard errors."""
    (mean, error), exact = data.cells.sel(jump=jump).to_numpy(), data.cells_exact.to_numpy()
    return total_variation(mean, exact), expected_distance(error), float((np.abs(mean - exact) / error).max())


def draw(data: xr.Dataset) -> Figure:
    """The share of the square by each jump; the scaled step's law; autocorrelation against size."""
    figure, (a, b, c) = plt.subplots(1, 3, figsize=(7.0, 2.3))
    jumps = [str(jump) for jump in data.jump.to_numpy()]
    errors = np.array([cell_error(data, jump) for jump in jumps])
    a.bar(np.arange(4), errors[:, 0], 0.6, color=["C0" if jump in RIGHT else "C1" for jump in jumps])
    a.plot(np.arange(4), errors[:, 1], "k_", markersize=12, label="expected of mere noise")
    a.set_xticks(np.arange(4), [jump.replace(" ", "\n", 1).replace(", ", ",\n") for jump in jumps])
    a.set(ylabel="total variation, 32 cells", yscale="log", title="jumps between line and square")
    a.set_ylim(errors[:, :2].min() / 3, 0.4)
    a.legend()
    x = (np.arange(data.sizes["bin"]) + 0.5) / data.sizes["bin"]
    for step, style in zip(data.step.to_numpy(), ("-", "--"), strict=True):
        b.plot(x, data.sizes["bin"] * data.scaled_law.sel(step=step), style, label=str(step))
    b.plot(x, data.sizes["bin"] * data.exact, "k.", markersize=2.5, label="exact")
    b.set(xlabel="x", ylabel="density", ylim=(0, None), title="step size by the Jacobian: its law")
    b.legend()
    for technique, colour in zip(data.technique.to_numpy(), ("C1", "C0"), strict=True):
        for kind, style in zip(data.kind.to_numpy(), ("o:", "o-"), strict=True):
            values = data.time.sel(technique=technique, kind=kind)
            c.plot(data.size, values, style, color=colour, markersize=3, label=f"{kind}, {technique}")
    c.set(xscale="log", yscale="log", xlabel="size of the step", ylabel="autocorrelation time of x")
    c.set_xticks(SIZES, [f"{s:g}" for s in SIZES])
    c.minorticks_off()
    c.set_title("step size by the Jacobian: mixing")
    c.legend(loc="lower left", fontsize=5.5)
    return figure


def table(data: xr.Dataset) -> Table:
    """The claims' numbers."""
    result = Table("claim", "verdict", "measured", box=SIMPLE, padding=0, title="beyond_rjmlt")
    for claim in judge(data):
        result.add_row(claim.id, claim.verdict, claim.number)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """What is right, each beside the mistake that it is easily taken for."""
    tested = detects(data.gap)
    report = {str(name): data.sel(verified=name) for name in data.verified.to_numpy()}
    passed = {name: passes([one.verdict.values]) for name, one in report.items()}
    told = {name: f"{one.verdict.values!s}, p {float(one.p):.2g}" for name, one in report.items()}
    claims = []
    for jump, id_, statement in (
        ("same numbers", "beyond.jump-numbers", "A jump between line and square at fixed u keeps the law"),
        ("same x", "beyond.jump-x", "So does one that keeps x and makes y of the spare number"),
        ("same numbers, no p", "beyond.jump-numbers-no-p", "The ratio of the first may be that of f alone"),
        ("same x, no stretch", "beyond.jump-x-no-stretch", "The second may leave out |dy/d spare|, its Jacobian"),
    ):
        tv, noise, off = cell_error(data, jump)
        number = f"32 cells: TV {tv:.4f} ({noise:.4f} by noise), {off:.1f} standard errors at most"
        held = "8 standard errors of 16 blocks (t, a false alarm in 4e4 runs)"
        claims.append(
            Claim(
                id_,
                statement,
                f"{SOURCE}, sec. 8.2; Green 1995",
                verdict(off < 8, passed.get(jump, True)),
                "holds" if jump in RIGHT else "fails",
                f"{told[jump]}; {number}" if jump in RIGHT else number,
                f"{tested}; {held}" if jump in RIGHT else held,
            )
        )
    (right, wrong), (ok, bad) = data.round_trip.to_numpy(), data.contract.to_numpy()
    claims.append(
        Claim(
            "beyond.box-muller",
            "Box-Muller, two samples at once, has an exact inverse; jumps to and from it keep the law",
            f"{SOURCE}, sec. 8.1",
            verdict(bool(ok), passed["Box-Muller"]),
            "holds",
            f"round trip {right:.1e}; {told['Box-Muller']}",
            f"contract, 1e-10 by condition; {tested}",
        )
    )
    claims.append(
        Claim(
            "beyond.box-muller-quadrant",
            "Its angle may be inverted by the ratio of the two alone",
            "ours",
            verdict(bool(bad)),
            "fails",
            f"round trip off by {wrong:.2g}",
            "contract, 1e-10 by condition",
        )
    )
    masses = data.exact.to_numpy()
    off = [total_variation(law, masses) for law in data.scaled_law.to_numpy()]
    noise = data.noise.to_numpy()
    claims.append(
        Claim(
            "beyond.scaled-step",
            "A step in u of size sigma p(x), with its determinant, keeps the law",
            f"{SOURCE}, sec. 8.2",
            verdict(passed["scaled step"], off[0] < 1e-3 + 2 * noise[0]),
            "holds",
            f"{told['scaled step']}; TV {off[0]:.1e} by the transition operator",
            f"{tested}; TV 1e-3 beyond twice the net's noise, {noise[0]:.1e}",
        )
    )
    claims.append(
        Claim(
            "beyond.scaled-symmetric",
            "It may be taken for symmetric",
            "ours",
            verdict(off[1] < 1e-3 + 2 * noise[1]),
            "fails",
            f"TV {off[1]:.4f} by the transition operator",
            f"TV 1e-3 beyond twice the net's noise, {noise[1]:.1e}",
        )
    )
    best = data.time.min("size").to_numpy()
    fits = best[0, 1] < best[0, 0], best[1, 1] < best[1, 0]
    condition = "holds if the technique matches the target poorly"
    largest = float(data["size"][-1])
    ends = [
        str(name)
        for name in data.technique.to_numpy()
        if bool((data.time.sel(technique=name).idxmin("size") == largest).any())
    ]
    claims.append(
        Claim(
            "beyond.scaled-mixing",
            "A step sized by the Jacobian lowers the autocorrelation time",
            f"{SOURCE}, sec. 8.2",
            {(True, True): "holds", (True, False): condition}.get(fits, "fails"),
            condition,
            f"of x, at the best size: {best[0, 0]:.1f} fixed in u, {best[0, 1]:.1f} in x; with p about f, "
            f"{best[1, 0]:.1f} and {best[1, 1]:.1f}",
            "chain on 600 cells of u, by its fundamental matrix; "
            f"{data.sizes['size']} sizes from {float(data['size'][0]):g} to {largest:g}"
            + (f", the best of them the last with a {' and a '.join(ends)}" if ends else ""),
        )
    )
    return claims
