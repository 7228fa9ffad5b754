"""Coherent MLT's own parameters: sub-chains and split samples, the step's size against p, the sub-sequence's length."""

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

import mcmc1d
from experiments.support.each_chain import EachHistogram
from experiments.support.framework import Claim
from experiments.support.intervals import under
from experiments.support.long import long_run
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.metropolis import Kernel, Metropolis, Step, acceptance
from mcmc1d.moves import LargeStep, Move, MultipleTry, SmallStep, Stratified
from mcmc1d.moves.multiple_try import around, row
from mcmc1d.subchain import SplitSample, SubChain
from mcmc1d.targets import GaussianMixture
from mcmc1d.techniques import Uniform
from mcmc1d.verify import RingStep, enumerate_kernel, ring

SOURCE = "Segovia et al. 2007"
K = TypeVar("K", bound=Kernel)


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    bins: int = 40
    chains: int = 256
    """Independent chains, from exact starts; the errors are those of one."""
    work: int = 2**13
    """Evaluations of the target by one chain."""
    sigma: float = 0.05
    """Of the sub-chains' step, 5 % of the image as in the paper."""
    wide: float = 0.3
    """Of a step that reaches the other modes."""
    tries: int = 4
    """Candidates of the sub-chains."""


PROFILES = {"quick": Config(), "paper": Config(chains=2048, work=2**16)}

F = (1.0, 3.0, 0.5, 2.0, 4.0)
NEAR, FAR = RingStep(5, {1: 0.75, -1: 0.25}), RingStep(5, {1: 0.25, 2: 0.5, -2: 0.25})
TRIES = (1, 4, 16, 64)
SIZES = (0.02, 0.04, 0.08, 0.12, 0.16, 0.22, 0.3)
PAIR = (0.08, 0.16)
"""The two that are compared."""
LENGTHS = (1, 4, 16, 64)
PEAK = mcmc1d.Multiplexed(GaussianMixture([0.5], [0.05], [1.0]), Uniform())
"""A single peak: what is compared is the size of the step, not whether it finds another mode."""
MODES = mcmc1d.Multiplexed(GaussianMixture([0.1, 0.45, 0.9], [0.08, 0.06, 0.12], [0.5, 0.2, 0.3]), Uniform())


class Twin(Kernel, Generic[K]):
    """A kernel that is `right` in everything but what it deposits."""

    right: eqx.AbstractVar[K]

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.right.kinds

    def dim_w(self, target: mcmc1d.Multiplexed) -> int:
        return self.right.dim_w(target)

    def check(self, target: mcmc1d.Multiplexed) -> None:
        self.right.check(target)


class FromTheProposal(Twin[SubChain]):
    """A sub-chain that starts where the main chain's `move` has proposed to go, accepted or not."""

    right: SubChain
    move: Move

    def step(self, target: mcmc1d.Multiplexed, state: mcmc1d.State, w: jax.Array) -> Step:
        step = self.right.step(target, state, w)
        numbers = w[None, : self.move.dim_w(target)]
        proposal = row(around(self.move, target, state, numbers), jnp.zeros((), jnp.int32))
        possible = acceptance(state, proposal) > 0
        there = jax.tree.map(lambda a, b: jnp.where(possible, a, b), proposal.state, state)
        return eqx.tree_at(lambda s: s.deposits, step, self.right.step(target, there, w).deposits)


