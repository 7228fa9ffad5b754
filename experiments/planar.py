"""The plane: each technique's contract, jumps between techniques against exact cells, and three maps of one disk."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support import planar_maps, planar_theories
from experiments.support.beside import both_cores
from experiments.support.framework import Claim
from experiments.support.long import long_run
from experiments.support.sweep import Sweep
from experiments.support.verdict import passes, verdict
from mcmc1d import verify
from mcmc1d.moves import AimedJump, Mixture, Move, MultipleTry, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.moves.multiple_try import by_target
from mcmc1d.planar_histogram import Histogram2D
from mcmc1d.quadrature import integrate_plane
from mcmc1d.targets import Ring, Target
from mcmc1d.targets.planar import board
from mcmc1d.techniques import ConcentricDisk, MarginalConditional, Technique
from mcmc1d.techniques.disk import EXAMPLES as DISKS
from mcmc1d.techniques.planar import EXAMPLES as BOXES
from mcmc1d.techniques.planar import outlines
from mcmc1d.techniques.planar_table import EXAMPLES as TABLES
from mcmc1d.techniques.triangle import EXAMPLES as TRIANGLES
from mcmc1d.verify.goodness import expected_distance, p_value, smallest_gap, total_variation
from mcmc1d.verify.mutants.jumps import no_jacobian


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    sigma: float = 0.1
    """Of the small step in u."""
    jump: float = 0.4
    """Probability that a step is a jump."""
    cells: int = 32
    """A side of the histograms."""
    chains: int = 2**12
    steps: int = 256
    blocks: int = 32
    replicas: int = 2**13
    """Of a verification's first stage."""
    theory_replicas: int = 2**15
    """The same of a theory's kernel, of which some are compared with fresh draws."""
    points: int = 300
    """Random points of a contract, besides all edges."""
    trace_chains: int = 512
    trace_steps: int = 2500


