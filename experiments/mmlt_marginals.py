"""Multiplexed MLT: the marginal in x is f / b, each technique has its MIS weight; what breaks it, and by how much."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support import mmlt_marginals_integrals
from experiments.support.framework import Claim
from experiments.support.long import long_run
from experiments.support.mmlt_marginals_integrals import NAMES, SOURCE, TECHNIQUES, F
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, near, passes, verdict
from mcmc1d.checks import require_instance
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import Mixture, Move, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.moves.exchange import CoordinateStep
from mcmc1d.pooled import Floored, floored, integral, samples
from mcmc1d.quadrature import integrate
from mcmc1d.targets import DensityOf
from mcmc1d.techniques import Uniform
from mcmc1d.verify import enumerate_kernel, ring, transition_operator, verify
from mcmc1d.verify.finite import RingStep
from mcmc1d.verify.goodness import total_variation
from mcmc1d.weights import Balance, FromFunction, Maximum, PathSpace, Power, Weights


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    sigma: float = 0.1
    """Of the small step, which comes with a technique change, each technique alike."""
    bins: int = 40
    points: int = 2**16
    """Of the nets of the transition operators, for each technique."""
    replicas: int = 2**14
    """Of each verification."""
    chains: int = 2**13
    steps: int = 256
    blocks: int = 16


PROFILES = {"quick": Config(), "paper": Config(points=2**20, replicas=2**18, chains=2**15, steps=2048)}

HEURISTICS: dict[str, Weights] = {"balance": Balance(), "power": Power(), "maximum": Maximum()}
LOST = FromFunction(lambda x, p: jnp.concatenate([0.6 * p[:2] / p[:2].sum(), 0.4 * jnp.ones_like(p[:1])]))
"""A partition of unity that is positive where the third technique's density is zero."""
VERIFIED = (*HEURISTICS, "path space", "floor", "block-wise")


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Laws by operators, by quadrature, by enumeration, by verification and by a run."""
    edges = np.linspace(0, 1, config.bins + 1)
    step = StepAndChange(SmallStep(config.sigma))
    targets = {name: mcmc1d.Multiplexed(F, TECHNIQUES, weights) for name, weights in HEURISTICS.items()}
    naive = mcmc1d.Multiplexed(F, (Uniform(),) * 3, PathSpace(Balance(), TECHNIQUES))
    lost = eqx.tree_at(lambda target: target.weights, targets["balance"], LOST)  # Multiplexed itself refuses it
    law = partial(_operator, config, step)
    operators = {name: law(target) for name, target in (*targets.items(), ("path space", naive), ("lost", lost))}
    laws = {name: operator.law_of(edges) for name, operator in operators.items()}
    progress("operators", 1, 1)
    exact = {name: target.joint_masses(edges) for name, target in targets.items()}
    exact["path space"] = naive.joint_masses(edges)
    kept = _kept(lost, edges)
    exact["lost"] = kept / kept.sum()

    size: dict[str, Any] = {"steps": config.steps, "chains": config.chains, "blocks": config.blocks}
    joint = {}
    for k, (name, target) in enumerate((*targets.items(), ("lost", lost))):
        key = jax.random.fold_in(jax.random.key(seed), k)
        estimators = {"x": mcmc1d.Histogram(config.bins, joint=True)}
        found = long_run(f"histogram, {name}", key, step, target, **size, estimators=estimators)
        joint[name] = found.mean("x")
        progress("histograms", k + 1, 4)

    floor = floored(targets["balance"])
    reports = []
    todo: list[tuple[mcmc1d.Multiplexed, Move | Kernel]] = [*((target, step) for target in targets.values())]
    todo += [(naive, step), (floor, SmallStep(config.sigma)), (floor, CoordinateStep(0.3))]
    for k, (target, kernel) in enumerate(todo):
        reports.append(verify(kernel, target, seed=seed, replicas=config.replicas, name=VERIFIED[k]))
        progress("verification", k + 1, len(todo))
    b = float(integral(F))
    shown = list(operators)
    return xr.Dataset(
        {
            "exact": (("law", "technique", "bin"), np.stack([exact[name] for name in shown])),
            "operator": (
                ("law", "technique", "bin"),
                np.stack([laws[name].masses for name in shown]),
            ),
            "noise": ("law", [laws[name].noise for name in shown]),
            "time": ("law", [operators[name].integrated_autocorrelation_time(lambda x: x) for name in shown]),
            "acceptance": (
                ("space", "kind"),
                np.stack([_acceptance(config, t, seed) for t in (naive, targets["balance"])]),
            ),
            "joint": (("run", "technique", "bin"), np.stack(list(joint.values()))),
            "density": ("bin", F.bin_masses(edges) / b),
            "b": b,
            **mmlt_marginals_integrals.measure(targets["balance"]),
            "floor_integral": float(Floored(targets["balance"]).bin_masses((np.array([0, 1.0]), edges)).sum()),
            "floor_law": ("what", list(_floor_error(config, floor, edges, exact["balance"].sum(0)))),
            "kept": float(kept.sum() / b),
            "refused": _refusal(),
            "ring": _on_a_ring(),
            "verdict": ("verified", [report.verdict.value for report in reports]),
            "p": ("verified", [report.p_value for report in reports]),
            "gap": ("verified", [report.gap for report in reports]),
            "replicas": config.replicas,
        },
        {
            "law": shown,
            "what": ["distance", "noise"],
            "run": list(joint),
            "space": ["path space", "balance"],
            "technique": list(NAMES),
            "kind": ["small step", "change"],
            "bin": (edges[1:] + edges[:-1]) / 2,
            "verified": list(VERIFIED),
        },
    )


def _operator(config: Config, step: Move, target: mcmc1d.Multiplexed):
    return transition_operator(step, target, points=config.points, x_cells=1)  # x is a function of (i, u)


def _kept(target: mcmc1d.Multiplexed, edges: np.ndarray) -> np.ndarray:
    """The integral of w_i f over each bin, where technique i can go."""

    def shares(x):
        log_p = [t.log_prob(x) for t in TECHNIQUES]
        weights = jnp.exp(jnp.stack(list(target.weights.log_weights(x, log_p))))
        return jnp.where(jnp.stack(log_p) > -jnp.inf, weights, 0) * DensityOf(F)(x)

    return integrate(shares, edges, target.breaks)[0].T


def _refusal() -> str:
    """What `Multiplexed` says of the partition that loses mass."""
    try:
        mcmc1d.Multiplexed(F, TECHNIQUES, LOST)
    except ValueError as error:
        return str(error)
    return ""


def _acceptance(config: Config, target: mcmc1d.Multiplexed, seed: int) -> list[float]:
    """Of small steps alone and of technique changes alone, from exact starts."""
    moves = {"small step": (0.5, SmallStep(config.sigma)), "change": (0.5, TechniqueChange())}
    estimators = {"acceptance": mcmc1d.Acceptance()}
    found = mcmc1d.run(jax.random.key(seed), Mixture(moves), target, steps=16, chains=2**13, estimators=estimators)
    return [found.acceptance()[name] for name in moves]


def _floor_error(
    config: Config, floor: mcmc1d.Multiplexed, edges: np.ndarray, exact: np.ndarray
) -> tuple[float, float]:
    """The total variation of the law in x that the chain over (u_t, u) keeps, and the net's noise."""
    operator = transition_operator(SmallStep(config.sigma), floor, points=config.points)
    own, coarse = require_instance(floor.target, Floored, "the target of the floored index"), edges[::4]
    law = operator.law_of(coarse, lambda u: samples(own, u))
    return total_variation(law.masses[0], exact.reshape(-1, 4).sum(1)), law.noise