class NothingKept(Twin[SplitSample]):
    """A sample all given to its proposals, in proportion to their R_i."""

    right: SplitSample

    def step(self, target: mcmc1d.Multiplexed, state: mcmc1d.State, w: jax.Array) -> Step:
        step = self.right.step(target, state, w)
        given = step.deposits.weight[1:].sum()
        alone = step.deposits.weight
        weight = jnp.where(given > 0, alone.at[0].set(0) / jnp.where(given > 0, given, 1), alone)
        return eqx.tree_at(lambda s: s.deposits.weight, step, weight)


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Deposits by enumeration; then errors at equal work over sizes and candidates, and over lengths."""
    target, states = ring(F)
    sub, split = SubChain(FAR, NEAR, 2), SplitSample(NEAR, 3)
    first = SubChain(FAR, MultipleTry(NEAR, 1), 1)
    pair = {
        "sub-chain": (sub, [4, None] * 3),
        "sub-chain from the proposal": (FromTheProposal(sub, FAR), [4, None] * 3),
        "split": (split, [4, 4, 4, None]),
        "split, nothing kept": (NothingKept(split), [4, 4, 4, None]),
        "length 1, one candidate": (first, [4, None, 4, None, None]),
        "Metropolis": (Metropolis(NEAR), [4, None]),
    }
    found = {}
    for k, (name, (kernel, plan)) in enumerate(pair.items()):
        found[name] = enumerate_kernel(kernel, target, states, plan, inner=8)
        progress("enumeration", k + 1, len(pair))
    same = np.abs(found["length 1, one candidate"].deposits - found["Metropolis"].deposits).max()
    data = {
        "bias": ("kernel", [each.deposit_residual for each in found.values()]),
        "residual": ("kernel", [each.residual for each in found.values()]),
        "mlt_gap": same,
    }
    error, spread = (np.zeros((len(TRIES), len(SIZES))) for _ in range(2))
    key = jax.random.key(seed)
    for i, j in np.ndindex(error.shape):
        kernel = Metropolis(MultipleTry(SmallStep(SIZES[j]), TRIES[i], candidates=Stratified()))
        name, own = f"p {TRIES[i]}, sigma {SIZES[j]:g}", jax.random.fold_in(key, 100 * i + j)
        error[i, j], spread[i, j] = _error(name, config, kernel, PEAK, 2 * TRIES[i] - 1, own)
        progress("sigma and p", i * len(SIZES) + j + 1, error.size)
    length, length_spread = (np.zeros((2, len(LENGTHS))) for _ in range(2))
    for j, i in np.ndindex(len(LENGTHS), 2):
        inner = MultipleTry(SmallStep((config.sigma, config.wide)[i]), config.tries, candidates=Stratified())
        kernel = SubChain(LargeStep(), inner, LENGTHS[j])
        work, own = 1 + LENGTHS[j] * (2 * config.tries - 1), jax.random.fold_in(key, 1000 + 100 * i + j)
        name = f"length {LENGTHS[j]}, sub-chain {i}"
        length[i, j], length_spread[i, j] = _error(name, config, kernel, MODES, work, own)
        progress("length", 2 * j + i + 1, length.size)
    return xr.Dataset(
        {
            **data,
            "error": (("tries", "sigma"), error),
            "error_se": (("tries", "sigma"), spread),
            "length_error": (("sub", "length"), length),
            "length_se": (("sub", "length"), length_spread),
        },
        {
            "kernel": list(pair),
            "tries": list(TRIES),
            "sigma": list(SIZES),
            "length": list(LENGTHS),
            "sub": [f"sigma {config.sigma}", f"sigma {config.wide}"],
        },
    )


def _error(
    name: str, config: Config, kernel: Kernel, target: mcmc1d.Multiplexed, evaluations: int, key: jax.Array
) -> tuple[float, float]:
    """The root mean square error of one chain's histogram over that of independent samples, and its standard error."""
    edges = np.linspace(0, 1, config.bins + 1)
    masses = target.target.bin_masses(edges)
    exact = masses / masses.sum()
    steps = config.work // evaluations
    estimators = {"x": EachHistogram(edges, config.chains)}
    size: dict[str, Any] = {"steps": steps, "chains": config.chains, "blocks": 1}
    sums = long_run(name, key, kernel, target, **size, estimators=estimators).sums["x"][0]
    square = ((sums / steps - exact) ** 2).sum(1) * (steps * evaluations) / (1 - (exact**2).sum())
    error = float(np.sqrt(square.mean()))
    return error, float(square.std(ddof=1) / np.sqrt(len(square)) / (2 * error))


