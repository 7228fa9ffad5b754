"""Multiple-try: which weights, competitors and perturbations keep the law, and how far off the others are."""

from collections.abc import Callable
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

import mcmc1d
from experiments.support.framework import Claim
from experiments.support.mtm_lambda_kernels import (
    ASYMMETRIC,
    RING_STEP,
    SYMMETRIC,
    F,
    FreshCompetitors,
    OtherStrata,
    Unchecked,
    rings,
)
from experiments.support.sweep import Sweep
from experiments.support.transitions import stationary
from experiments.support.verdict import passes, verdict, witnessed
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import (
    Antithetic,
    LinearStep,
    Move,
    MultipleTry,
    Rotated,
    SmallStep,
    Stratified,
    TruncatedStep,
    UniformStep,
)
from mcmc1d.moves.multiple_try import by_target, evenly
from mcmc1d.targets import FromFunction, GaussianMixture
from mcmc1d.techniques import Uniform
from mcmc1d.verify import enumerate_kernel, ring, transition_operator, verify
from mcmc1d.verify.goodness import total_variation
from mcmc1d.verify.mutants.jumps import WrongDeterminant

SOURCE = "Segovia et al. 2007"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    sigma: float = 0.2
    """Of the clamped Gaussian on the line."""
    bins: int = 20
    cells: int = 100
    points: int = 2**13
    """Of a net for the operator of a perturbation, of which there are two."""
    law_points: int = 2**16
    """Of a net for the law with and without the normaliser."""
    chains: int = 2**14
    """Whose acceptance is averaged, in one step from exact starts."""
    replicas: int = 2**14
    level: float = 1e-5


PROFILES = {"quick": Config(), "paper": Config(cells=400, points=2**18, law_points=2**19, chains=2**20, replicas=2**17)}