PROFILES = {
    "quick": Config(),
    "paper": Config(chains=2**15, steps=4096, replicas=2**18, theory_replicas=2**18, points=10_000, trace_steps=10_000),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

TECHNIQUES: dict[str, Technique] = {**BOXES, **DISKS, **TRIANGLES, **TABLES}
"""The library's examples in the plane."""
TARGETS: dict[str, Target] = {"ring": Ring(), "board": board()}
CASES = (
    ("ring", "reversible jump"),
    ("ring", "no Jacobian"),
    ("ring", "aimed jump"),
    ("board", "reversible jump"),
    ("board", "no Jacobian"),
    ("board", "multiple-try"),
)
"""Reversible jumps are put to `verify` as well."""
_COARSE = 8  # cells a side of the test of last states
LEVEL = 1e-6
"""Of the test of the chains' last states, which are independent: each chain starts as an exact draw."""


def multiplexed(target: Target) -> mcmc1d.Multiplexed:
    """A coarse table of the target's own masses, and a disk."""
    edges = np.linspace(0, 1, 6)
    table = MarginalConditional(target.bin_masses((edges, edges)) + 0.002)
    return mcmc1d.Multiplexed(target, (table, ConcentricDisk((0.5, 0.5), 0.45)))


def moves(config: Config) -> dict[str, Move]:
    """Small steps with one kind of jump, and multiple-try of small steps with a change of technique."""
    small = SmallStep(config.sigma)
    jumps = {
        "reversible jump": ReversibleJump(),
        "aimed jump": AimedJump(),
        "no Jacobian": no_jacobian(ReversibleJump()),
    }
    mixed: dict[str, Move] = {
        name: Mixture({"small": (1 - config.jump, small), "jump": (config.jump, jump)}) for name, jump in jumps.items()
    }
    return mixed | {"multiple-try": MultipleTry(StepAndChange(small), 3, by_target)}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Contracts, verifications, histograms of right and wrong jumps, autocorrelation of three maps."""
    contracts = both_cores(partial(_contract, config), TECHNIQUES.values(), partial(progress, "contracts"))
    targets = {name: multiplexed(target) for name, target in TARGETS.items()}
    kernels = moves(config)

    def verified(target: mcmc1d.Multiplexed) -> verify.Report:
        return verify.verify(kernels["reversible jump"], target, replicas=config.replicas, seed=seed)

    reports = both_cores(verified, targets.values(), partial(progress, "verify"))
    points = [(name, config.theory_replicas, seed) for name in planar_theories.theories()]
    theory = progress.map("theories", planar_theories.put_to_verify, points)
    edges, coarse = np.linspace(0, 1, config.cells + 1), np.linspace(0, 1, _COARSE + 1)
    masses = {name: target.bin_masses((edges, edges)) for name, target in TARGETS.items()}
    joint = {name: target.joint_masses((coarse, coarse)) for name, target in targets.items()}

    def histogram(k: int) -> tuple[np.ndarray, np.ndarray, float]:
        name, move = CASES[k]
        result = long_run(
            f"histogram {k}",
            jax.random.fold_in(jax.random.key(seed), k),
            kernels[move],
            targets[name],
            steps=config.steps,
            chains=config.chains,
            blocks=config.blocks,
            estimators={"x": Histogram2D(edges, edges)},
        )
        return result.mean("x"), result.standard_error("x"), _last(targets[name], result.state, joint[name], coarse)

    found, error, p = zip(*both_cores(histogram, range(len(CASES)), partial(progress, "histograms")), strict=True)
    key = jax.random.key(seed)
    maps = planar_maps.measure(
        key, config.sigma, config.trace_steps, config.trace_chains, partial(progress, "three maps")
    )
    return xr.Dataset(
        {
            "contract": ("technique", [passed for passed, _, _ in contracts]),
            "contract_error": ("technique", [worst for _, worst, _ in contracts]),
            "integral_error": ("technique", [off for _, _, off in contracts]),
            "verdict": ("target", [report.verdict.value for report in reports]),
            "p_value": ("target", [report.p_value for report in reports]),
            "gap": ("target", [report.gap for report in reports]),
            **{of: ("theory", [found[of] for found in theory]) for of in theory[0]},
            "exact": (("target", "x", "y"), [masses[name] / masses[name].sum() for name in TARGETS]),
            "found": (("case", "x", "y"), list(found)),
            "error": (("case", "x", "y"), list(error)),
            "p_last": ("case", list(p)),
            "gap_last": smallest_gap(config.chains, LEVEL),
            **maps,
        },
        {
            "technique": list(TECHNIQUES),
            "target": list(TARGETS),
            "theory": list(planar_theories.theories()),
            "case": [f"{move}, {name}" for name, move in CASES],
            "walked": list(planar_maps.WALKED),
            "chart": list(planar_maps.MAPS),
        },
    )


def _last(target: mcmc1d.Multiplexed, state: mcmc1d.State, joint: np.ndarray, edges: np.ndarray) -> float:
    """The p-value of the chains' last states on a few cells of each technique, all of them lit."""
    x, index = np.asarray(jax.vmap(target.evaluate)(state).seen.x), np.asarray(state.index)
    counts = np.stack([np.histogramdd(x[index == i], [edges, edges])[0] for i in range(len(joint))])
    lit = joint > 0
    return p_value(counts[lit], joint[lit]) if counts[~lit].sum() == 0 else 0.0


def _contract(config: Config, technique: Technique) -> tuple[bool, float, float]:
    """Whether it passes in float64, its largest error as a share of the tolerance there, the integral's error."""
    report = verify.check_technique(technique, points=config.points, dtypes=(np.float64,))
    equations = [check for check in report.checks if "=" in check.equation]
    lower, upper = (np.asarray(corner, np.float64) for corner in technique.support)
    sides = [np.linspace(lower[k], upper[k], 5) for k in range(2)]
    masses, _ = integrate_plane(lambda x: jnp.exp(technique.log_prob(x)), sides[0], sides[1], outlines(technique))
    return report.passed, max(check.error / check.tolerance for check in equations), float(abs(masses.sum() - 1))


def draw(data: xr.Dataset) -> Figure:
    """A row for each target: exact, sampled, and the errors of the right jump and of the one without its Jacobian."""
    figure, axes = plt.subplots(len(TARGETS), 4, figsize=(7.0, 3.2), sharex=True, sharey=True)
    for row, target in zip(axes, data.target.to_numpy(), strict=True):
        here = data.sel(target=target)
        exact = here.exact.to_numpy()
        cells = exact.size
        top = 1.05 * float(exact.max()) * cells
        right, wrong = (data.sel(case=f"{move}, {target}") for move in ("reversible jump", "no Jacobian"))
        for axis, values in ((row[0], exact), (row[1], right.found.to_numpy())):
            shown = axis.imshow(values.T * cells, origin="lower", extent=(0, 1, 0, 1), vmin=0, vmax=top, cmap="viridis")
        figure.colorbar(shown, ax=list(row[:2]), label="density", shrink=0.9, aspect=25)
        for axis, run, most in ((row[2], right, 5), (row[3], wrong, 20)):
            error = run.error.to_numpy()
            off = run.found.to_numpy() - exact
            # Grey: holes, and cells so dark that the error of their few hits is far from normal.
            z = np.divide(off, error, out=np.full_like(error, np.nan), where=exact * cells > 0.05)
            # A law that is a little wrong shows too: the scale ends where the error does, at 5 standard errors or over.
            limit = float(np.clip(np.ceil(np.nanmax(np.abs(z))), 5, most))
            axis.set_facecolor("0.75")
            shown = axis.imshow(z.T, origin="lower", extent=(0, 1, 0, 1), vmin=-limit, vmax=limit, cmap="RdBu_r")
            # Beyond the scale's ends an arrow says so.
            extend = "both" if np.nanmax(np.abs(z)) > limit else "neither"
            figure.colorbar(shown, ax=axis, label="error / s.e.", shrink=0.9, aspect=25, extend=extend)
        row[0].set_ylabel(f"{target}\n$x_1$")
    titles = ("exact", "sampled by jumps", "error, right jump", "error, no Jacobian")
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title)
    for axis in axes[-1]:
        axis.set_xlabel("$x_0$")
    for axis in axes.ravel():
        axis.set_xticks([0, 0.5, 1], ["0", "½", "1"])
        axis.set_yticks([0, 0.5, 1], ["0", "½", "1"])
        axis.spines[:].set_visible(False)
    return figure