def _on_a_ring() -> float:
    """The residual of a step with a technique change on a ring of five states and three techniques, enumerated."""
    weights = FromFunction(
        lambda x, p: jnp.stack([0.2 + 0.5 * (x > 0.6), 0.3 - 0.2 * (x > 0.6), 0.5 - 0.3 * (x > 0.6)])
    )
    target, states = ring([1, 3, 0.5, 2, 4.0], (Uniform(),) * 3, weights=weights)
    kernel = mcmc1d.Cycle(
        [RingStep(5, {1: 0.75, -1: 0.25}), TechniqueChange([[0.2, 0.5, 0.3], [0.1, 0.1, 0.8], [0.6, 0.4, 0]])]
    )
    found = enumerate_kernel(kernel, target, states, inner=8)
    wanted = np.array([[0.2, 0.2, 0.2, 0.7, 0.7], [0.3, 0.3, 0.3, 0.1, 0.1], [0.5, 0.5, 0.5, 0.2, 0.2]])
    law = (wanted * [1, 3, 0.5, 2, 4]).ravel()
    return max(found.residual, total_variation(found.law, law / law.sum()))


def draw(data: xr.Dataset) -> Figure:
    """Density of x and share of each technique, for three heuristics and for weights that lose mass."""
    figure, axes = plt.subplots(2, 4, figsize=(7.0, 2.7), sharex=True, sharey="row")
    x, width = data.bin.to_numpy(), 1 / data.sizes["bin"]
    for name, (top, bottom) in zip(data.run.to_numpy(), axes.T, strict=True):
        joint, exact = data.joint.sel(run=name).to_numpy(), data.exact.sel(law=name).to_numpy()
        wrong = name == "lost"
        top.set_title("left part 0.4 everywhere: refused" if wrong else str(name), color="C1" if wrong else "black")
        top.bar(x, joint.sum(0) / width, width, color="C1" if wrong else "C0", alpha=0.5, linewidth=0)
        top.plot(x, data.density / width, color="black", linewidth=0.8, label="f / b")
        if wrong:
            top.plot(
                x, exact.sum(0) / width, color="C3", linewidth=0.8, linestyle=(0, (3, 1)), label="what is left of f"
            )
            top.legend(loc="upper right", bbox_to_anchor=(1.03, 1.08))
        for k, technique in enumerate(NAMES):
            bottom.plot(x, joint[k] / joint.sum(0), color=f"C{(0, 4, 2)[k]}", label=technique)
            bottom.plot(x, exact[k] / exact.sum(0), color="black", linewidth=0.6, linestyle=(0, (2, 1.5)))
        bottom.set_xlabel("x")
    axes[0, 0].set(ylabel="density of x", ylim=(0, 2.9))
    axes[1, 0].set(ylabel="share of technique", ylim=(0, 1.02))
    handles, labels = axes[1, 0].get_legend_handles_labels()
    handles.append(Line2D([], [], color="black", linewidth=0.6, linestyle=(0, (2, 1.5))))
    figure.legend(handles, [*labels, "exact MIS weight"], loc="outside lower center", ncols=4)
    return figure


