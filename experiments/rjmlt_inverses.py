"""Bitterli et al. 2017, equations 8 to 25: the jump's determinant, any choice of the lobe, inversions that fail."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.framework import Claim
from experiments.support.rjmlt_inverses_techniques import Brittle, ChosenLobe
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, near, passes, verdict, witnessed
from mcmc1d.moves import Mixture as Moves
from mcmc1d.moves import Move, ReversibleJump, SmallStep
from mcmc1d.moves.returning import Returning
from mcmc1d.numerics import cast
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Mixture, PiecewiseConstant, RaisedSinusoid, Ramp, Technique, Tent, Uniform
from mcmc1d.verify import ContractReport, check_move, check_technique, transition_operator, verify
from mcmc1d.verify.goodness import total_variation

SOURCE = "Bitterli et al. 2017"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    sigma: float = 0.1
    """Of the small steps, which come as often as jumps."""
    bins: int = 40
    points: int = 2**15
    """Of the operators' nets, for each technique."""
    replicas: int = 2**14
    """Of each verification."""
    checked: int = 1000
    """Random points of each contract, beside the edges."""
    states: int = 2**12
    """At which determinants and ratios are compared with their formulas."""


PROFILES = {"quick": Config(), "paper": Config(points=2**19, replicas=2**18, checked=10_000, states=2**16)}

F = Sinusoid(0.9, 1.5, 0.1, 2.0)
NESTED = Mixture((Tent(0.3), Mixture((RaisedSinusoid(0.6), Ramp(2.0)), (0.4, 0.6)), Uniform()), (0.25, 0.5, 0.25))
STEP = PiecewiseConstant([0, 0.5, 1], [1.6, 0.4])
T = [[0.2, 0.5, 0.3], [0.1, 0.1, 0.8], [0.6, 0.4, 0.0]]
"""How a technique is proposed from another: not symmetric."""
PAIR = Mixture((Ramp(1.5), Ramp(-1.0)), (0.3, 0.7))
"""Of lobes that vanish nowhere: where one does, the determinant of a choice that is blind to x is infinite."""
LOBES = {
    "by the prior": ChosenLobe(PAIR, [0.3, 0.7]),
    "by another T": ChosenLobe(PAIR, [0.8, 0.2]),
    "by the prior, 1 / p": ChosenLobe(PAIR, [0.3, 0.7], 1.0),
}
WINDOW = (0.5, 0.7)
BRITTLE = Multiplexed(F, (Tent(0.4), Brittle(Ramp(1.2), WINDOW)))
FAILS = {"there": ReversibleJump(), "there and back": Returning(ReversibleJump())}
"""Where an inversion that fails is noticed."""


def chain(sigma: float, jump: Move) -> Moves:
    """Small steps and jumps, as often."""
    return Moves({"small": (0.5, SmallStep(sigma)), "jump": (0.5, jump)})


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Contracts; determinants beside their formulas; the laws by the operator; verdicts by `verify`."""
    edges = np.linspace(0, 1, config.bins + 1)
    nested = Multiplexed(F, (Tent(0.4), STEP, NESTED))
    jump = ReversibleJump(T)
    size: dict[str, Any] = {"points": config.checked, "dtypes": (np.float64,)}
    contracts = {"jump": check_move(jump, nested, **size), "nested": check_technique(NESTED, **size)}
    contracts |= {name: check_technique(technique, **size) for name, technique in LOBES.items()}
    contracts["there and back"] = check_move(FAILS["there and back"], BRITTLE, **size)
    progress("contracts", 1, 1)
    formulas = _formulas(config, jump, nested, seed)
    targets = {name: (Multiplexed(F, (Tent(0.4), technique)), ReversibleJump()) for name, technique in LOBES.items()}
    todo = {**targets, **{name: (BRITTLE, move) for name, move in FAILS.items()}}
    laws, reports = {}, {"nested": verify(chain(config.sigma, jump), nested, seed=seed, replicas=config.replicas)}
    for k, (name, (target, move)) in enumerate(todo.items()):
        mixed = chain(config.sigma, move)
        laws[name] = transition_operator(mixed, target, points=config.points, x_cells=1).law_of(edges)
        reports[name] = verify(mixed, target, seed=seed, replicas=config.replicas, name=name)
        progress("laws", k + 1, len(todo))
    exact = F.bin_masses(edges)
    return xr.Dataset(
        {
            "exact": ("bin", exact / exact.sum()),
            "law": (("kernel", "bin"), np.stack([law.masses.sum(0) for law in laws.values()])),
            "noise": ("kernel", [law.noise for law in laws.values()]),
            "contract": ("subject", [_worst(report) for report in contracts.values()]),
            "kept": ("subject", [report.passed for report in contracts.values()]),
            **formulas,
            "verdict": ("verified", [report.verdict.value for report in reports.values()]),
            "p": ("verified", [report.p_value for report in reports.values()]),
            "gap": ("verified", [report.gap for report in reports.values()]),
        },
        {
            "bin": (edges[1:] + edges[:-1]) / 2,
            "kernel": list(laws),
            "subject": list(contracts),
            "verified": list(reports),
        },
    )


def _worst(report: ContractReport) -> float:
    """The largest error of a contract's equations, in units of its tolerance."""
    return max(check.error / check.tolerance for check in report.checks if check.tolerance > 0)


