"""Serial tempering with any pseudo-prior and replica exchange: both keep the law of beta = 1, and cross barriers."""

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
from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, passes, verdict
from mcmc1d import tempering
from mcmc1d.metropolis import Cycle, Deposits, Kernel, Metropolis, Step
from mcmc1d.moves import Mixture, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.moves.exchange import CoordinateStep, Exchange
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import GaussianMixture, Sinusoid
from mcmc1d.types import Array, Float
from mcmc1d.verify import enumerate_kernel, ring, transition_operator, verify
from mcmc1d.verify.finite import RingStep
from mcmc1d.verify.goodness import total_variation


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    bins: int = 32
    points: int = 2**16
    """Of the operators' nets, for each index."""
    replicas: int = 2**14
    """Of each verification."""
    steps: int = 2**13
    """Of the compared chains, counted together where there are several."""
    repeats: int = 512
    """Independent repetitions of each."""
    sigma: float = 0.05
    tolerance: float = 4e-3
    """Total variation between an operator's law and the exact one."""


PROFILES = {"quick": Config(), "paper": Config(points=2**19, replicas=2**18, steps=2**15, repeats=2048)}

GENTLE = Sinusoid(0.9, 1.5, 0.1, 2.0)
"""Where laws are tested."""
BETAS = (1.0, 0.4, 0.0)
PRIORS = {"even": None, "flat": (0.0, 0.0, 0.0), "lopsided": (-2.0, 1.0, 0.5)}
TWO = GaussianMixture([0.25, 0.75], [0.04, 0.03], [0.4, 0.6])
"""Two modes, with a barrier that a small step does not cross: where methods are compared."""
LADDER = (1.0, 0.3, 0.1, 0.02)
NEIGHBOURS = [[0.5, 0.5, 0, 0], [0.5, 0, 0.5, 0], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5]]
METHODS = ("one chain", "parallel chains", "serial tempering", "replica exchange")
RIGHT_MODE = 0.5


