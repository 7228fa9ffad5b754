"""Three witnesses of each claim about a law: the contract, the law computed by nets, and replicas from exact starts."""

from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import fails, passes, verdict
from experiments.support.witnesses_cases import Case, cases
from mcmc1d.moves import Move
from mcmc1d.verify import check_move, deposit_law, transition_operator, verify
from mcmc1d.verify.contract import Check
from mcmc1d.verify.goodness import expected_distance, total_variation


@dataclass(frozen=True)
class Config:
    """The experiment's numbers; cases are names, or "all"."""

    cases: str = "multiplexed, balance; figure 3, no Jacobian; auxiliary centre"
    """Names, apart by semicolons, or "all"."""
    checked: int = 1000
    """Random points of each contract, beside the edges."""
    bins: int = 20
    points: int = 2**17
    """Of a net, of which there are eight, for each technique."""
    replicas: int = 2**15
    """Of each verification's first stage."""
    tolerance: float = 1e-3
    """Total variation, beyond twice what the nets' noise makes."""


PROFILES = {"quick": Config(), "paper": Config(cases="all", checked=10_000, points=2**18, replicas=2**17)}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Each kernel before all three."""
    known = cases()
    names = list(known) if config.cases == "all" else [name.strip() for name in config.cases.split(";")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"there is no case {unknown[0]!r}; known: {'; '.join(known)}")
    size = (config.checked, config.bins, config.points, config.replicas)
    rows = progress.map("witnesses", witnesses, [(name, *size, seed) for name in names])
    return xr.Dataset(
        {
            **{of: ("case", np.array([row[of] for row in rows])) for of in rows[0]},
            "keeps": ("case", [known[name].keeps for name in names]),
            "claim": ("case", [known[name].claims for name in names]),
            "tolerance": config.tolerance,
        },
        {"case": names},
    )


def witnesses(name: str, checked: int, bins: int, points: int, replicas: int, seed: int) -> dict[str, Any]:
    """What each says of a case: errors in units of their tolerance, total variations, p-values."""
    case = cases()[name]
    moves = case.parts or ((case.kernel,) if isinstance(case.kernel, Move) else ())
    checks = [
        check for move in moves for check in check_move(move, case.target, points=checked, dtypes=(np.float64,)).checks
    ]
    found, noise = _law(case, np.linspace(*case.edges, bins + 1), points)
    report = verify(case.kernel, case.target, seed=seed, replicas=replicas, name=name)
    return {
        "contract": max(_in_tolerances(check) for check in checks),
        "contract_kept": all(check.passed for check in checks),
        "tv": found,
        "noise": noise,
        "verdict": report.verdict.value,
        "p": report.p_value,
        "gap": report.gap,
    }


def _in_tolerances(check: Check) -> float:
    """A check's error in units of its tolerance; a matter of yes or no has none."""
    if check.tolerance > 0:
        return check.error / check.tolerance
    return 0.0 if check.passed else np.inf


def _law(case: Case, edges: np.ndarray, points: int) -> tuple[float, float]:
    """How far the law that is kept, or deposited, is from the exact one; and what the noise makes of it."""
    if case.exact is None:
        masses = case.target.joint_masses(edges)
        exact = masses / masses.sum()
    else:
        exact = case.exact(edges)[None] / case.exact(edges).sum()
    if case.parts:
        deposited = deposit_law(case.kernel, case.target, edges, points=points)
        return total_variation(deposited.masses, exact.sum(0)), expected_distance(deposited.standard_error)
    law = transition_operator(case.kernel, case.target, points=points).law_of(edges, case.of)
    shown, truth = (law.masses, exact) if case.exact is None else (law.masses.sum(0), exact[0])
    return total_variation(shown / shown.sum(), truth), law.noise


