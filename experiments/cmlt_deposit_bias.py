"""Coherent Metropolis light transport deposits every candidate: how far off that is, and two deposits that are not."""

from dataclasses import dataclass
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support import cmlt_deposit_rings
from experiments.support.cmlt_deposit_rings import SOURCE
from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, over, ratio, under
from experiments.support.long import long_run
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, passes, verdict, witnessed
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.moves import Move, MultipleTry, SmallStep
from mcmc1d.moves.multiple_try import LogWeight, by_importance, evenly
from mcmc1d.packets import AuxiliaryCentre, PublishedDeposit
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Uniform
from mcmc1d.types import Key
from mcmc1d.verify import RingStep, deposit_law, enumerate_kernel, ring, verify
from mcmc1d.verify.goodness import total_variation


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    bins: int = 20
    sigma: float = 0.15
    """Of the small steps on the line."""
    work: int = 2**21
    """Evaluations of the target that each of the compared runs may spend, its repetitions together."""
    blocks: int = 16
    repeats: int = 128
    """Histograms of each deposit and number of candidates, among which the work is shared."""
    chains: int = 2**14
    """Chains of the simulation on the ring."""
    steps: int = 512
    points: int = 2**15
    """Of a net, of which there are eight."""
    replicas: int = 2**17
    """Of each verification, on the line with `VERIFIED` candidates."""
    most: int = 64
    """Candidates whose error against work is compared, of `TRIES`."""


PROFILES = {"quick": Config(), "paper": Config(work=2**25, steps=4096, points=2**18, replicas=2**18, most=256)}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

F = (1.0, 3.0, 0.5, 2.0, 4.0)
"""The ring's density; its step is lopsided."""
TRIES = (1, 2, 4, 16, 64, 256)
DEPOSITS = ("published", "two states", "auxiliary centre")
WEIGHTS = {"paper": by_importance, "even": evenly}
"""The paper's lambda, 1 / (g g): between neighbours on a ring that of `by_importance` up to a factor; and none."""
VERIFIED = 16
"""Candidates in the verifications: the more, the larger the published deposit's bias."""


def kernel(deposit: str, step: Move, tries: int, log_weight: LogWeight = by_importance) -> Kernel:
    """A kernel that deposits in one of the three ways."""
    if deposit == "auxiliary centre":
        return AuxiliaryCentre(step, tries)
    move = MultipleTry(step, tries, log_weight)
    return PublishedDeposit(move) if deposit == "published" else Metropolis(move)