class AlwaysSwap(Kernel):
    """The mistake: two replicas swap whatever their temperatures."""

    @property
    def kinds(self) -> tuple[str, ...]:
        return ("AlwaysSwap",)

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def check(self, target: Multiplexed) -> None:
        pass

    def step(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Step:
        right = Metropolis(Exchange(), "plain").step(target, state, jnp.concatenate([w, w]))
        after = target.evaluate(State(state.index, state.u[::-1]))
        deposits = Deposits(after.seen.x[None], right.deposits.index, right.deposits.weight)
        return Step(after, deposits, right.info)


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The laws of ladders and of replicas, and the error of four methods against their steps."""
    edges = np.linspace(0, 1, config.bins + 1)
    masses = GENTLE.bin_masses(edges)
    exact = masses / masses.sum()
    step = StepAndChange(SmallStep(0.2))
    rows, rungs, reports, quadrature = [], [], {}, []
    for k, (name, prior) in enumerate(PRIORS.items()):
        target = tempering.ladder(GENTLE, BETAS, log_prior=prior)
        law = transition_operator(step, target, points=config.points).law_of(edges).masses
        joint = target.joint_masses(edges)
        rows.append(law[0] / law[0].sum())
        quadrature.append(total_variation(joint[0] / joint[0].sum(), exact))
        rungs.append(joint.sum(1))
        reports[name] = verify(step, target, seed=seed, replicas=config.replicas, name=f"ladder, {name}")
        progress("ladders", k + 1, len(PRIORS))

    swap = Mixture({"step": (0.7, CoordinateStep(0.2)), "swap": (0.3, Exchange())})
    pair = tempering.replicas(GENTLE, (1.0, 0.2))
    reports["replicas"] = verify(swap, pair, seed=seed, replicas=config.replicas, name="replicas")
    wrong = Cycle([swap, AlwaysSwap()])
    exchanged = [_first(kernel, pair, edges, config.points) for kernel in (swap, wrong)]
    progress("replicas", 1, 1)

    curves = []
    for k, method in enumerate(METHODS):
        curves.append(_errors(config, method, jax.random.fold_in(jax.random.key(seed), k)))
        progress("error against steps", k + 1, len(METHODS))
    return xr.Dataset(
        {
            "exact": ("bin", exact),
            "row": (("prior", "bin"), np.stack(rows)),
            "quadrature": ("prior", quadrature),
            "rungs": (("prior", "rung"), np.stack(rungs)),
            "exchanged": (("swap", "bin"), np.stack(exchanged)),
            "ring": _on_a_ring(),
            "error": (("way", "step"), np.stack(curves)),
            "mass": _right_mass(),
            "verdict": ("verified", [report.verdict.value for report in reports.values()]),
            "p": ("verified", [report.p_value for report in reports.values()]),
            "gap": ("verified", [report.gap for report in reports.values()]),
            "tolerance": config.tolerance,
            "repeats": config.repeats,
        },
        {
            "bin": (edges[1:] + edges[:-1]) / 2,
            "prior": list(PRIORS),
            "rung": list(BETAS),
            "swap": ["by the ratio", "always"],
            "way": list(METHODS),
            "step": _marks(config),
            "verified": list(reports),
        },
    )


def _first(kernel: Kernel | Mixture, target: Multiplexed, edges: np.ndarray, points: int) -> np.ndarray:
    """The law of the first coordinate that a kernel on two replicas keeps."""
    return transition_operator(kernel, target, points=points).law_of(edges, lambda x: x[..., 0]).masses[0]


def _on_a_ring() -> float:
    """The residual of steps and rung changes on four states and two rungs, enumerated."""
    f = np.array([1, 3, 0.5, 2])
    _, states = ring(f, (mcmc1d.techniques.Uniform(),) * 2)
    target = tempering.ladder(mcmc1d.targets.Tabulated(f), (1.0, 0.4), log_prior=(0.3, -0.2))
    kernel = Cycle([RingStep(4, {1: 0.5, -1: 0.25, 2: 0.25}), TechniqueChange([[0.2, 0.8], [0.5, 0.5]])])
    return enumerate_kernel(kernel, target, states, inner=8).residual


def _right_mass() -> float:
    masses = TWO.bin_masses(np.array([0, RIGHT_MODE, 1]))
    return float(masses[1] / masses.sum())


def _marks(config: Config) -> np.ndarray:
    """After how many steps the error is taken."""
    return 2 ** np.arange(6, int(np.log2(config.steps)) + 1)


def _errors(config: Config, method: str, key: jax.Array) -> np.ndarray:
    """The RMS error of the right mode's mass, from starts that are all in the left mode, against the steps."""
    n, repeats = len(LADDER), config.repeats
    count, steps = (n * repeats, config.steps // n) if method == "parallel chains" else (repeats, config.steps)
    small = SmallStep(config.sigma)
    left, index = np.full((count, 1), 0.25, np.float32), np.zeros(count, np.int32)
    if method == "serial tempering":
        target = tempering.ladder(TWO, LADDER)
        move = Mixture({"step": (0.7, small), "change": (0.3, TechniqueChange(NEIGHBOURS))})
    elif method == "replica exchange":
        target, left = tempering.replicas(TWO, LADDER), np.full((count, n), 0.25, np.float32)
        move = Mixture({"step": (0.7, CoordinateStep(config.sigma)), "swap": (0.3, Exchange())})
    else:
        target, move = Multiplexed(TWO, mcmc1d.techniques.Uniform()), small
    start = State(jnp.asarray(index), jnp.asarray(left))
    found = mcmc1d.trace(key, move, target, steps=steps, chains=count, start=start)
    counted = (found.index == 0).astype(float) if method == "serial tempering" else np.ones(found.index.shape)
    x = found.x if found.x.shape[1] == count else np.moveaxis(found.x, -1, 1)
    right = ((x[..., 0] if method == "replica exchange" else x) > RIGHT_MODE) * counted
    if method == "parallel chains":
        right, counted = (part.reshape(steps, repeats, n).sum(2) for part in (right, counted))
    sums, weights = (np.cumsum(part, axis=0) for part in (right, counted))
    each = n if method == "parallel chains" else 1
    at = [mark // each - 1 for mark in _marks(config)]
    # A chain that has not been on the rung yet has seen the left mode only.
    estimates = np.divide(sums[at], weights[at], out=np.zeros((len(at), repeats)), where=weights[at] > 0)
    return np.sqrt(np.mean((estimates - _right_mass()) ** 2, axis=1))


def draw(data: xr.Dataset) -> Figure:
    """The law of beta = 1 under three priors, time on the rungs, and the error of four methods."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(7.0, 2.2), width_ratios=(3, 2, 3))
    x, width = data.bin.to_numpy(), 1 / data.sizes["bin"]
    left.plot(x, data.exact / width, color="black", linewidth=0.8, label="f / b")
    for k, prior in enumerate(data.prior.to_numpy()):
        row = data.row.sel(prior=prior).to_numpy() / width
        left.plot(
            x, row, "ox+"[k], color=f"C{(0, 4, 2)[k]}", markersize=3, markerfacecolor="none", label=f"{prior} prior"
        )
    left.plot(x, data.exchanged.sel(swap="always") / width, color="C1", linestyle=(0, (3, 1)), label="swaps always")
    left.set(xlabel="x", ylabel="density at beta = 1")
    left.set_ylim(0, float(data.exact.max()) / width * 1.75)
    left.legend(ncols=2, loc="upper center")
    place = np.arange(len(BETAS))
    for k, prior in enumerate(data.prior.to_numpy()):
        middle.bar(place + 0.27 * (k - 1), data.rungs.sel(prior=prior), 0.25, color=f"C{(0, 4, 2)[k]}", label=prior)
    middle.set_xticks(place, [f"{beta:g}" for beta in BETAS])
    middle.set(xlabel="rung, beta", ylabel="share of the steps", ylim=(0, 1.05))
    middle.legend(title="prior", title_fontsize=6)
    for k, method in enumerate(data.way.to_numpy()):
        right.plot(
            data.step,
            data.error.sel(way=method),
            "os^v"[k] + "-",
            color=f"C{(6, 1, 0, 2)[k]}",
            markersize=5.5 if method == "one chain" else 3,  # under the next one, which errs alike
            markerfacecolor="none" if method == "one chain" else None,
            label=method,
        )
    right.set(xscale="log", yscale="log", xlabel="steps, of all chains together", ylabel="RMS error of a mode's mass")
    right.set_yticks([0.1, 0.2, 0.4, 0.6], ["0.1", "0.2", "0.4", "0.6"])
    right.set_ylim(0.05, 0.7)
    right.minorticks_off()
    right.legend(loc="lower left")
    return figure


def table(data: xr.Dataset) -> Table:
    """The error of each method against its steps."""
    result = Table(
        "method", *(f"{int(step)}" for step in data.step), title="tempering: RMS error", box=SIMPLE, padding=0
    )
    for method in data.way.to_numpy():
        result.add_row(str(method), *(f"{float(error):.3f}" for error in data.error.sel(way=method)))
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Laws are right whatever the prior; swaps need their ratio; tempering crosses where small steps do not."""
    tolerance, exact = float(data.tolerance), data.exact.to_numpy()
    operators = max(total_variation(row, exact) for row in data.row.to_numpy())
    ladders = data.sel(verified=list(PRIORS))
    shares = data.rungs.sel(rung=1.0).to_numpy()
    even = float(np.abs(data.rungs.sel(prior="even") - 1 / len(BETAS)).max())
    right, wrong = (total_variation(data.exchanged.sel(swap=s).to_numpy(), exact) for s in ("by the ratio", "always"))
    replicas = data.sel(verified="replicas")
    last = {str(method): float(data.error.sel(way=method)[-1]) for method in data.way.to_numpy()}
    best = min(last["one chain"], last["parallel chains"])
    worst = max(last["serial tempering"], last["replica exchange"])
    ok = float(data.quadrature.max()) < 1e-9 and operators < tolerance

    def held(here: xr.Dataset) -> str:
        return detects(here.gap)

    return [
        Claim(
            "tempering.any-prior",
            "Serial tempering samples f / b on the rung of temperature 1 with any pseudo-prior",
            "Marinari, Parisi 1992; Hachisuka et al. 2014, eq. 14",
            verdict(ok, float(data.ring) < 1e-12, passes(ladders.verdict.to_numpy())),
            "holds",
            f"quadrature {float(data.quadrature.max()):.0e}; operators' TV {operators:.1e}; "
            f"ring {float(data.ring):.0e}; verify p {float(ladders.p.min()):.2g}",
            f"three priors; 1e-9; TV {tolerance:.0e}; 1e-12; {held(ladders)}",
        ),
        Claim(
            "tempering.even-prior",
            "The pseudo-prior 1 / Z_beta makes every rung equally likely; another moves the time between rungs only",
            "Geyer, Thompson 1995, sec. 2.2",
            verdict(even < 1e-9),
            "holds",
            f"even to {even:.0e}; temperature 1 has {shares[0]:.0%}, {shares[1]:.0%} flat, {shares[2]:.0%} lopsided",
            "quadrature, 1e-9",
        ),
        Claim(
            "tempering.replica-exchange",
            "Replica exchange keeps the product law, and f / b at temperature 1",
            "Geyer 1991; Swendsen, Wang 1986",
            verdict(right < tolerance, passes([replicas.verdict.item()])),
            "holds",
            f"operator's TV {right:.1e}; verify p {float(replicas.p):.2g}",
            f"TV {tolerance:.0e}; {held(replicas)}",
        ),
        Claim(
            "tempering.swap-always",
            "Replicas may swap without looking at their temperatures",
            "ours; Geyer 1991",
            verdict(wrong < tolerance),
            "fails",
            f"x at temperature 1 off by TV {wrong:.3f}",
            f"operator, TV {tolerance:.0e}",
        ),
        Claim(
            "tempering.barrier",
            "At equal steps, started in one of two modes, tempering beats one chain and parallel chains of small steps",
            "Hachisuka et al. 2014, sec. 3.1",
            verdict(worst < best / 2),
            "holds",
            f"RMS error of a mode's mass after {int(data.step[-1])} steps: "
            + ", ".join(f"{m} {e:.3f}" for m, e in last.items()),
            f"half the error; {int(data.repeats)} repetitions, 3% relative standard error or so",
        ),
    ]
