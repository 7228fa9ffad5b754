"""Multiple-try: which weights, competitors and perturbations keep the law, and how far off the others are."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.table import Table

import mcmc1d
from experiments.support import mtm_lambda_shapes
from experiments.support.framework import Claim
from experiments.support.mtm_lambda_kernels import (
    ASYMMETRIC,
    CANDIDATES,
    RING_STEP,
    SOURCE,
    SYMMETRIC,
    F,
    FreshCompetitors,
    Kept,
    OtherStrata,
    Unchecked,
    rings,
)
from experiments.support.sweep import Sweep
from experiments.support.transitions import stationary
from experiments.support.verdict import detects, passes, verdict, witnessed
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import (
    Antithetic,
    Move,
    MultipleTry,
    Rotated,
    SmallStep,
    Stratified,
    TruncatedStep,
)
from mcmc1d.moves.multiple_try import by_target, evenly
from mcmc1d.targets import FromFunction, GaussianMixture
from mcmc1d.techniques import Uniform
from mcmc1d.verify import enumerate_kernel, ring, transition_operator, verify
from mcmc1d.verify.goodness import total_variation
from mcmc1d.verify.mutants.jumps import WrongDeterminant


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    sigma: float = 0.2
    """Of the clamped Gaussian on the line."""
    bins: int = 20
    cells: int = 100
    points: int = 2**13
    """Of a net for the operator of a perturbation at a size, of which there are twelve."""
    law_points: int = 2**16
    """Of a net for the law with and without the normaliser."""
    chains: int = 2**14
    """Whose acceptance is averaged, in one step from exact starts."""
    replicas: int = 2**14
    level: float = 1e-5


PROFILES = {"quick": Config(), "paper": Config(cells=400, points=2**18, law_points=2**19, chains=2**20, replicas=2**17)}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""
CLAMPED = ("with", "without", "without, p = 4")
LINE = mcmc1d.Multiplexed(GaussianMixture([0.1, 0.45, 0.9], [0.08, 0.06, 0.12], [0.5, 0.2, 0.3]), Uniform())


def moves_on_the_line(sigma: float) -> dict[str, Move]:
    """Moves on the line for `verify`: right ones, and wrong ones."""
    step = TruncatedStep(sigma)
    odd = SYMMETRIC["exp(cos 7(x-y) + xy)"]
    return {
        "right": MultipleTry(step, 4, odd, Stratified(), ratio="R_g"),
        "no normaliser": WrongDeterminant(step, jnp.zeros_like),
        "lambda not symmetric": Unchecked(MultipleTry(step, 4, evenly, ratio="R_g")),
        "other strata": MultipleTry(SmallStep(sigma / 2), 2, by_target, OtherStrata()),
        "fresh competitors": MultipleTry(SmallStep(sigma / 2), 2, by_target, FreshCompetitors(Rotated())),
        "fresh opposite": MultipleTry(SmallStep(sigma / 2), 2, by_target, FreshCompetitors(Antithetic())),
        "antithetic": MultipleTry(SmallStep(sigma / 2), 2, by_target, Antithetic()),
        "rotated": MultipleTry(SmallStep(sigma / 2), 2, by_target, Rotated()),
        "even weights": MultipleTry(step, 4, evenly),
    }


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The ring, enumerated; the clamped Gaussian by the operator; perturbations compared; witnesses by `verify`."""
    target, states = ring(F)
    kernels = rings()
    found = {}
    for k, (name, (move, plan)) in enumerate(kernels.items()):
        # A break that is bisected shows only where what changes is chosen: it is looked for at many selectors.
        probes, inner = (17, 128) if plan[0] is None else (33, 8)
        found[name] = enumerate_kernel(Metropolis(move), target, states, plan, probes=probes, inner=inner)
        progress("enumeration", k + 1, len(kernels))
    refused = 0
    for weight in ASYMMETRIC.values():
        try:
            MultipleTry(RING_STEP, 2, weight, ratio="R_g").check(target)
        except ValueError:
            refused += 1
    data = {
        "ring_tv": ("ring", [total_variation(stationary(e.matrix), e.law) for e in found.values()]),
        "ring_residual": ("ring", [e.residual for e in found.values()]),
        "one_gap": np.abs(found["one candidate"].matrix - found["Metropolis"].matrix).max(),
        "refused": refused,
    }
    verdicts = {}
    for k, (name, move) in enumerate(moves_on_the_line(config.sigma).items()):
        verdicts[name] = verify(move, LINE, seed=seed, replicas=config.replicas, level=config.level, name=name)
        progress("witnesses", k + 1, len(moves_on_the_line(config.sigma)))
    data["verdict"] = ("witness", [report.verdict.value for report in verdicts.values()])
    data["gap"] = ("witness", [report.gap for report in verdicts.values()])
    shapes = mtm_lambda_shapes.measure(
        jax.random.key(seed),
        LINE,
        config.bins,
        config.cells,
        config.points,
        config.chains,
        partial(progress, "perturbations"),
    )
    return xr.Dataset(
        {**data, **_clamped(config, progress), **shapes},
        {
            "ring": list(kernels),
            "witness": list(verdicts),
            "shape": list(mtm_lambda_shapes.SHAPES),
            "sd": list(mtm_lambda_shapes.SIZES),
            "bin": (np.arange(config.bins) + 0.5) / config.bins,
        },
        {"level": config.level, "replicas": config.replicas},
    )