def _formulas(config: Config, jump: ReversibleJump, target: Multiplexed, seed: int) -> dict[str, float]:
    """How far a jump's determinant is from T_ji p_j / (T_ij p_i), its ratio from T_ji w_j / (T_ij w_i), in float64.

    And a nested mixture's determinant from 1 / p.
    """
    rng = np.random.default_rng(seed)
    count, table = config.states, np.log(np.maximum(np.array(T), 1e-300))
    with jax.enable_x64(True):
        own, move = cast((target, jump), jnp.float64)
        u, w = (jnp.asarray(rng.random((count, size))) for size in (own.dim_u, move.dim_w(own)))
        states = jax.vmap(own.evaluate)(State(jnp.asarray(rng.integers(3, size=count), jnp.int32), u))
        there = jax.vmap(lambda s, w: move.propose(own, s, w))(states, w)
        after = jax.vmap(own.evaluate)(State(there.state.index, there.state.u))
        i, j = np.asarray(states.index), np.asarray(after.index)
        log_p = np.stack([np.asarray(p) for p in states.seen.log_p], 1)
        weigh = jax.vmap(lambda x, p: jnp.stack(list(own.log_weights(x, p))))
        log_w = np.asarray(weigh(states.seen.x, states.seen.log_p))
        rows = np.arange(count)
        log_t = table[j, i] - table[i, j]
        ratio = np.asarray(after.seen.log_c - states.seen.log_c + there.log_det)
        determinant = np.asarray(there.log_det) - (log_p[rows, j] - log_p[rows, i] + log_t)
        ratio_error = ratio - (log_w[rows, j] - log_w[rows, i] + log_t)
        nested: Technique = cast(NESTED, jnp.float64)
        x, _, log_det = jax.vmap(nested.forward)(u[:, : nested.dim_u])
        off = np.asarray(log_det + jax.vmap(nested.log_prob)(x))
    possible = np.isfinite(there.log_det) & (table[j, i] > -600)
    return {
        "determinant": float(np.abs(determinant[possible]).max()),
        "ratio": float(np.abs(ratio_error[possible]).max()),
        "possible": float(possible.mean()),
        "nested": float(np.abs(off).max()),
    }