def table(data: xr.Dataset) -> Table:
    """Contracts, verdicts, distances and autocorrelation times."""
    result = Table("what", "where", "found", "held to", box=SIMPLE, padding=0)
    result.title = "planar: contracts, verdicts, total variation (by chance), autocorrelation times"
    for name in data.technique.to_numpy():
        here = data.sel(technique=name)
        passed = "passes" if here.contract else "FAILS"
        result.add_row("contract", name, f"{passed}, {float(here.contract_error):.1e} of", "1e-10 x condition")
    for target in data.target.to_numpy():
        here = data.sel(target=target)
        found = f"{here.verdict.to_numpy()}, p {float(here.p_value):.2g}"
        result.add_row("verify", f"reversible jump, {target}", found, f"CDF gap {float(here.gap):.3f}")
    for case in data.case.to_numpy():
        distance, chance = _distance(data, case)
        found = f"{distance:.4f}, last states p {float(data.p_last.sel(case=case)):.2g}"
        result.add_row("TV", str(case), found, f"{chance:.4f}")
    for walked in data.walked.to_numpy():
        for name in data.chart.to_numpy():
            here = data.sel(walked=walked, chart=name)
            pairs = zip(here.time.to_numpy(), here.time_error.to_numpy(), strict=True)
            times = ", ".join(f"{time:.1f} ± {error:.1f}" for time, error in pairs)
            tv = f"{float(here.map_distance):.4f} ({float(here.map_chance):.4f})"
            result.add_row("time", f"{name} on {walked}", times, f"TV {tv}")
    return result


def _distance(data: xr.Dataset, case: str) -> tuple[float, float]:
    """The total variation from the exact law, and that which chance makes."""
    here = data.sel(case=case)
    exact = data.exact.sel(target=str(case).partition(", ")[2]).to_numpy()
    return total_variation(here.found.to_numpy(), exact), expected_distance(here.error.to_numpy())


def judge(data: xr.Dataset) -> list[Claim]:
    """What is right is accepted, what is wrong is off by more than chance; the maps differ in time and not in law."""
    worst = data.technique.to_numpy()[int(np.argmax(data.contract_error.to_numpy()))]
    passed, off = bool(data.contract.all()), float(data.integral_error.max())
    claims = [
        Claim(
            "planar.contracts",
            "Planar techniques invert, and their determinants are their densities",
            "ours; Shirley and Chiu 1997 (concentric map)",
            "holds" if passed and off < 1e-9 else "fails",
            "holds",
            f"{data.sizes['technique']} of them, worst error {float(data.contract_error.max()):.1e} of its "
            f"tolerance ({worst}); integrals off by {off:.1e} at most",
            "1e-10 times the condition number, at random points and all edges; integrals 1e-9",
        )
    ]
    for name, move in CASES:
        case, target = f"{move}, {name}", data.sel(target=name)
        distance, chance = _distance(data, case)
        p = float(data.p_last.sel(case=case))
        held = f"last states: level {LEVEL:.0e}, a CDF gap of {float(data.gap_last):.3f} seen with probability 0.99"
        if move == "no Jacobian":
            claims.append(
                Claim(
                    f"planar.no-jacobian-{name}",
                    f"In the plane too, a jump without its Jacobian has a wrong law ({name})",
                    "Bitterli et al. 2017, sec. 7.1",
                    "holds" if p < LEVEL else "fails",
                    "holds",
                    f"TV {distance:.4f} (chance makes {chance:.4f}), p {p:.1g}",
                    held,
                )
            )
            continue
        verified, number = True, f"TV {distance:.4f} (chance makes {chance:.4f}), last states p {p:.2g}"
        if move == "reversible jump":
            said = str(target.verdict.to_numpy())
            verified = passes([said])
            number = f"{said}, p {float(target.p_value):.2g}; {number}"
            held = f"verify: level 1e-5, a CDF gap of {float(target.gap):.3f}; {held}"
        claims.append(
            Claim(
                f"planar.{move.replace(' ', '-')}-{name}",
                f"In the plane, {'multiple-try' if move == 'multiple-try' else f'the {move}'} keeps the law ({name})",
                "Segovia et al. 2007, sec. 5.1" if move == "multiple-try" else "Bitterli et al. 2017, eqs. 14, 19",
                verdict(p >= LEVEL, verified),
                "holds",
                number,
                held,
            )
        )
    return [*claims, *planar_theories.claims(data), *planar_maps.claims(data)]
