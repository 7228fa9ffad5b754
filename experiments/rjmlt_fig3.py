"""Bitterli et al. 2017, section 7.1 and figure 3: five integrators on the line, two of them wrong.

The jumps of "full, aimed" have T(i, j) = w_j and are always accepted: the paper's method (section 4). Those of "full",
"no Jacobian" and "fixed point" go to each technique alike, T(i, j) = 1 / n, and may be rejected: eqs. 14 and 19 leave T
free, and section 7.1 does not say which its figure 3 has.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.each_chain import EachMean, autocorrelation_time
from experiments.support.framework import Claim
from experiments.support.long import long_run
from experiments.support.sweep import Sweep
from mcmc1d.checks import require, require_whole
from mcmc1d.compiling import quickly
from mcmc1d.moves import AimedJump, Mixture, Move, ReversibleJump, SmallStep, TechniqueChange
from mcmc1d.techniques import Mixture as MixtureTechnique
from mcmc1d.techniques import PiecewiseConstant, RaisedSinusoid, Ramp, Tent
from mcmc1d.verify.goodness import cdf_gap, p_value, smallest_gap, total_variation
from mcmc1d.verify.mutants.jumps import no_jacobian
from mcmc1d.verify.mutants.mixtures import FixedPointInverse
from mcmc1d.verify.operator import transition_operator

SOURCE = "Bitterli et al. 2017"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers; those of the paper where it gives them, else ours."""

    amplitude: float = 0.9
    """Of the target 1 + amplitude sin(4 pi x)."""
    sigma: float = 0.05
    """Standard deviation of the small step; there is no large step, which would mask a wrong jump."""
    jump: float = 0.5
    """Probability that a step is a technique change or a jump."""
    bins: int = 50
    replicas: int = 2**17
    """Independent chains whose last states are tested, each started exactly from the target."""
    replica_steps: int = 128
    chains: int = 2**14
    """Chains of the histograms, which go on from the replicas' last states."""
    steps: int = 1024
    burn: int = 1024
    """Steps of a wrong integrator's chains before that; the slowest forgets its start in 126, by its spectral gap."""
    blocks: int = 32
    """Independent groups of chains: the standard errors are their spread. Replicas come in groups as large."""
    level: float = 1e-6
    """Probability that a right integrator is rejected by one test; there are two an integrator."""
    operator_points: int = 2**19
    """Points of the net that predicts a wrong integrator's law, a technique."""
    agreement: float = 1e-3
    """Total variation up to which prediction and simulation agree, beyond the simulation's own noise."""