def draw(data: xr.Dataset) -> Figure:
    """Each kernel's own law over the target's: by the choice of the lobe, and where inversions fail."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 2.3), sharey=True)
    x, exact = data.bin.to_numpy(), data.exact.to_numpy()
    styles = {"by the prior": ("C0", "o"), "by another T": ("C2", "x"), "by the prior, 1 / p": ("C1", "s")}
    for name, (colour, mark) in styles.items():
        law = data.law.sel(kernel=name) / exact
        left.plot(x, law, mark, color=colour, markersize=3, markerfacecolor="none", label=name)
    left.set(xlabel="x", ylabel="law / target's law", title="the lobe of a mixture, chosen")
    right.axvspan(*WINDOW, color="0.9", linewidth=0, label="can not be inverted")
    for name, colour, mark in (("there and back", "C0", "o"), ("there", "C1", "s")):
        law = data.law.sel(kernel=name) / exact
        label = f"rejected {name}" + (" only" if name == "there" else "")
        right.plot(x, law, mark, color=colour, markersize=3, markerfacecolor="none", label=label)
    right.set(xlabel="x", title="inversions that fail")
    for axes in (left, right):
        axes.axhline(1, color="black", linewidth=0.6)
        axes.legend(loc="upper left")
    low, high = float((data.law / exact).min()), float((data.law / exact).max())
    left.set_ylim(low - 0.1, high + 0.45 * (high - low) + 0.1)
    return figure


def table(data: xr.Dataset) -> Table:
    """Each kernel's law, by the operator and by `verify`."""
    result = Table("kernel", "TV", "noise", "verify", "p", box=SIMPLE, padding=0)
    result.title = "rjmlt_inverses: laws of x by the operator, verdicts"
    for name in data.kernel.to_numpy():
        law, here = data.sel(kernel=name), data.sel(verified=name)
        off = total_variation(law.law.to_numpy(), data.exact.to_numpy())
        result.add_row(
            str(name), f"{off:.4f}", f"{float(law.noise):.4f}", str(here.verdict.values), f"{float(here.p):.2g}"
        )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Each claim by its contract, by its exact law or formula, and by `verify`."""
    exact = data.exact.to_numpy()
    off = {str(k): total_variation(data.law.sel(kernel=k).to_numpy(), exact) for k in data.kernel.to_numpy()}
    worst = {str(s): float(data.contract.sel(subject=s)) for s in data.subject.to_numpy()}
    kept = {str(s): bool(data.kept.sel(subject=s)) for s in data.subject.to_numpy()}
    said = {str(v): str(data.verdict.sel(verified=v).values) for v in data.verified.to_numpy()}
    p = {name: f"{said[name]}, p {float(data.p.sel(verified=name)):.2g}" for name in said}
    noise = {str(k): float(data.noise.sel(kernel=k)) for k in data.kernel.to_numpy()}
    true = {name: near(off[name], noise[name]) for name in off}
    gap = detects(data.gap)
    most = 2 * max(noise.values())
    held = f"contract, 1e-10 by condition; TV twice the net's noise, {most:.1e} at most (open to four times); {gap}"
    formula = f"contract, 1e-10 by condition; formula, 1e-9; {gap}"
    right = [name for name in LOBES if "1 / p" not in name]
    wrong = next(name for name in LOBES if "1 / p" in name)

    def claim(
        name: str,
        statement: str,
        where: str,
        exact: Iterable[bool | None],
        verified: Iterable[str],
        expected: str,
        number: str,
        held: str,
    ) -> Claim:
        source = where if where.startswith("ours") else f"{SOURCE}, {where}"
        known, seen = verdict(*exact), passes(said[one] for one in verified)
        found = witnessed(False, seen) if known == "fails" else verdict(None if known == "open" else True, seen)
        return Claim(f"rjmlt.{name}", statement, source, found, expected, number, held)

    return [
        claim(
            "determinant",
            "A jump's determinant is p_j / p_i (times T_ji / T_ij), and its ratio reduces to T_ji w_j / (T_ij w_i)",
            "eqs. 8-14, 17-19",
            [kept["jump"], max(float(data.determinant), float(data.ratio)) < 1e-9],
            ["nested"],
            "holds",
            f"contract: {worst['jump']:.1e} of its tolerance; log-determinant off by {float(data.determinant):.1e}, "
            f"log-ratio by {float(data.ratio):.1e}, at {float(data.possible):.0%} of the states; {p['nested']}",
            formula,
        ),
        claim(
            "nested-mixtures",
            "The inverse of a mixture by the posterior's interval is exact, of nested ones too: determinant 1 / p",
            "eqs. 21-25",
            [kept["nested"], float(data.nested) < 1e-9],
            ["nested"],
            "holds",
            f"contract: {worst['nested']:.1e} of its tolerance; log-determinant off by {float(data.nested):.1e}; "
            f"{p['nested']}",
            formula,
        ),
        claim(
            "lobe-any-choice",
            "Any probabilities T of the lobe will do in the inverse, with the ratio that belongs to them",
            "eq. 24",
            [*(kept[name] for name in right), *(true[name] for name in right)],
            right,
            "holds",
            "; ".join(f"{name}: contract {worst[name]:.1e}, TV {off[name]:.1e}, {p[name]}" for name in right),
            held,
        ),
        claim(
            "lobe-wrong-ratio",
            "Chosen by the prior, the lobe may have the posterior's determinant 1 / p, and always be accepted",
            "ours; Bitterli et al. 2017, eq. 25",
            [kept[wrong], true[wrong]],
            [wrong],
            "fails",
            f"contract {'kept' if kept[wrong] else 'broken'}; TV {off[wrong]:.4f}; {p[wrong]}",
            held,
        ),
        claim(
            "failed-inversions",
            "To reject what can not be inverted keeps the law, though a technique makes samples that it can not invert",
            "sec. 6",
            [true["there"]],
            ["there"],
            "fails",
            f"TV {off['there']:.4f}; {p['there']}: the way back, from there, is taken",
            held,
        ),
        claim(
            "failed-there-and-back",
            "It does where the way back is rejected too: a proposal that does not come back",
            "ours; Bitterli et al. 2017, sec. 6",
            [kept["there and back"], true["there and back"]],
            ["there and back"],
            "holds",
            f"contract: {worst['there and back']:.1e} of its tolerance; TV {off['there and back']:.1e}; "
            f"{p['there and back']}",
            held,
        ),
    ]