def evaluations(deposit: str, tries: int) -> int:
    """Of the target, in one step: candidates and competitors, or candidates and the centre."""
    return tries + 1 if deposit == "auxiliary centre" else 2 * tries - 1


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The bias on a ring, three ways; then the error against work on the line."""
    step = RingStep(len(F), {1: 0.75, -1: 0.25})
    target, states = ring(F)
    exact = np.array(F) / sum(F)
    edges = np.linspace(0, 1, len(F) + 1)
    single = enumerate_kernel(kernel("published", step, 1), target, states, [4, None, None], inner=8)
    todo = [(d, w) for d in DEPOSITS for w in WEIGHTS]
    enumerated = np.zeros((len(DEPOSITS), len(WEIGHTS), len(F)))
    for k, (deposit, weight) in enumerate(todo):
        one = kernel(deposit, step, 2, WEIGHTS[weight])
        steps = one.dim_w(target) - (1 if deposit == "auxiliary centre" else 2)
        plan = [4] * steps + [None] * (one.dim_w(target) - steps)
        found = enumerate_kernel(one, target, states, plan, probes=65)
        at = DEPOSITS.index(deposit), list(WEIGHTS).index(weight)
        enumerated[at] = found.law @ found.deposits
        progress("enumeration", k + 1, len(todo))
    one = kernel("published", step, 2)
    net = deposit_law(one, target, edges, points=config.points)
    size: dict[str, Any] = {"steps": config.steps, "chains": config.chains, "blocks": config.blocks}
    estimators = {"x": mcmc1d.Histogram(len(F))}
    simulated = long_run("simulated", jax.random.key(seed), one, target, **size, estimators=estimators)
    line = mcmc1d.Multiplexed(Sinusoid(0.9, 2.0, 0.1), Uniform())
    verified = {d: kernel(d, SmallStep(config.sigma), VERIFIED) for d in DEPOSITS}
    reports = []
    for deposit, one in verified.items():
        options: dict[str, Any] = {"replicas": config.replicas, "steps": (1, 4, 16), "name": deposit}
        options["reversible"] = False
        reports.append(verify(one, line, seed=seed, **options))
        progress("verification", len(reports), len(DEPOSITS))
    compared = [tries for tries in TRIES if tries <= config.most]
    bias = np.zeros((len(DEPOSITS), len(compared)))
    error = np.zeros((*bias.shape, config.repeats))
    for row, deposit in enumerate(DEPOSITS):
        for column, tries in enumerate(compared):
            found = _errors(config, deposit, tries, line, jax.random.fold_in(jax.random.key(seed), 100 * row + column))
            error[row, column], bias[row, column] = found
            progress("error against work", row * len(compared) + column + 1, len(DEPOSITS) * len(compared))
    return xr.Dataset(
        {
            "exact": ("state", exact),
            "enumerated": (("deposit", "weight", "state"), enumerated),
            "net": ("state", net.masses),
            "net_error": ("state", net.standard_error),
            "simulated": ("state", simulated.mean("x")),
            "simulated_error": ("state", simulated.standard_error("x")),
            "error": (("deposit", "tries", "repeat"), error),
            "bias": (("deposit", "tries"), bias),
            "work": config.work,
            "single": single.deposit_residual,
            **cmlt_deposit_rings.measure(F),
            "verdict": ("deposit", [report.verdict.value for report in reports]),
            "p": ("deposit", [report.p_value for report in reports]),
            "gap": ("deposit", [report.gap for report in reports]),
            "only_deposits": ("deposit", [{f.layer for f in report.failures} <= {"deposits"} for report in reports]),
        },
        {
            "deposit": list(DEPOSITS),
            "weight": list(WEIGHTS),
            "tries": compared,
            "state": np.arange(len(F)),
        },
    )


def _errors(config: Config, deposit: str, tries: int, target: mcmc1d.Multiplexed, key: Key) -> tuple[np.ndarray, float]:
    """The total variation of each histogram from the exact law, and that of the mean of all."""
    edges = np.linspace(0, 1, config.bins + 1)
    masses = target.target.bin_masses(edges)
    exact = masses / masses.sum()
    each = config.work // (config.repeats * evaluations(deposit, tries))
    chains = max(1, min(64, each // 64))
    run = long_run(
        f"error, {deposit}, {tries}",
        key,
        kernel(deposit, SmallStep(config.sigma), tries),
        target,
        steps=max(1, each // chains),
        chains=chains * config.repeats,
        blocks=config.repeats,
        estimators={"x": mcmc1d.Histogram(config.bins)},
    )
    blocks = run.sums["x"] * config.repeats / (run.chains * run.steps)
    errors = np.array([total_variation(block, exact) for block in blocks])
    mean = run.mean("x")
    return errors, total_variation(mean, exact)


def draw(data: xr.Dataset) -> Figure:
    """The bias by state, three ways; the error against the number of candidates at equal work."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 2.6))
    x, exact = data.state.to_numpy(), data.exact.to_numpy()
    published = data.enumerated.sel(deposit="published", weight="paper").to_numpy()
    left.bar(x, 100 * (published / exact - 1), 0.6, color="C1", alpha=0.5, label="enumerated")
    for name, colour, shift in (("net", "C0", -0.1), ("simulated", "C2", 0.1)):
        error = 5 * data[f"{name}_error"].to_numpy() / exact
        value = data[name].to_numpy() / exact - 1
        left.errorbar(x + shift, 100 * value, 100 * error, fmt=".", color=colour, markersize=3, label=f"{name}, 5 s.e.")
    left.axhline(0, color="black", linewidth=0.6)
    left.set(xlabel="state of the ring", ylabel="relative bias (%)", title="published deposit, two candidates")
    left.legend(fontsize=6)
    for deposit, colour in zip(data.deposit.to_numpy(), ("C1", "C0", "C2"), strict=True):
        here = data.sel(deposit=deposit)
        right.plot(here.tries, here.error.mean("repeat"), "o-", color=colour, markersize=3, label=str(deposit))
        right.plot(here.tries, here.bias, ":", color=colour, linewidth=0.9)
    right.set(xscale="log", yscale="log", xlabel="candidates p", ylabel="total variation")
    right.set_xticks(data.tries.to_numpy(), [str(p) for p in data.tries.to_numpy()])
    right.minorticks_off()
    right.set_title("error at equal work; dotted, of the mean of all", fontsize=7)
    right.legend(fontsize=6)
    return figure