SIZES = (0.06, 0.12, 0.18, 0.25)
SHAPES: dict[str, Callable[[float], Move]] = {
    "Gaussian": SmallStep,
    "uniform": lambda sigma: UniformStep(sigma * np.sqrt(12)),
    "linear": lambda sigma: LinearStep(sigma * np.sqrt(24)),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""
TRIES = (1,)
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
    data["first_p"] = ("witness", [report.p_value for report in verdicts.values()])
    return xr.Dataset(
        {**data, **_clamped(config, progress), **_shapes(config, seed, progress)},
        {
            "ring": list(kernels),
            "witness": list(verdicts),
            "shape": list(SHAPES),
            "sd": list(SIZES),
            "tries": list(TRIES),
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


def _shapes(config: Config, seed: int, progress: Sweep) -> dict[str, Any]:
    """Each perturbation at each size: its acceptance at the best, and the error of a histogram at equal work, exactly.

    Autocorrelation: the mean over the bins of their indicators' integrated autocorrelation times, each counted by its
    variance; the error at equal work is the root of that times the evaluations a step, independent samples' being 1.
    """
    shape = (len(SHAPES), len(SIZES), len(TRIES))
    acceptance, time = np.zeros((shape[0], shape[2])), np.zeros(shape)
    for i, k in np.ndindex(acceptance.shape):
        steps = [list(SHAPES.values())[i](size) for size in SIZES]
        moves = [step if TRIES[k] == 1 else MultipleTry(step, TRIES[k]) for step in steps]
        for j, move in enumerate(moves):
            operator = transition_operator(move, LINE, u_cells=config.cells, x_cells=1, points=config.points)
            time[i, j, k] = _time(operator, config.bins)
            progress("perturbations", (i * len(TRIES) + k) * len(SIZES) + j + 1, time.size)
        chains = mcmc1d.run(
            jax.random.key(seed),
            moves[int(time[i, :, k].argmin())],
            LINE,
            steps=1,
            chains=config.chains,
            blocks=1,
            estimators={"acceptance": mcmc1d.Acceptance()},
        )
        acceptance[i, k] = next(iter(chains.acceptance().values()))
    work = np.array([2 * tries - 1 for tries in TRIES])
    where = ("shape", "sd", "tries")
    return {"rate": (("shape", "tries"), acceptance), "time": (where, time), "error": (where, np.sqrt(time * work))}


def _time(operator: Any, bins: int) -> float:
    """The sum of the bins' asymptotic variances over that of their variances, from the fundamental matrix."""
    p, mu = operator.matrix.toarray(), operator.stationary()
    inside = np.repeat(np.eye(bins), len(mu) // bins, axis=0)
    g = inside - mu @ inside
    variance = float(mu @ (g * g).sum(1))
    z = np.linalg.solve(np.eye(len(mu)) - p + mu, g)
    return 2 * float(mu @ (g * z).sum(1)) / variance - 1


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
    middle.legend(fontsize=5.5, ncols=2, loc="upper center")
    for k, shape in enumerate(data.shape.to_numpy()):
        for tries in TRIES:
            # One over the other, and to be seen all the same: they hardly differ, which is the finding.
            style = {"color": f"C{k}", "linestyle": ("-", "--", ":")[k], "linewidth": (2.2, 1.4, 1.2)[k]}
            style |= {"marker": "os^"[k], "markersize": (6, 4, 2.5)[k]}
            here = data.error.sel(shape=shape, tries=tries)
            right.plot(data.sd, here, label=str(shape) if tries == 1 else None, **style)
    right.set(xlabel="standard deviation of the step", ylabel="error at equal work", yscale="log")
    right.set_yticks([1.5, 2, 3, 4, 5], ["1.5", "2", "3", "4", "5"])
    right.minorticks_off()
    right.set_title("independent samples: 1", fontsize=6)
    right.legend(fontsize=5.5)
    return figure


def table(data: xr.Dataset) -> Table:
    """Each perturbation at its best size."""
    result = Table("perturbation", "candidates", "best size", "acceptance", "autocorrelation time", "error", box=SIMPLE)
    result.title = "mtm_lambda: perturbations, each at its best size; error of a histogram at equal work"
    for shape in data.shape.to_numpy():
        for tries in TRIES:
            here = data.sel(shape=shape, tries=tries)
            best = here.isel(sd=int(here.error.to_numpy().argmin()))
            result.add_row(str(shape), str(tries), *(f"{float(best[n]):.3g}" for n in ("sd", "rate", "time", "error")))
    return result


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
    apart = max(total_variation(laws[f"without{p}"], data.predicted.to_numpy()) for p in ("", ", p = 4"))
    wrong = total_variation(data.predicted.to_numpy(), exact)
    best = data.error.min("sd")
    shapes = {str(s): best.sel(shape=s).to_numpy() for s in data.shape.to_numpy()}
    rivals = np.min([shapes["uniform"], shapes["linear"]], axis=0)
    gap = float(data.gap.max())
    statistics = f"verify at {data.level:.0e} detects a CDF gap of {gap:.3f} at most with probability 0.99"
    enumeration = "enumeration, p = 2, lopsided step; exact to 1e-12"

    def claim(
        name: str, statement: str, source: str, holds: bool, expected: str, number: str, held: str, witness: str = ""
    ) -> Claim:
        """Of what is exact, and of the verification on the line where one is named."""
        found = witnessed(holds, passes([said[witness]])) if witness else verdict(holds)
        return Claim(f"mtm.{name}", statement, source, found, expected, number, held)

    return [
        claim(
            "symmetric-lambda",
            f"Multiple-try keeps the law for every symmetric lambda ({len(SYMMETRIC)} of them) with the ratio R_g",
            f"{SOURCE}, sec. 5.1; Liu, Liang, Wong 2000",
            symmetric < 1e-12,
            "holds",
            f"residual {symmetric:.1e}; on the line with stratified clamped candidates: {said['right']}",
            f"{enumeration}; {statistics}",
            "right",
        ),
        claim(
            "one-candidate",
            "With one candidate it is Metropolis",
            f"{SOURCE}, sec. 5.1",
            float(data.one_gap) < 1e-12,
            "holds",
            f"the matrices differ by {float(data.one_gap):.1e}",
            "enumeration, 1e-12",
        ),
        claim(
            "asymmetric-lambda",
            "R_g keeps the law with a lambda that is not symmetric",
            f"ours; {SOURCE}, sec. 5.1",
            max(lopsided.values()) < 1e-12,
            "fails",
            "TV "
            + ", ".join(f"{value:.4f} ({name})" for name, value in lopsided.items())
            + f"; `check` refuses {int(data.refused)} of {len(ASYMMETRIC)}; on the line: "
            f"{said['lambda not symmetric']}",
            f"{enumeration}; {statistics}",
            "lambda not symmetric",
        ),
        claim(
            "intervals",
            "With the selector's interval in the determinant any weights keep it, equal ones too",
            "Pandolfi, Bartolucci, Friel 2010",
            intervals < 1e-12,
            "holds",
            f"residual {intervals:.1e}; on the line, equal weights: {said['even weights']}",
            f"{enumeration}; {statistics}",
            "even weights",
        ),
        claim(
            "strata-all-but-chosen",
            "Stratified candidates, with competitors in all strata but the chosen one's, keep the law",
            f"ours; {SOURCE}, sec. 6.2; Craiu and Lemieux 2007",
            off["strata: all but the chosen"] < 1e-12,
            "fails",
            f"TV {off['strata: all but the chosen']:.4f}; on the line: {said['other strata']}",
            f"{enumeration}; {statistics}",
            "other strata",
        ),
        claim(
            "strata-left-free",
            "With competitors in the strata that the way back leaves free they do",
            "ours; Craiu and Lemieux 2007",
            residual["strata: left free"] < 1e-12,
            "holds",
            f"residual {residual['strata: left free']:.1e}; on the line, four clamped ones: {said['right']}",
            f"{enumeration}; {statistics}",
            "right",
        ),
        claim(
            "quasi-random-independent",
            "Quasi-random candidates with independent competitors keep the law",
            f"ours; {SOURCE}, sec. 6.3; Craiu and Lemieux 2007",
            off["quasi-random: independent"] < 1e-12,
            "fails",
            f"TV {off['quasi-random: independent']:.4f}; on the line: {said['fresh competitors']}",
            f"{enumeration}; {statistics}",
            "fresh competitors",
        ),
        claim(
            "quasi-random-rotated",
            "With competitors of the rotation that leads back they do",
            "ours; Craiu and Lemieux 2007",
            residual["quasi-random: rotated"] < 1e-12,
            "holds",
            f"residual {residual['quasi-random: rotated']:.1e}; on the line: {said['rotated']}",
            f"{enumeration}; {statistics}",
            "rotated",
        ),
        claim(
            "antithetic-independent",
            "Antithetic candidates, w and 1 - w, with an independent competitor keep the law",
            "ours; Craiu and Lemieux 2007",
            off["antithetic: independent"] < 1e-12,
            "fails",
            f"TV {off['antithetic: independent']:.4f}; on the line: {said['fresh opposite']}",
            f"{enumeration}; {statistics}",
            "fresh opposite",
        ),
        claim(
            "antithetic-opposite",
            "With the opposite of the way back as the competitor they do",
            "ours; Craiu and Lemieux 2007",
            residual["antithetic: opposite"] < 1e-12,
            "holds",
            f"residual {residual['antithetic: opposite']:.1e}; on the line: {said['antithetic']}",
            f"{enumeration}; {statistics}",
            "antithetic",
        ),
        claim(
            "clamped-without",
            "A clamped Gaussian without its normaliser keeps the law",
            f"ours; {SOURCE}, sec. 6.1",
            not (wrong > 2e-3 and apart < 5e-3),
            "fails",
            f"TV {wrong:.4f}: the law is f Z, to {apart:.1e} by the operator (p = 1, 4); on the line: "
            f"{said['no normaliser']}",
            f"quadrature, sigma 0.2; {statistics}",
            "no normaliser",
        ),
        claim(
            "clamped-with",
            "With its normaliser in the ratio it does",
            f"{SOURCE}, sec. 6.1",
            right < 2e-3,
            "holds",
            f"TV {right:.1e} from the exact law by the operator; on the line: {said['right']}",
            f"TV 2e-3; {statistics}",
            "right",
        ),
        claim(
            "shapes",
            "With one candidate, Gaussian perturbations are more effective than uniform and linear ones",
            f"ours; {SOURCE}, sec. 6.1, which speaks of many",
            bool(np.all(shapes["Gaussian"] < 0.98 * rivals)),
            "fails",
            "error of a histogram at equal work: " + "; ".join(f"{name} {e[0]:.3f}" for name, e in shapes.items()),
            "operator, at 2 % of a difference; sizes up to 0.25, on which all three are about alike",
        ),
    ]