def table(data: xr.Dataset) -> Table:
    """Each law's distance from the exact one, and its autocorrelation."""
    columns = ("weights", "TV x", "TV i,x", "noise", "IAT of x")
    result = Table(*columns, title="mmlt_marginals: operators' laws", box=SIMPLE, padding=0)
    for name in data.law.to_numpy():
        here = data.sel(law=name)
        cells = (*_distances(data, str(name)), float(here.noise))
        result.add_row(str(name), *(f"{c:.5f}" for c in cells), f"{float(here.time):.2f}")
    return result


def _distances(data: xr.Dataset, name: str) -> tuple[float, float]:
    """The total variations of the operator's law from the exact one, in x and in (i, x)."""
    here = data.sel(law=name)
    law, exact = here.operator.to_numpy(), here.exact.to_numpy()
    return total_variation(law.sum(0), exact.sum(0)), total_variation(law, exact)


def _verified(data: xr.Dataset, names: tuple[str, ...]) -> tuple[bool | None, str, str]:
    """Whether all pass, their p-values, and what they were held to."""
    here = data.sel(verified=list(names))
    passed = passes(here.verdict.to_numpy())
    number = f"verify {'PASS' if passed else '/'.join(here.verdict.to_numpy())}, p {float(here.p.min()):.2g}"
    return passed, number, detects(here.gap)


