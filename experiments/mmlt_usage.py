"""Where the samples go: techniques in multiplexed MLT and in PSSMLT, lengths in one chain and in one each."""

from dataclasses import dataclass
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
from experiments.support import mmlt_usage_lengths
from experiments.support.framework import Claim
from experiments.support.long import long_run
from experiments.support.mmlt_usage_lengths import CHECKPOINTS, histograms, lengths, over_lengths
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, passes, verdict
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import LargeStep, Mixture, Move, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.pooled import Pooled, PooledDeposit, integral, pooled
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import FromFunction, Tabulated
from mcmc1d.techniques import Inversion, PiecewiseConstant, Ramp, TruncatedNormal, Uniform
from mcmc1d.types import Scalar
from mcmc1d.verify import RingStep, deposit_law, enumerate_kernel, ring, verify
from mcmc1d.weights import FromFunction as Weighting

SOURCE = "Hachisuka et al. 2014"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    sigma: float = 0.02
    large: float = 0.1
    """Probability of a large step."""
    bins: int = 20
    chains: int = 2**12
    steps: int = 128
    blocks: int = 16
    points: int = 2**15
    """Of the nets over one step, of which there are eight."""
    proposals: int = 2**16
    """Of which the effective path ratio is the lit share."""
    replicas: int = 2**14
    """Of each verification."""
    work: int = 2**12
    """Samples that each repetition of a comparison may evaluate."""
    repeats: int = 128


PROFILES = {
    "quick": Config(),
    "paper": Config(steps=2048, points=2**18, proposals=2**21, replicas=2**18, work=2**14, repeats=512),
}

F = FromFunction(
    lambda x: jnp.where((x > 0.3) & (x < 0.45), 8 * (x - 0.2), jnp.where((x > 0.8) & (x < 0.85), 3.0, 0.0)),
    breaks=(0.3, 0.45, 0.8, 0.85),
)
"""Two lit intervals, dark between them: most samples find nothing."""
TECHNIQUES = (Ramp(-1.2), TruncatedNormal(0.4, 0.15), PiecewiseConstant([0, 0.5, 1], [0.3, 1.7]), Uniform())
NAMES = ("ramp", "normal", "step", "uniform")
METHODS = ("MMLT", "MMLT, any index", "PSSMLT, sum", "PSSMLT, max")
CLOSE = [[0.94, 0.03, 0, 0.03], [0.03, 0.94, 0.03, 0], [0, 0.03, 0.94, 0.03], [0.03, 0, 0.03, 0.94]]
"""Where a small step of 0.02 leads the floor of 4 u_t, around the ends: how often it crosses a quarter's end."""


class Shift(Inversion):
    """x = u + 2/5 around the ends: the cells of a ring of five onto cells."""

    def quantile(self, u: Scalar) -> Scalar:
        return (u + 0.4) % 1.0

    def cdf(self, x: Scalar) -> Scalar:
        return (x + 0.6) % 1.0

    def log_prob(self, x: Scalar) -> Scalar:
        return jnp.where((x >= 0) & (x <= 1), 0.0, -jnp.inf)