PROFILES = {
    "quick": Config(),
    "paper": Config(replicas=2**20, replica_steps=256, chains=2**16, steps=8192, operator_points=2**20),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

TECHNIQUES = ("tent", "step", "mixture")
KINDS = ("small step", "jump")
RIGHT = {"multiplexed": True, "no Jacobian": False, "fixed point": False, "full": True, "full, aimed": True}

_MIXTURE = MixtureTechnique((RaisedSinusoid(0.9), Ramp(2.0)), (0.3, 0.7))


def integrator(config: Config, name: str) -> tuple[mcmc1d.Multiplexed, Move]:
    """Its density and move; the wrong ones are mutants of the right one's parts."""
    jumps: dict[str, Move] = {
        "multiplexed": TechniqueChange(),
        "no Jacobian": no_jacobian(ReversibleJump()),
        "fixed point": ReversibleJump(),
        "full": ReversibleJump(),
        "full, aimed": AimedJump(),
    }
    small, jump = (1 - config.jump, SmallStep(config.sigma)), (config.jump, jumps[name])
    mixture = FixedPointInverse(_MIXTURE) if name == "fixed point" else _MIXTURE
    sinusoid = mcmc1d.targets.Sinusoid(config.amplitude, 2.0)
    target = mcmc1d.Multiplexed(sinusoid, (Tent(), PiecewiseConstant([0, 0.5, 1], [1.6, 0.4]), mixture))
    return target, Mixture(dict(zip(KINDS, (small, jump), strict=True)))


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Every integrator: replicas tested after `replica_steps`, then histograms, acceptance and autocorrelation."""
    blocks, chains = require_whole(config.blocks, "blocks", 2), require_whole(config.chains, "chains")
    require(chains % blocks == 0, f"{chains} chains can not be dealt into {blocks} equal blocks")
    require(
        config.replicas >= chains and config.replicas % (chains // blocks) == 0,
        f"replicas must be {chains} at least, as many as the chains that go on from them, and a multiple of "
        f"{chains // blocks}, a block's chains, not {config.replicas}",
    )
    edges = np.linspace(0, 1, config.bins + 1)
    # The longest first, so that several processes end together: the wrong have their operators, step changes are cheap.
    order = sorted(RIGHT, key=lambda name: (RIGHT[name], name == "multiplexed"))
    points = [(dataclasses.asdict(config), seed, name) for name in order]
    results = [xr.Dataset.from_dict(found) for found in progress.map("integrators", measure, points)]
    data = xr.concat(results, "integrator").assign_coords(integrator=order).sel(integrator=list(RIGHT))
    return data.assign(
        exact=(("technique", "bin"), integrator(config, "full")[0].joint_masses(edges)),
        right=("integrator", list(RIGHT.values())),
        detectable_gap=smallest_gap(config.replicas, config.level),
        level=config.level,
        agreement=config.agreement,
        replica_steps=config.replica_steps,
    ).assign_coords(technique=list(TECHNIQUES), kind=list(KINDS), bin=(edges[1:] + edges[:-1]) / 2)


def measure(fields: dict[str, Any], seed: int, name: str) -> dict[str, Any]:
    """One integrator's results, as `xarray.Dataset.to_dict` has them."""
    config = Config(**fields)
    target, move = integrator(config, name)
    key = jax.random.fold_in(jax.random.key(seed), list(RIGHT).index(name))
    first, second, third = jax.random.split(key, 3)
    edges = np.linspace(0, 1, config.bins + 1)
    exact = target.joint_masses(edges)  # the same for all: a wrong inverse changes neither f nor the densities

    # Blocks of one size and the same estimators, read or not: one program serves all three runs.
    size = config.chains // config.blocks
    asked = {
        "joint": mcmc1d.Histogram(config.bins, joint=True),
        "acceptance": mcmc1d.Acceptance(),
        "mean": EachMean(size),
    }

    def chains(stage: str, key: Any, count: int, steps: int, start: mcmc1d.State | None = None) -> mcmc1d.Run:
        sizes: dict[str, Any] = {"steps": steps, "chains": count, "blocks": count // size}
        return long_run(f"{name}: {stage}", key, move, target, estimators=asked, start=start, **sizes)

    # Independent chains, exact starts: a p-value without burn-in and without autocorrelation.
    replicas = chains("replicas", first, config.replicas, config.replica_steps)
    x = np.asarray(_samples(target, replicas.state))
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, config.bins - 1)
    counts = np.zeros(exact.shape)
    np.add.at(counts, (np.asarray(replicas.state.index), bins), 1)

    # The histograms go on from there, and a wrong integrator's from where it has left the target's law behind.
    start = jax.tree.map(lambda leaf: leaf[: config.chains], replicas.state)
    if not RIGHT[name] and config.burn > 0:
        start = chains("burn-in", third, config.chains, config.burn, start).state
    long = chains("histograms", second, config.chains, config.steps, start)
    joint = long.mean("joint")
    per_block = long.sums["joint"].sum(1) * config.blocks / (config.chains * config.steps)
    acceptance = long.acceptance()

    # What a wrong integrator's law must be, from its transition operator; a right one's is the exact law.
    predicted, noise = np.full(exact.shape, np.nan), np.nan
    if not RIGHT[name]:
        law = transition_operator(move, target, points=config.operator_points).law_of(edges)
        predicted = law.masses
        noise = _noise(long.sums["joint"] * config.blocks / (config.chains * config.steps))
    found = xr.Dataset(
        {
            "joint": (("technique", "bin"), joint),
            "error_x": ("bin", per_block.std(0, ddof=1) / np.sqrt(config.blocks)),
            "error_joint": (("technique", "bin"), long.standard_error("joint")),
            "predicted": (("technique", "bin"), predicted),
            "prediction_distance": total_variation(joint, predicted),
            "prediction_noise": noise,
            "total_variation_x": total_variation(joint.sum(0), exact.sum(0)),
            "total_variation": total_variation(joint, exact),
            "p_x": p_value(counts.sum(0), exact.sum(0)),
            "p_joint": p_value(counts, exact),
            "gap": max(cdf_gap(counts.sum(0), exact.sum(0)), cdf_gap(counts, exact)),
            "acceptance": ("kind", [acceptance[kind] for kind in KINDS]),
            "autocorrelation_time": autocorrelation_time(long.sums["mean"], config.steps),
        }
    )
    return found.to_dict()


@quickly
def _samples(target: mcmc1d.Multiplexed, states: mcmc1d.State) -> jax.Array:
    """The x of each state."""
    return jax.vmap(target.evaluate)(states).seen.x


def _noise(blocks: np.ndarray, level: float = 1e-3) -> float:
    """The total variation that the mean of independent blocks of a histogram exceeds, by chance, with that probability.

    By random combinations of the blocks' deviations (a multiplier bootstrap), which keep how the bins hang together.
    """
    n = len(blocks)
    deviations = (blocks - blocks.mean(0)).reshape(n, -1)
    factors = np.random.default_rng(0).standard_normal((20_000, n)) / np.sqrt(n * (n - 1))
    return float(np.quantile(np.abs(factors @ deviations).sum(1) / 2, 1 - level))


def draw(data: xr.Dataset) -> Figure:
    """The paper's two rows and a third: state histogram, technique shares, error in standard errors."""
    figure, axes = plt.subplots(
        3,
        data.sizes["integrator"],
        figsize=(3.5, 3.0),
        sharex=True,
        sharey="row",
        gridspec_kw={"height_ratios": (3, 3, 2)},
    )
    x, width = data.bin.to_numpy(), 1 / data.sizes["bin"]
    exact = data.exact.to_numpy()
    operator: dict[str, Any] = {"color": "C3", "linewidth": 0.8, "linestyle": (0, (3, 1))}
    for k, (name, column) in enumerate(zip(data.integrator.to_numpy(), axes.T, strict=True)):
        here = data.isel(integrator=k)
        joint, right = here.joint.to_numpy(), bool(here.right)
        title = f"({'abcde'[k]})\n{name}\n{'right' if right else 'wrong'}"
        column[0].set_title(title, color="black" if right else "C1", fontsize=6)
        column[0].bar(x, joint.sum(0) / width, width, color="C0" if right else "C1", alpha=0.5, linewidth=0)
        column[0].plot(x, exact.sum(0) / width, color="black", linewidth=0.8)
        for t, technique in enumerate(TECHNIQUES):
            column[1].plot(x, joint[t] / joint.sum(0), color=f"C{(0, 4, 2)[t]}", label=technique, linewidth=1.0)
            column[1].plot(x, exact[t] / exact.sum(0), color="black", linewidth=0.6, linestyle=(0, (2, 1.5)))
        if not right:
            law = here.predicted.to_numpy()
            column[0].plot(x, law.sum(0) / width, **operator)
            column[1].plot(x, (law / law.sum(0)).T, **operator)
        column[2].axhspan(-3, 3, color="0.9", linewidth=0)
        z = (joint.sum(0) - exact.sum(0)) / here.error_x.to_numpy()
        column[2].plot(x, z, ".", markersize=2, color="C0" if right else "C1")
        column[2].set_yscale("symlog", linthresh=5, linscale=1.5)
        column[2].set_xticks([0, 0.5, 1], ["0", "½", "1"])
        column[2].set_xlabel("x")
    axes[0, 0].set_ylabel("density")
    axes[1, 0].set_ylabel("share")
    axes[2, 0].set_ylabel("error / s.e.")
    axes[1, 0].set_ylim(0, 1)
    axes[2, 0].set_yticks([-50, -3, 3, 50], ["−50", "−3", "3", "50"])
    axes[2, 0].minorticks_off()
    figure.align_ylabels()
    handles, labels = axes[1, 0].get_legend_handles_labels()
    handles.append(Line2D([], [], color="black", linewidth=0.8, linestyle=(0, (2, 1.5))))
    handles.append(Line2D([], [], **operator))
    figure.legend(handles, [*labels, "exact", "operator"], loc="outside lower center", ncols=5)
    return figure


def table(data: xr.Dataset) -> Table:
    """Each integrator's distance from the exact law and its operator's, p-values, acceptance, autocorrelation time."""
    columns = ("integrator", "TV x", "TV i,x", "operator", "p x", "p i,x", "small", "jump", "IAT", "")
    result = Table(
        *columns, title="rjmlt_fig3: distances, p-values, acceptance, autocorrelation", box=SIMPLE, padding=0
    )
    for k, name in enumerate(data.integrator.to_numpy()):
        here = data.isel(integrator=k)
        result.add_row(
            str(name),
            f"{float(here.total_variation_x):.4f}",
            f"{float(here.total_variation):.4f}",
            "-" if here.right else f"{float(here.prediction_distance):.4f}",
            f"{float(here.p_x):.1g}",
            f"{float(here.p_joint):.1g}",
            *(f"{float(rate):.3f}" for rate in here.acceptance),
            f"{float(here.autocorrelation_time):.0f}",
            "accepted" if _accepted(here) else "rejected",
        )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """The right integrators must be accepted and the wrong ones rejected."""
    gap = float(data.detectable_gap)
    steps = int(data.replica_steps)
    held = (
        f"level {float(data.level):.0e} a test; detects, with probability 0.99, a CDF gap of {gap:.4f} on the bins in "
        f"the law after {steps} steps (pi P^{steps}); for a right integrator holds means: not rejected"
    )
    statements = {
        "multiplexed": ("Multiplexed MLT samples f and uses each technique by its MIS weight", "sec. 7.1, fig. 3a"),
        "no Jacobian": ("A reversible jump without its Jacobian has a wrong law", "sec. 7.1, fig. 3b"),
        "fixed point": ("An inverse that returns a fixed point of an interval has a wrong law", "sec. 7.1, fig. 3c"),
        "full": ("Reversible jumps with Jacobian and parametrised inverses keep the law", "eq. 19, fig. 3d"),
        "full, aimed": ("A jump aimed by the MIS weights keeps the law", "sec. 4, eq. 14"),
    }
    claims = []
    for k, (name, (statement, where)) in enumerate(statements.items()):
        here = data.isel(integrator=k)
        number = f"TV {float(here.total_variation):.4f}, p {min(float(here.p_x), float(here.p_joint)):.2g}"
        verdict = "holds" if _accepted(here) == RIGHT[name] else "fails"
        claim = f"rjmlt.{name.replace(', ', '-').replace(' ', '-').lower()}"
        claims.append(Claim(claim, statement, f"{SOURCE}, {where}", verdict, "holds", number, held))
    for name in (name for name, right in RIGHT.items() if not right):
        here = data.sel(integrator=name)
        distance, noise, agreement = (
            float(value) for value in (here.prediction_distance, here.prediction_noise, data.agreement)
        )
        claims.append(
            Claim(
                f"rjmlt.operator-{name.replace(' ', '-').lower()}",
                f"The transition operator predicts the wrong law of the integrator: {name}",
                f"ours; {SOURCE}, fig. 3",
                "holds" if distance <= agreement + noise else "fails",
                "holds",
                f"TV {distance:.4f} between predicted and simulated",
                f"TV {agreement:.0e} beyond {noise:.4f}, which the simulation's noise exceeds with probability 1e-3",
            )
        )
    rate = float(data.acceptance.sel(integrator="full, aimed", kind=KINDS[1]))
    claims.append(
        Claim(
            "rjmlt.aimed-accepts",
            "A jump aimed by the MIS weights is always accepted",
            f"{SOURCE}, sec. 4, eq. 14",
            "holds" if rate > 1 - 1e-5 else "fails",
            "holds",
            f"acceptance rate {rate:.7f}",
            "1e-5, the rounding of float32",
        )
    )
    return claims


def _accepted(here: xr.Dataset) -> bool:
    return min(float(here.p_x), float(here.p_joint)) >= float(here.level)