def draw(data: xr.Dataset) -> Figure:
    """A row for each kernel, a panel for each witness; right kernels are full dots, wrong ones crosses."""
    n = data.sizes["case"]
    figure, axes = plt.subplots(1, 3, figsize=(7.0, 0.125 * n + 0.9), sharey=True)
    y, keeps = np.arange(n), data.keeps.to_numpy()
    limit = (data.tolerance + 2 * data.noise).to_numpy()
    panels = (
        (data.contract.to_numpy(), np.ones(n), "contract, error / tolerance", (1e-7, 1e13)),
        (data.tv.to_numpy(), limit, "law computed, total variation", (1e-4, 1)),
        (np.maximum(data.p.to_numpy(), 1e-30), np.full(n, 1e-5), "replicas, p", (1e-31, 3)),
    )
    for axis, (value, bar, label, span) in zip(axes, panels, strict=True):
        axis.scatter(np.clip(value, *span)[keeps], y[keeps], s=9, color="C0", zorder=3)
        axis.scatter(np.clip(value, *span)[~keeps], y[~keeps], s=13, color="C1", marker="x", linewidths=1, zorder=3)
        axis.scatter(bar, y, s=22, color="0.5", marker="|", linewidths=0.8)
        axis.set(xscale="log", xlabel=label, xlim=span)
        axis.grid(axis="y", color="0.92", linewidth=0.5)
        axis.tick_params(axis="y", length=0)
        axis.minorticks_off()
    axes[0].set_yticks(y, data.case.to_numpy(), fontsize=5)
    axes[0].set_ylim(n - 0.4, -0.6)
    marks = [
        Line2D([], [], marker="o", color="C0", linestyle="", markersize=3, label="theory: keeps the law"),
        Line2D([], [], marker="x", color="C1", linestyle="", markersize=3.5, label="theory: does not"),
        Line2D([], [], marker="|", color="0.5", linestyle="", markersize=5, label="what it is held to"),
    ]
    figure.legend(handles=marks, ncols=3, loc="outside upper center", fontsize=6)
    return figure


def table(data: xr.Dataset) -> Table:
    """The same numbers, with the claim that each kernel belongs to."""
    columns = ("kernel", "claim", "theory", "contract", "law, TV", "noise", "replicas", "p", "gap")
    result = Table(*columns, title="witnesses", box=SIMPLE, padding=0)
    for name in data.case.to_numpy():
        row = data.sel(case=name)
        result.add_row(
            str(name),
            str(row.claim.item()),
            "keeps" if row.keeps else "does not",
            f"{float(row.contract):.1e}",
            f"{float(row.tv):.4f}",
            f"{float(row.noise):.4f}",
            str(row.verdict.item()),
            f"{float(row.p):.2g}",
            f"{float(row.gap):.3f}",
        )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """All three acquit what is right; and what is wrong is convicted by the two that look at laws."""
    keeps = data.keeps.to_numpy()
    limit = (data.tolerance + 2 * data.noise).to_numpy()
    kept, near = data.contract_kept.to_numpy(), data.tv.to_numpy() <= limit
    said = data.verdict.to_numpy()
    acquitted, convicted = kept & near & (said == "PASS"), ~near & (said == "FAIL")
    names = data.case.to_numpy()
    held = (
        f"contract, 1e-10 by condition; TV {float(data.tolerance):.0e} beyond twice the nets' noise, "
        f"{float(data.noise.max()):.1e} at most; verify at 1e-5 detects CDF gaps of {float(data.gap.min()):.3f} to "
        f"{float(data.gap.max()):.3f} with probability 0.99"
    )

    def but(these: np.ndarray) -> str:
        return f"; not {', '.join(names[these])}" if these.any() else ""

    right, wrong = int(keeps.sum()), int((~keeps).sum())
    return [
        Claim(
            "witness.right",
            f"Contract, computed law and replicas agree that {right} kernels of the theories keep their law",
            "all five papers; the table of `witnesses` has each claim's three numbers",
            verdict(bool((kept & near)[keeps].all()), passes(said[keeps])),
            "holds",
            f"{int(acquitted[keeps].sum())} of {right}; contracts {float(data.contract[keeps].max()):.2g} of their "
            f"tolerance at most, TV {float(data.tv[keeps].max()):.4f}, p {float(data.p[keeps].min()):.2g} at least"
            + but(keeps & ~acquitted),
            held,
        ),
        Claim(
            "witness.wrong",
            f"Computed law and replicas agree that {wrong} others do not",
            "all five papers; the table of `witnesses` has each claim's three numbers",
            verdict(not near[~keeps].any(), fails(said[~keeps])),
            "holds",
            f"{int(convicted[~keeps].sum())} of {wrong}; TV {float(data.tv[~keeps].min()):.4f} at least, "
            f"p {float(data.p[~keeps].max()):.1g} at most; the contract is broken in {int((~kept & ~keeps).sum())}, "
            "kept where deposits are the mistake" + but(~keeps & ~convicted),
            held,
        ),
    ]