def methods(config: Config) -> dict[str, tuple[Multiplexed, Kernel]]:
    """The target and the kernel of each method: the same mutations, with a technique change in MMLT.

    In the paper a small step moves u_t too, so that the index mostly stays; "any index" draws it afresh.
    """
    small, large = SmallStep(config.sigma), LargeStep()
    target = Multiplexed(F, TECHNIQUES)

    def mixture(one: Move, other: Move) -> Mixture:
        return Mixture({"large": (config.large, one), "small": (1 - config.large, other)})

    close = mixture(StepAndChange(large), StepAndChange(small, TechniqueChange(CLOSE)))
    afresh = mixture(StepAndChange(large), StepAndChange(small))
    plain = PooledDeposit(mixture(large, small))
    return {
        METHODS[0]: (target, mcmc1d.Metropolis(close)),
        METHODS[1]: (target, mcmc1d.Metropolis(afresh)),
        METHODS[2]: (pooled(target, "sum"), plain),
        METHODS[3]: (pooled(target, "maximum"), plain),
    }


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Usage, laws of deposits, effective path ratio, errors at equal work; lengths and their b_k."""
    edges = np.linspace(0, 1, config.bins + 1)
    masses = F.bin_masses(edges)
    b = float(masses.sum())
    target = Multiplexed(F, TECHNIQUES)
    joint = target.joint_masses(edges)
    found: dict[str, list[Any]] = {key: [] for key in ("scale", "net", "net_error", "mean", "ratio", "spread", "error")}
    usage, usage_error = np.zeros(len(NAMES)), np.zeros(len(NAMES))
    for k, (name, (own, kernel)) in enumerate(methods(config).items()):
        key, proposals_key, errors_key = jax.random.split(jax.random.fold_in(jax.random.key(seed), k), 3)
        one = name.startswith("MMLT")
        scale = b if one else integral(own.target)  # what deposits are multiplied by
        net = net_error = np.full(config.bins, np.nan)
        if not one:
            net, net_error = deposit_law(kernel, own, edges, points=config.points)
        if name == "MMLT":
            size: dict[str, Any] = {"steps": config.steps, "chains": config.chains, "blocks": config.blocks}
            joint_histogram = {"x": mcmc1d.Histogram(edges, joint=True)}
            chains = long_run("usage", key, kernel, own, **size, estimators=joint_histogram)
            blocks = chains.sums["x"].sum(2) * config.blocks / (config.chains * config.steps)
            usage, usage_error = blocks.mean(0), sem(blocks)
        ratio, spread = _effective(config, own, kernel, proposals_key)
        # At equal work: a step of PSSMLT evaluates the samples of all techniques.
        steps = config.work // (1 if one else len(TECHNIQUES))
        each = histograms(errors_key, kernel, own, edges, steps, config.repeats)
        error, mean = np.sqrt(np.mean((scale * each - masses) ** 2, axis=1)), each.mean(0)
        for part, value in zip(found, (scale, net, net_error, mean, ratio, spread, error), strict=True):
            found[part].append(value)
        progress("methods", k + 1, len(METHODS))
    reports = []
    for name, (own, kernel) in {**methods(config), "lengths": over_lengths()}.items():
        if not name.startswith("MMLT"):  # which `mmlt_marginals` verifies
            reports.append(verify(kernel, own, seed=seed, replicas=config.replicas, name=name))
            progress("verification", len(reports), 3)
    apart = lengths(jax.random.fold_in(jax.random.key(seed), 9), edges, config.work, config.repeats)
    progress("lengths", 1, 2)
    normalisers = mmlt_usage_lengths.normalisers(jax.random.fold_in(jax.random.key(seed), 10), edges, config.repeats)
    progress("lengths", 2, 2)
    return xr.Dataset(
        {
            "masses": ("bin", masses),
            "contribution": ("technique", joint.sum(1)),
            "usage": ("technique", usage),
            "usage_error": ("technique", usage_error),
            "scale": ("way", found["scale"]),
            "net": (("way", "bin"), np.stack(found["net"])),
            "net_error": (("way", "bin"), np.stack(found["net_error"])),
            "mean": (("way", "bin"), np.stack(found["mean"])),
            "ratio": ("way", found["ratio"]),
            "ratio_error": ("way", found["spread"]),
            "error": (("way", "repeat"), np.stack(found["error"])),
            "verdict": ("verified", [report.verdict.value for report in reports]),
            "p": ("verified", [report.p_value for report in reports]),
            "gap": ("verified", [report.gap for report in reports]),
            "ring": ("combine", [_on_a_ring(combine) for combine in ("sum", "maximum")]),
            **apart,
            **normalisers,
        },
        {
            "bin": (edges[1:] + edges[:-1]) / 2,
            "technique": list(NAMES),
            "way": list(METHODS),
            "verified": [*METHODS[2:], "lengths"],
            "samples": list(CHECKPOINTS),
            "estimate": ["at the start", "progressively"],
        },
    )


def _on_a_ring(combine: Any) -> float:
    """By how much the enumerated deposits of PSSMLT miss f on a ring of five, two techniques and unequal weights."""
    f = np.array([1, 3, 0.5, 2, 4.0])
    first = np.array([0.2, 0.2, 0.2, 0.8, 0.8])
    weights = Weighting(lambda x, p: jnp.stack([0.2 + 0.6 * (x > 0.6), 0.8 - 0.6 * (x > 0.6)]))
    target = pooled(Multiplexed(Tabulated(f), (Uniform(), Shift()), weights), combine)
    found = enumerate_kernel(PooledDeposit(RingStep(5, {1: 0.75, -1: 0.25})), target, ring(np.ones(5))[1], inner=8)
    parts = first * f, np.roll((1 - first) * f, -2)
    scale = np.mean(np.sum(parts, axis=0) if combine == "sum" else np.max(parts, axis=0))
    return float(np.abs(scale * (found.law @ found.deposits) - f / 5).max())


def _effective(config: Config, target: Multiplexed, kernel: Kernel, key: jax.Array) -> tuple[float, float]:
    """The share of the samples made for proposals that contribute, from exact starts; and its standard error."""
    first, second = jax.random.split(key)
    states = mcmc1d.exact_start(first, target, config.proposals)
    w = jax.random.uniform(second, (config.proposals, kernel.dim_w(target) - 1))
    lit = np.asarray(_lit(kernel.move, target, states, w), np.float64)  # pyright: ignore[reportAttributeAccessIssue]
    return float(lit.mean()), float(lit.std() / np.sqrt(len(lit)))


@eqx.filter_jit
def _lit(move: Move, target: Multiplexed, states: State, w: jax.Array) -> jax.Array:
    def one(state: State, w: jax.Array) -> jax.Array:
        there = move.propose(target, state, w).state
        if isinstance(target.target, Pooled):
            return (target.target.contributions(there.u)[1] > -jnp.inf).mean()
        return (target.evaluate(State(there.index, there.u)).seen.log_c > -jnp.inf).astype(w.dtype)

    return jax.vmap(one)(states, w)


def draw(data: xr.Dataset) -> Figure:
    """Samples by technique against contributions, effective path ratio, and b_k at the start or progressively."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7.0, 2.1), width_ratios=(4, 3, 3))
    place = np.arange(len(NAMES))
    left.bar(place - 0.27, data.contribution, 0.25, color="0.6", label="contribution")
    left.bar(place, data.usage, 0.25, color="C0", label="samples, MMLT")
    left.bar(place + 0.27, np.full(len(NAMES), 1 / len(NAMES)), 0.25, color="C1", label="samples, PSSMLT")
    left.set_xticks(place, NAMES)
    left.set(xlabel="technique", ylabel="share", ylim=(0, 1.45 * float(max(data.usage.max(), 0.25))))
    left.legend(loc="upper right")
    middle.bar(np.arange(4), 100 * data.ratio, 0.6, color=("C0", "C5", "C1", "C4"))
    for k, ratio in enumerate(data.ratio.to_numpy()):
        middle.annotate(f"{ratio:.1%}", (k, 100 * ratio), ha="center", va="bottom", fontsize=6)
    middle.set_xticks(np.arange(4), ["MMLT", "MMLT\nany index", "PSSMLT\nsum", "PSSMLT\nmax"], fontsize=6)
    middle.set(ylabel="effective path ratio (%)", ylim=(0, 118 * float(data.ratio.max())))
    error = np.exp(np.log(data.image_error).mean("repeat"))
    for name, mark in (("at the start", "s--"), ("progressively", "o-")):
        right.plot(data.samples, 100 * error.sel(estimate=name), mark, markersize=3, label=name)
    right.set(xscale="log", yscale="log", xlabel="steps of each length", ylabel="RMS error of the image (%)")
    right.set_yticks([2, 5, 10, 20, 50], ["2", "5", "10", "20", "50"])
    right.set_ylim(60 * float(error.min()), 160 * float(error.max()))
    right.minorticks_off()
    right.legend(title="$b_k$ estimated", title_fontsize=6, loc="lower left")
    return figure