def draw(data: xr.Dataset) -> Figure:
    """The error at equal work against the size of the step, and against the length of the sub-chains."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 2.5), width_ratios=(1.2, 1))
    for k, tries in enumerate(TRIES):
        here = data.sel(tries=tries)
        left.errorbar(
            here.sigma, here.error, 2 * here.error_se, fmt="o-", color=f"C{k}", markersize=2.5, label=f"p = {tries}"
        )
        best = int(here.error.to_numpy().argmin())
        left.plot(SIZES[best], here.error[best], "o", color=f"C{k}", markersize=8, markerfacecolor="none")
    left.set(xscale="log", yscale="log", xlabel="standard deviation of the step", ylabel="error at equal work")
    left.set_title("multiple-try, deposit on two states; circles: the best size; independent samples: 1", fontsize=6)
    left.set_xticks(list(SIZES), [f"{size:g}" for size in SIZES])
    left.legend(ncols=2)
    for k, sub in enumerate(data["sub"].to_numpy()):
        here = data.sel(sub=sub)
        label = f"{sub} in the sub-chains"
        right.errorbar(
            here.length, here.length_error, 2 * here.length_se, fmt="o-", color=f"C{k}", markersize=2.5, label=label
        )
    right.set(xscale="log", yscale="log", xlabel="steps of a sub-chain", ylabel="error at equal work")
    right.set_xticks(list(LENGTHS), [str(length) for length in LENGTHS])
    right.legend()
    for axes in (left, right):
        low, high = axes.get_ylim()
        ticks = [tick for tick in (1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50) if low <= tick <= high]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    return figure


def table(data: xr.Dataset) -> Table:
    """The errors at equal work."""
    result = Table("", *(f"sigma {size:g}" for size in SIZES), box=SIMPLE, padding=0)
    result.title = "cmlt_sigma_p: error of a histogram at equal work, that of independent samples being 1"
    for tries in TRIES:
        result.add_row(f"p = {tries}", *(f"{error:.2f}" for error in data.error.sel(tries=tries).to_numpy()))
    for sub in data["sub"].to_numpy():
        errors = data.length_error.sel(sub=sub).to_numpy()
        result.add_row(f"sub-chains, {sub}", *(f"{e:.2f} (L {n})" for n, e in zip(LENGTHS, errors, strict=True)))
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Sub-chains and split samples are exact, their twins not; sizes and lengths matter as theory says."""
    bias = {str(name): float(data.bias.sel(kernel=name)) for name in data.kernel.to_numpy()}
    residual = float(data.residual.max())
    error, se = data.error.to_numpy(), data.error_se.to_numpy()
    best = error.argmin(1)
    # At two sizes that were chosen beforehand: the larger is worse with one candidate, and better with several.
    near, wide_step = (SIZES.index(size) for size in PAIR)
    log_ratio = np.log(error[:, wide_step] / error[:, near])
    ratio_se = np.hypot(se[:, wide_step] / error[:, wide_step], se[:, near] / error[:, near])
    many, many_se = log_ratio[1:].mean(), np.hypot.reduce(ratio_se[1:]) / len(ratio_se[1:])
    grows = log_ratio[0] > 3 * ratio_se[0] and many < -3 * many_se
    last = error[-1]
    small, small_se = last[0] / last[best[-1]], np.hypot(se[-1, 0], se[-1, best[-1]]) / last[best[-1]]
    length, length_se = data.length_error.to_numpy(), data.length_se.to_numpy()
    grown = length.max(1) / length.min(1)
    blur = [float((length_se[i] / length[i]).max()) for i in range(2)]
    # Five standard errors of either length, both ways.
    little = [under(1.25, (g, g * (1 - 10 * b), g * (1 + 10 * b))) for g, b in zip(grown, blur, strict=True)]
    local, wide = (str(name) for name in data["sub"].to_numpy())

    def claim(
        name: str, statement: str, source: str, holds: bool | None, expected: str, number: str, held: str
    ) -> Claim:
        return Claim(f"cmlt.{name}", statement, source, verdict(holds), expected, number, held)

    exactly = "enumeration, a ring of five, lopsided steps; exact to 1e-12"
    return [
        claim(
            "sub-chain",
            "Deposits along sub-chains that start at the main chain's states are unbiased",
            f"{SOURCE}, alg. 1",
            bias["sub-chain"] < 1e-12 and residual < 1e-12,
            "holds",
            f"TV {bias['sub-chain']:.1e}",
            exactly,
        ),
        claim(
            "sub-chain-proposal",
            "Sub-chains may start at the main chain's proposals, accepted or not",
            "ours",
            bias["sub-chain from the proposal"] < 1e-12,
            "fails",
            f"TV {bias['sub-chain from the proposal']:.4f}",
            exactly,
        ),
        claim(
            "split",
            "A sample split among m proposals, R_i / m on each and the rest kept, is unbiased",
            f"{SOURCE}, sec. 5.2; Cline et al. 2005",
            bias["split"] < 1e-12,
            "holds",
            f"TV {bias['split']:.1e}, m = 3",
            exactly,
        ),
        claim(
            "split-nothing-kept",
            "Split among its proposals in proportion to R_i, with nothing kept, it is unbiased",
            "ours",
            bias["split, nothing kept"] < 1e-12,
            "fails",
            f"TV {bias['split, nothing kept']:.4f}, m = 3",
            exactly,
        ),
        claim(
            "contains-mlt",
            "Sub-chains of one step with one candidate are MLT's own perturbations with its deposits",
            f"{SOURCE}, sec. 7.1",
            float(data.mlt_gap) < 1e-12,
            "holds",
            f"the expected deposits from each state differ by {float(data.mlt_gap):.1e}",
            "enumeration, 1e-12",
        ),
        claim(
            "sigma-p",
            "The best size of the step is larger with several candidates than with one",
            f"{SOURCE}, sec. 7.1; Bedard, Douc, Moulines 2012",
            bool(grows),
            "holds",
            "best sigma "
            + ", ".join(f"{SIZES[k]:g} (p = {p})" for k, p in zip(best, TRIES, strict=True))
            + f"; the error at {PAIR[1]:g} over that at {PAIR[0]:g}: {np.exp(log_ratio[0]):.2f} with one candidate, "
            f"{np.exp(many):.2f} with more",
            f"the two sizes chosen beforehand; 3 standard errors, of {ratio_se[0]:.1%} and {many_se:.1%}",
        ),
        claim(
            "small-sigma",
            f"Many candidates in too small an area do poorly (p = {TRIES[-1]}, sigma {SIZES[0]:g})",
            f"{SOURCE}, sec. 7.1, fig. 5",
            small - 1 > 5 * small_se,
            "holds",
            f"{small:.1f} +- {small_se:.1f} times the error at the best size, at equal work",
            "5 standard errors above 1",
        ),
        claim(
            "length-local",
            f"The error at equal work is almost insensitive to the sub-chains' length ({local}, p = 4; there p = 256)",
            f"{SOURCE}, sec. 7.1",
            little[0],
            "fails",
            f"changes {grown[0]:.2f}-fold from {LENGTHS[0]} to {LENGTHS[-1]} steps: a local sub-chain repeats itself",
            f"factor 1.25, by five standard errors of each, {blur[0]:.1%} at most",
        ),
        claim(
            "length-wide",
            f"It is where the sub-chain's step reaches everywhere ({wide})",
            f"ours; {SOURCE}, sec. 7.1",
            little[1],
            "holds",
            f"changes {grown[1]:.2f}-fold",
            f"factor 1.25, by five standard errors of each, {blur[1]:.1%} at most",
        ),
    ]