def table(data: xr.Dataset) -> Table:
    """Bias by enumeration, and the errors on the line."""
    result = Table(
        "deposit", *(f"bias, {w}" for w in WEIGHTS), *(f"p {p}" for p in data.tries.to_numpy()), box=SIMPLE, padding=0
    )
    result.title = "cmlt_deposit_bias: bias on a ring by enumeration (TV); error at equal work on the line (TV)"
    exact = data.exact.to_numpy()
    for deposit in data.deposit.to_numpy():
        here = data.sel(deposit=deposit)
        biases = [f"{total_variation(here.enumerated.sel(weight=w).to_numpy(), exact):.1e}" for w in WEIGHTS]
        result.add_row(
            str(deposit), *biases, *(f"{float(here.error.sel(tries=p).mean()):.4f}" for p in data.tries.to_numpy())
        )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """The published deposit is biased, three ways alike; the other two are not."""
    exact = data.exact.to_numpy()
    repaired = max(
        total_variation(data.enumerated.sel(deposit=deposit, weight=w).to_numpy(), exact)
        for deposit in DEPOSITS[1:]
        for w in WEIGHTS
    )
    enumerated = data.enumerated.sel(deposit="published", weight="paper").to_numpy()
    relative, published = np.abs(enumerated / exact - 1), total_variation(enumerated, exact)
    gaps = {
        name: float(np.max(np.abs(data[name].to_numpy() - enumerated) / data[f"{name}_error"].to_numpy()))
        for name in ("net", "simulated")
    }
    said = {d: f"{data.verdict.sel(deposit=d).values}, p {float(data.p.sel(deposit=d)):.2g}" for d in DEPOSITS}
    passed = {d: passes([data.verdict.sel(deposit=d).item()]) for d in DEPOSITS}
    only_deposits = bool(data.only_deposits.sel(deposit="published"))
    seen = passed["published"] if only_deposits else None  # a failure that is not the deposits' shows nothing of them
    only = " (its deposits alone)" if only_deposits else ""
    tested = detects(data.gap)
    errors = {deposit: data.error.sel(deposit=deposit).to_numpy() for deposit in DEPOSITS}
    left = data.bias.sel(deposit="published", tries=VERIFIED).item()
    means = {deposit: each.mean(-1) for deposit, each in errors.items()}
    two, centre = errors["two states"], errors["auxiliary centre"]
    dear = over(1, *(ratio(each, two[0], DECIDES) for each in two[1:]))
    pays = under(0.9, ratio(centre[means["auxiliary centre"].argmin()], centre[0], DECIDES))
    sizes = {name: float((data[f"{name}_error"] / data.exact).max()) for name in ("net", "simulated")}
    return [
        Claim(
            "cmlt.deposit-unbiased",
            "Depositing all candidates with R_g, all competitors with 1 - R_g, is unbiased",
            f"{SOURCE}, sec. 5.2",
            witnessed(published < 1e-12, seen),
            "fails",
            f"a state is off by {relative.min():.1%} to {relative.max():.1%}, TV {published:.4f}; on the line, "
            f"p = {VERIFIED}: {said['published']}{only}",
            f"enumeration, p = 2; exact to 1e-12; {tested}",
        ),
        *cmlt_deposit_rings.claims(data),
        Claim(
            "cmlt.one-candidate",
            "With one candidate it is",
            f"ours; {SOURCE}, sec. 5.2",
            "holds" if float(data.single) < 1e-12 else "fails",
            "holds",
            f"TV {float(data.single):.1e}",
            "enumeration, 1e-12",
        ),
        Claim(
            "cmlt.bias-three-ways",
            "That bias is the same by enumeration, by a net over one step, and by simulation",
            f"ours; {SOURCE}, sec. 5.2",
            "holds" if max(gaps.values()) < 9 else "fails",
            "holds",
            f"net {gaps['net']:.1f}, simulation {gaps['simulated']:.1f} standard errors from the enumeration at most",
            f"9 standard errors (t, 7 and 15 degrees of freedom, five states each: by chance in 2e-4 of the runs), of "
            f"{sizes['net']:.2%} and {sizes['simulated']:.2%} of a state at most",
        ),
        Claim(
            "cmlt.repair",
            "The deposits on two states, and on p + 1 around an auxiliary centre, are unbiased",
            "Tjelmeland 2004; Calderhead 2014",
            verdict(repaired < 1e-12, *(passed[d] for d in DEPOSITS[1:])),
            "holds",
            f"TV {repaired:.1e}; on the line, p = {VERIFIED}: {said['two states']}; {said['auxiliary centre']}",
            f"enumeration, 1e-12; {tested}",
        ),
        Claim(
            "cmlt.trade",
            "At equal work several candidates pay around an auxiliary centre, and not with the deposit on two states",
            f"ours; {SOURCE}, sec. 7.1",
            verdict(dear, pays),
            "holds",
            "; ".join(f"{d}: " + ", ".join(f"{e:.4f}" for e in one) for d, one in means.items())
            + f"; of the published one {left:.3f} is bias at p = {VERIFIED}",
            f"TV of a histogram from the exact law, p = {', '.join(map(str, data.tries.to_numpy()))}; a tenth; "
            f"intervals of {data.sizes['repeat']} of them, which miss with {DECIDES:.0e}",
        ),
    ]