def table(data: xr.Dataset) -> Table:
    """The methods: effective path ratio, and error at equal work."""
    result = Table("way", "scale", "effective paths", "RMS error", "s.e.", title="mmlt_usage", box=SIMPLE, padding=0)
    for name in data.way.to_numpy():
        here = data.sel(way=name)
        error = here.error.to_numpy()
        cells = f"{float(here.scale):.4f}", f"{float(here.ratio):.2%}", f"{error.mean():.5f}", f"{sem(error):.5f}"
        result.add_row(str(name), *cells)
    return result


def _verified(data: xr.Dataset, name: str) -> tuple[bool | None, str, str]:
    """Whether a verification passed, what it said, and what it was held to."""
    here = data.sel(verified=name)
    said = str(here.verdict.to_numpy())
    return passes([said]), f"verify {said}, p {float(here.p):.2g}", detects(here.gap)


def judge(data: xr.Dataset) -> list[Claim]:
    """Usage follows contribution; PSSMLT is right with the right constant; lengths apart or together."""
    b, masses = float(data.masses.sum()), data.masses.to_numpy()
    z = float(np.max(np.abs(data.usage - data.contribution) / data.usage_error))
    uneven = float(np.abs(data.contribution - 1 / len(NAMES)).max())
    claims = [
        Claim(
            "mmlt.usage",
            "MMLT's samples per technique are proportional to the technique's contribution",
            f"{SOURCE}, fig. 5",
            verdict(z < 6),
            "holds",
            f"{z:.1f} standard errors at most, shares {', '.join(f'{float(s):.3f}' for s in data.usage)}; PSSMLT's "
            f"equal shares are off by up to {uneven:.3f}",
            f"6 s.e. of 16 blocks; sees a share off by {6 * float(data.usage_error.max()):.4f}",
        )
    ]
    for name, combine in zip(METHODS[2:], ("sum", "maximum"), strict=True):
        here = data.sel(way=name)
        scaled = float(here.scale) * here.net.to_numpy()
        lit = here.net_error.to_numpy() > 0
        off = float(np.max(np.abs(scaled - masses)[lit] / (float(here.scale) * here.net_error.to_numpy()[lit])))
        simulated = float(np.abs(float(here.scale) * here["mean"].to_numpy() - masses).sum() / 2 / b)
        enumerated = float(data.ring[("sum", "maximum").index(combine)])
        passed, verified, held = _verified(data, name)
        claims.append(
            Claim(
                f"pssmlt.{combine}",
                f"PSSMLT with the {combine} of all contributions samples f when each of them is deposited",
                f"{SOURCE}, Alg. 1",
                verdict(off < 6, enumerated < 1e-12, passed),
                "holds",
                f"enumerated on a ring to {enumerated:.0e}; on the line {off:.1f} standard errors of a net, simulated "
                f"TV {simulated:.1e}; deposits: {verified}",
                f"1e-12; 6 s.e., a bin off by {6 * float(here.net_error.max()):.1e}; {held}",
            )
        )
    excess = b / float(data.scale.sel(way=METHODS[3])) - 1
    claims.append(
        Claim(
            "pssmlt.maximum-scale",
            "With the maximum, deposits are multiplied by b, the integral of f, as with the sum",
            f"ours; {SOURCE}, Alg. 1",
            verdict(abs(excess) < 1e-9),
            "fails",
            f"{excess:+.1%}: the integral of the maximum is what multiplies",
            "quadrature, 1e-9",
        )
    )
    ratio = {str(m): float(data.ratio.sel(way=m)) for m in data.way.to_numpy()}
    apart = ratio[METHODS[0]] - max(ratio[m] for m in METHODS[2:])
    noise = float(np.sqrt((data.ratio_error**2).sum()))
    afresh = ratio[METHODS[1]] - ratio[METHODS[2]]
    found = "holds" if afresh > apart / 2 else "holds if the index moves in small steps too"
    claims.append(
        Claim(
            "mmlt.effective-paths",
            "MMLT's effective path ratio is higher than PSSMLT's",
            f"{SOURCE}, sec. 5 (29.75 % against 11.81 %)",
            found if apart > 6 * noise else "fails",
            # Drawn afresh, the index of a small step is any technique at nearly the same u, as all of PSSMLT's are.
            "holds if the index moves in small steps too",
            ", ".join(f"{m} {r:.2%}" for m, r in ratio.items()),
            f"6 s.e., {6 * noise:.2%}",
        )
    )
    return [*claims, *mmlt_usage_lengths.claims(data, *_verified(data, "lengths"))]