def _clamped(config: Config, progress: Sweep) -> dict[str, Any]:
    """The law with and without the normaliser, by the operator, beside f and the f Z that theory predicts."""
    edges = np.linspace(0, 1, config.bins + 1)
    step = TruncatedStep(config.sigma)
    with jax.enable_x64(True):
        without = FromFunction(lambda x: jnp.exp(LINE.target.log_f(x) + step.log_normaliser(x)))
        masses = [each.bin_masses(edges) for each in (LINE.target, without)]
    wrong = WrongDeterminant(step, jnp.zeros_like)
    moves = dict(zip(CLAMPED, (step, wrong, MultipleTry(wrong, 4, by_target)), strict=True))
    laws = []
    for k, move in enumerate(moves.values()):
        operator = transition_operator(move, LINE, u_cells=config.cells, x_cells=1, points=config.law_points)
        laws.append(operator.law_of(edges).masses[0])
        progress("clamped Gaussian", k + 1, len(moves))
    return {
        "exact": ("bin", masses[0] / masses[0].sum()),
        "predicted": ("bin", masses[1] / masses[1].sum()),
        "clamped": (("normaliser", "bin"), np.array(laws)),
        "normaliser": list(moves),
    }


def draw(data: xr.Dataset) -> Figure:
    """Total variation of each kernel's law; the law without the normaliser; perturbations compared."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7.0, 2.6), width_ratios=(1, 1, 1.1))
    names = [str(name) for name in data.ring.to_numpy() if ":" in str(name)]
    off = np.maximum(data.ring_tv.sel(ring=names).to_numpy(), 1e-17)
    places = np.arange(len(names))[::-1]
    left.scatter(off, places, s=12, c=np.where(off < 1e-12, "C2", "C1"))
    left.axvline(1e-12, color="grey", linewidth=0.6, linestyle=":")
    left.set(xscale="log", xlim=(3e-18, 3), xlabel="TV of the law, enumerated")
    left.set_yticks(places, names, fontsize=5.5)
    left.set_xticks([1e-16, 1e-12, 1e-8, 1e-4, 1])
    left.minorticks_off()
    x, exact = data.bin.to_numpy(), data.exact.to_numpy()
    middle.plot(x, data.predicted / exact, color="C1", label="f Z, predicted")
    marks = {"without": ("C1", "o"), "without, p = 4": ("C3", "x"), "with": ("C2", "o")}
    for name, (colour, mark) in marks.items():
        middle.plot(
            x,
            data.clamped.sel(normaliser=name) / exact,
            mark,
            color=colour,
            markersize=3,
            markerfacecolor="none",
            label=name,
        )
    middle.set(xlabel="x", ylabel="law / target's law", ylim=(0.5, 1.5), title="clamped Gaussian's normaliser")
    middle.legend(fontsize=5.5, loc="lower center")
    mtm_lambda_shapes.draw(data, right)
    return figure


def table(data: xr.Dataset) -> Table:
    """Each perturbation at its best size."""
    return mtm_lambda_shapes.table(data)


def judge(data: xr.Dataset) -> list[Claim]:
    """Symmetric lambdas, one candidate, any weights in the intervals form, competitors, normalisers, perturbations."""
    off = dict(zip((str(name) for name in data.ring.to_numpy()), data.ring_tv.to_numpy(), strict=True))
    residual = dict(zip(off, data.ring_residual.to_numpy(), strict=True))
    said = dict(zip(data.witness.to_numpy(), data.verdict.to_numpy(), strict=True))
    symmetric = max(residual[f"R_g: {name}"] for name in SYMMETRIC)
    intervals = max(residual[f"intervals: {name}"] for name in ASYMMETRIC)
    lopsided = {name: off[f"R_g: {name}"] for name in ASYMMETRIC}
    exact = data.exact.to_numpy()
    laws = {str(name): data.clamped.sel(normaliser=name).to_numpy() for name in data.normaliser.to_numpy()}
    right = total_variation(laws["with"], exact)
    without = [laws[name] for name in ("without", "without, p = 4")]
    wrong = min(total_variation(law, exact) for law in without)
    apart = max(total_variation(law, data.predicted.to_numpy()) for law in without)
    statistics = detects(data.gap, data.level)
    enumeration = "enumeration, p = 2, lopsided step; exact to 1e-12"

    def claim(
        name: str,
        statement: str,
        source: str,
        number: str,
        holds: bool,
        witness: str,
        expected: str = "holds",
        there: str = "",
        held: str = enumeration,
    ) -> Claim:
        """Of what is known exactly, and has been verified on the line."""
        found = witnessed(holds, passes([said[witness]]))
        number = f"{number}; on the line{there}: {said[witness]}"
        return Claim(f"mtm.{name}", statement, source, found, expected, number, f"{held}; {statistics}")

    def kept(it: Kept) -> Claim:
        number = f"TV {off[it.ring]:.4f}" if it.expected == "fails" else f"residual {residual[it.ring]:.1e}"
        holds = residual[it.ring] < 1e-12
        return claim(it.name, it.statement, it.source, number, holds, it.line, it.expected, it.there)

    one = float(data.one_gap)
    return [
        claim(
            "symmetric-lambda",
            f"Multiple-try keeps the law for every symmetric lambda ({len(SYMMETRIC)} of them) with the ratio R_g",
            f"{SOURCE}, sec. 5.1; Liu, Liang, Wong 2000",
            f"residual {symmetric:.1e}",
            symmetric < 1e-12,
            "right",
            there=" with stratified clamped candidates",
        ),
        Claim(
            "mtm.one-candidate",
            "With one candidate it is Metropolis",
            f"{SOURCE}, sec. 5.1",
            verdict(one < 1e-12),
            "holds",
            f"the matrices differ by {one:.1e}",
            "enumeration, 1e-12",
        ),
        claim(
            "asymmetric-lambda",
            "R_g keeps the law with a lambda that is not symmetric",
            f"ours; {SOURCE}, sec. 5.1",
            "TV "
            + ", ".join(f"{value:.4f} ({name})" for name, value in lopsided.items())
            + f"; `check` refuses {int(data.refused)} of {len(ASYMMETRIC)}",
            max(lopsided.values()) < 1e-12,
            "lambda not symmetric",
            "fails",
        ),
        claim(
            "intervals",
            "With the selector's interval in the determinant any weights keep it, equal ones too",
            "Pandolfi, Bartolucci, Friel 2010",
            f"residual {intervals:.1e}",
            intervals < 1e-12,
            "even weights",
            there=", equal weights",
        ),
        *map(kept, CANDIDATES),
        claim(
            "clamped-without",
            "A clamped Gaussian without its normaliser keeps the law",
            f"ours; {SOURCE}, sec. 6.1",
            f"TV {wrong:.4f} from the exact law by the operator, at least (p = 1, 4)",
            wrong < 2e-3,
            "no normaliser",
            "fails",
            held="TV 2e-3, sigma 0.2",
        ),
        Claim(
            "mtm.clamped-law",
            "Without it the law is f Z, Z the share of the Gaussian that is not cut off",
            f"ours; {SOURCE}, sec. 6.1",
            verdict(apart < 5e-3),
            "holds",
            f"TV {apart:.1e} at most by the operator (p = 1, 4)",
            "quadrature of f Z, TV 5e-3, sigma 0.2",
        ),
        claim(
            "clamped-with",
            "With its normaliser in the ratio it does",
            f"{SOURCE}, sec. 6.1",
            f"TV {right:.1e} from the exact law by the operator",
            right < 2e-3,
            "right",
            held="TV 2e-3",
        ),
        mtm_lambda_shapes.claim(data),
    ]