def judge(data: xr.Dataset) -> list[Claim]:
    """Each claim, with an exact and a statistical number."""
    b = float(data.b)
    noise = {str(name): float(data.noise.sel(law=name)) for name in data.law.to_numpy()}
    most = 2 * max(noise[name] for name in HEURISTICS)
    nets = f"TV twice the net's noise, {most:.1e} at most (open to four times)"
    claims = mmlt_marginals_integrals.claims(data)

    def claim(
        name: str, statement: str, where: str, true: tuple[bool | None, ...], expected: str, number: str, held: str
    ) -> None:
        claims.append(Claim(f"mmlt.{name}", statement, where, verdict(*true), expected, number, held))

    passed, number, held = _verified(data, tuple(HEURISTICS))
    marginal, share = (max(_distances(data, name)[k] for name in HEURISTICS) for k in (0, 1))
    ring_error = float(data.ring)
    claim(
        "marginal",
        "The extended chain's marginal in x is f / b: balance, power and maximum heuristic",
        f"{SOURCE}, eqs. 16-20",
        (*(near(_distances(data, name)[0], noise[name]) for name in HEURISTICS), passed),
        "holds",
        f"operators' TV {marginal:.1e}; {number}",
        f"{nets}; {held}",
    )
    claim(
        "share",
        "The share of each technique given x is its MIS weight: balance, power and maximum heuristic",
        f"{SOURCE}, eqs. 16-20",
        (*(near(_distances(data, name)[1], noise[name]) for name in HEURISTICS), ring_error < 1e-12, passed),
        "holds",
        f"operators' TV of (i, x) {share:.1e}; enumerated on a ring {ring_error:.1e}; {number}",
        f"{nets}; ring 1e-12; {held}",
    )
    passed, number, held = _verified(data, ("path space",))
    same = total_variation(data.exact.sel(law="path space").to_numpy(), data.exact.sel(law="balance").to_numpy())
    claim(
        "path-space",
        "Tempering in path space, technique changed at fixed x, has the same law",
        f"{SOURCE}, sec. 3.1, eq. 15",
        (same < 1e-9, near(_distances(data, "path space")[1], noise["path space"]), passed),
        "holds",
        f"exact TV {same:.0e}, operator's {_distances(data, 'path space')[1]:.1e}; {number}",
        f"1e-9; TV {2 * noise['path space']:.1e}, open to twice that; {held}",
    )
    times = [float(data.time.sel(law=name)) for name in ("path space", "balance")]
    rates = [data.acceptance.sel(space=name).to_numpy() for name in ("path space", "balance")]
    claims.append(
        Claim(
            "mmlt.path-space-cost",
            "On this target primary space mixes faster than path space, which makes no use of the techniques' maps",
            f"{SOURCE}, sec. 3.1, 3.2",
            verdict(times[0] > 1.5 * times[1]),
            "holds",
            f"IAT of x {times[0]:.1f} in path space, {times[1]:.1f} in primary; small steps accepted "
            f"{rates[0][0]:.2f} and {rates[1][0]:.2f}, changes {rates[0][1]:.2f} and {rates[1][1]:.2f}",
            "the fundamental matrix of both operators, exact for their nets; a factor of 1.5",
        )
    )
    loss, found = 1 - float(data.kept), _distances(data, "lost")[1]
    shift = total_variation(data.exact.sel(law="lost").to_numpy().sum(0), data.density.to_numpy())
    claim(
        "any-partition",
        "Any partition of unity will do as weights",
        f"{SOURCE}, sec. 6",
        (loss < 1e-9 or not str(data.refused.to_numpy()),),
        "fails",
        f"positive where a density is zero: {loss:.2%} of b lost, x off by TV {shift:.3f}",
        "quadrature; Multiplexed refuses such weights",
    )
    claim(
        "partition-lost",
        "With weights that are positive where their technique's density is zero, the law is that of what is left of f",
        f"ours; {SOURCE}, sec. 6",
        (near(found, noise["lost"]),),
        "holds",
        f"operator's TV of (i, x) {found:.1e}",
        f"TV {2 * noise['lost']:.1e}, twice the net's noise, open to four times",
    )
    claim(
        "partition-repair",
        "Weights that are zero where their technique's density is lose nothing",
        f"ours; {SOURCE}, sec. 6",
        (float(np.abs(data.by_technique.sum() / b - 1)) < 1e-9,),
        "holds",
        f"balance: off by {abs(float(data.by_technique.sum()) / b - 1):.0e} of b",
        "quadrature, 1e-9",
    )
    passed, number, held = _verified(data, ("floor",))
    factor = float(data.floor_integral) * 3 / b - 1
    distance, blur = (float(value) for value in data.floor_law)
    claims.append(
        Claim(
            "mmlt.floor-index",
            "The index as the floor of n u_t, moved like the other numbers, gives the same law",
            f"{SOURCE}, sec. 4, Alg. 2",
            verdict(abs(factor) < 1e-9, near(distance, blur), passed),
            "holds",
            f"n times its integral is b to {abs(factor):.0e}; operator's TV in x {distance:.1e}; {number}",
            f"1e-9; TV {2 * blur:.1e}, twice the net's noise, open to four times; {held}",
        )
    )
    passed, number, held = _verified(data, ("block-wise",))
    claim(
        "block-wise",
        "Steps of one coordinate at a time (u_t or u) leave the law as it is",
        f"{SOURCE}, sec. 6",
        (passed,),
        "holds",
        number,
        held,
    )
    return claims
