"""The primary-sample sampler of Pharr, Jakob, Humphreys, section 16.4, claim by claim; its replay loses the law."""

from dataclasses import dataclass

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.special import ndtr

from experiments.support import pss_sampler_references
from experiments.support.framework import Claim
from experiments.support.pss_sampler_law import merged_draws, product_law, under_test
from experiments.support.pss_sampler_references import (
    BOOK,
    CHAIN,
    STARTS,
    TIMES,
    deposit_variances,
    lazy_errors,
    lengths,
    merging,
    random_ratios,
    startup,
    walls,
)
from experiments.support.pss_sampler_simulations import HOLES, dark_share, holes, paths, ratio, simulate
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects, passes, verdict, witnessed
from mcmc1d import lazy, verify
from mcmc1d.lazy import LazySampler
from mcmc1d.verify.goodness import p_value, smallest_gap


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    replicas: int = 2**15
    """Of each verification of the sampler."""
    draws: int = 2**17
    """Of merged small steps."""
    chains: int = 2**12
    """Of the simulations on streams and on holes."""
    steps: int = 128


PROFILES = {"quick": Config(), "paper": Config(replicas=2**18, draws=2**21, chains=2**16, steps=1024)}


MERGED = (1, 4, 25)
LARGE = np.array([0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9])
STEP = 0.05
LARGE_STEP = 0.1


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The exact references, then the simulations."""
    errors = np.array([[lazy_errors(replay, p) for p in LARGE] for replay in ("merged", "apart")])
    progress("sampler", 1, 8)
    key, law, reports = jax.random.key(seed), product_law(), []
    for name, replay, zeros in (
        ("missed steps apart", "apart", False),
        ("as published", "merged", False),
        ("gaps zero", "apart", True),
    ):
        kernel = under_test(LazySampler(3, sigma=0.1, large_step=LARGE_STEP, replay=replay), zeros=zeros)
        reports.append(verify.verify(kernel, law, replicas=config.replicas, seed=seed, name=name))
        progress("sampler", 1 + len(reports), 8)
    edges, p_values = np.linspace(0, 1, 65), []
    for k, n in enumerate(MERGED):
        w = jax.random.uniform(jax.random.fold_in(key, k), (config.draws, 4))
        value = merged_draws(LazySampler(1, sigma=STEP), n, w)
        turns = np.arange(-4, 5)[:, None]
        masses = np.diff(ndtr((edges + turns - 0.3) / (STEP * np.sqrt(n))), axis=1).sum(0)
        p_values.append(p_value(np.histogram(np.asarray(value), edges)[0], masses))
    progress("sampler", 5, 8)
    rates = np.zeros((2, 2, 2))
    for k, streams in enumerate((1, 2)):
        sampler = LazySampler(6 if streams == 1 else 4, sigma=STEP, large_step=LARGE_STEP, streams=streams)
        one, two = jax.random.split(jax.random.fold_in(key, 10 + k))
        chains, _ = lazy.bootstrap(one, sampler, paths, chains=config.chains, candidates=32 * config.chains)
        sums = np.asarray(simulate(paths, sampler, two, chains, config.steps), np.float64)
        rates[k] = ratio(sums[:, 1], sums[:, 0]), ratio(sums[:, 3], sums[:, 2])
        progress("sampler", 6 + k, 8)
    sampler = LazySampler(1, sigma=STEP, large_step=LARGE_STEP)
    one, two = jax.random.split(jax.random.fold_in(key, 20))
    chains, _ = lazy.bootstrap(one, sampler, holes, chains=config.chains, candidates=32 * config.chains)
    sums = np.asarray(simulate(holes, sampler, two, chains, config.steps), np.float64)
    dark = ratio(sums[:, 4], np.full(config.chains, config.steps))
    progress("sampler", 8, 8)
    clamped, exact = walls(True)
    plain, expected = deposit_variances(*CHAIN)
    around, _ = walls(False)
    short = [(t, c) for t in range(1, 200) for c in range(1, 50)]
    return xr.Dataset(
        {
            "lazy_tv": (("replay", "large_step"), errors[..., 0]),
            "path_tv": (("replay", "large_step"), errors[..., 1]),
            "verdict": ("kernel", [r.verdict.value for r in reports]),
            "p": ("kernel", [r.p_value for r in reports]),
            "gap": ("kernel", [r.gap for r in reports]),
            "merge_error": ("n", [merging(STEP, n, np.sqrt(n)) for n in MERGED]),
            "merge_wrong": ("n", [merging(STEP, n, n) for n in MERGED]),
            "merge_p": ("n", p_values),
            "draws": config.draws,
            "clamped": ("wall_cell", clamped),
            "around": ("cell", around),
            "wall_exact": ("wall_cell", exact),
            "ratios": ("random", random_ratios(seed)),
            "deposit_bias": deposit_bias(),
            "chain_ratio": expected / plain,
            "startup": (("candidates", "start", "time"), np.stack([startup(m) for m in (1, 4, 16)])),
            "lengths": ("b", list(lengths())),
            "rate": (("streams", "of", "moment"), rates),
            "dark": ("moment", list(dark)),
            "dark_exact": dark_share(STEP, LARGE_STEP),
            "count_error": max(abs(sum(lazy.chain_lengths(t, c)) - t) for t, c in short),
            "count_short": max(t - t // c * c for t, c in short),
        },
        {
            "replay": ["merged", "apart"],
            "large_step": LARGE,
            "n": list(MERGED),
            "start": list(STARTS),
            "candidates": [1, 4, 16],
            "time": TIMES,
            "streams": [1, 2],
            "of": ["all", "camera changed"],
            "moment": ["mean", "error"],
            "b": ["sum", "mean"],
        },
    )


def deposit_bias() -> float:
    """The bias (TV) of expected-value deposits on a ring, every outcome of the library's own kernel enumerated."""
    target, states = verify.ring([1.0, 3.0, 0.5, 2.0, 4.0])
    return verify.enumerate_kernel(verify.RingStep(5, {1: 0.75, -1: 0.25}), target, states).deposit_residual


def draw(data: xr.Dataset) -> Figure:
    """Six panels, a claim each."""
    figure, axes = plt.subplots(2, 3, figsize=(7.0, 4.0))
    a, b, c, d, e, f = axes.ravel()
    for replay, label in (("merged", "as published"), ("apart", "missed steps apart")):
        a.plot(data.large_step, data.lazy_tv.sel(replay=replay), "o-", markersize=3, label=label)
    a.set(xlabel="large-step probability", ylabel="total variation", title="lazy sampler: error of its law")
    a.legend()
    n = data.sizes["cell"]
    x = (np.arange(n) + 0.5) / n
    b.plot(x, n * data.clamped[1:-1], label="clamped")
    b.plot(x, n * data.around, "--", label="wrapped")
    b.plot(x, n * data.wall_exact[1:-1], color="black", linewidth=0.6, label="exact")
    atoms = [float(data.clamped[k]) for k in (0, -1)]
    b.vlines([0, 1], 0, [20 * atom for atom in atoms], color="C0")
    b.plot([0, 1], [20 * atom for atom in atoms], "o", color="C0", markersize=3)
    b.text(0.96, 20 * atoms[1], f"{atoms[1]:.1%} of the law on the wall", ha="right", va="center", fontsize=6)
    b.set(xlabel="u", ylabel="density", ylim=(0, 2.5), title="steps at a wall")
    b.legend(loc="center left", bbox_to_anchor=(0, 0.7))
    c.hist(data.ratios, np.linspace(0, 1.5, 61), color="C0", density=True)
    c.axvline(1, color="black", linewidth=0.6)
    ratio = float(data.chain_ratio)
    c.plot([ratio], [0.05], "v", color="C1", markersize=4)
    c.text(ratio, 0.2, f"the chain\nwith {ratio:.2f}", ha="center", fontsize=6)
    c.set(
        xlabel="variance, expected-value over plain",
        ylabel="random chains",
        title="deposits of three-state chains",
        xlim=(0, 1.65),
    )
    for start, colour in zip(STARTS, ("C2", "C0", "C1"), strict=True):
        bias = np.abs(data.startup.sel(start=start, candidates=4))
        d.plot(data.time, np.maximum(bias, 1e-16), color=colour, label=start)
    d.set(xlabel="steps", ylabel="relative bias", yscale="log", ylim=(1e-17, 100), title="start-up bias, 4 candidates")
    d.set_yticks([1e-15, 1e-10, 1e-5, 1])
    d.legend(loc="center right", bbox_to_anchor=(1, 0.42))
    width = 0.35
    for k, (streams, label) in enumerate(((1, "single counter"), (2, "separate streams"))):
        here = data.rate.sel(streams=streams)
        e.bar(
            np.arange(2) + (k - 0.5) * width, here.sel(moment="mean"), width, yerr=here.sel(moment="error"), label=label
        )
    e.set_xticks([0, 1], ["all small steps", "that change\nthe camera's length"])
    e.set(ylabel="acceptance rate", ylim=(0, 0.6), title="streams")
    e.legend(loc="upper left", ncols=2)
    shares = [float(np.mean(HOLES == 0)), float(data.dark.sel(moment="mean"))]
    f.bar(["independent", "Metropolis"], shares, 0.5, color=["C1", "C0"])
    f.plot([1], [float(data.dark_exact)], "k_", markersize=14, label="exact")
    f.set(ylabel="share of proposals", title="zero contribution, a target with holes")
    f.legend()
    return figure


def table(data: xr.Dataset) -> Table:
    """The lazy sampler's error by the large-step probability."""
    result = Table("large steps", "as published", "missed steps apart", box=SIMPLE)
    result.title = "pss_sampler: total variation of the lazy sampler's law from the eager one's"
    for large, errors in zip(data.large_step.to_numpy(), data.lazy_tv.to_numpy().T, strict=True):
        result.add_row(f"{large:.0%}", f"{errors[0]:.5f}", f"{errors[1]:.1e}")
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """The sampler and its simulations, and between them what is known exactly."""
    merged, apart = (data.lazy_tv.sel(replay=r).to_numpy() for r in ("merged", "apart"))
    steps = data.path_tv.max("large_step").to_numpy()
    verdicts, p, gap = (data[name].to_numpy() for name in ("verdict", "p", "gap"))
    tested = detects(gap[0])
    (all_one, all_two), (changed_one, changed_two) = (
        [(float(r[0]), float(r[1])) for r in data.rate.sel(of=of).to_numpy()] for of in ("all", "camera changed")
    )
    z = (changed_two[0] - changed_one[0]) / np.hypot(changed_two[1], changed_one[1])
    dark, dark_error = (float(v) for v in data.dark)
    share = float(np.mean(HOLES == 0))
    off = abs(dark - float(data.dark_exact)) / dark_error
    return [
        Claim(
            "pss.lazy-equals-eager",
            "The lazy sampler, which backs a number up before the steps it has missed, has the eager one's law",
            f"{BOOK}.4",
            witnessed(max(merged) < 1e-12, passes(verdicts[1:2])),
            "fails",
            f"TV {max(merged):.3f} without large steps, {merged[2]:.3f} at 10 %; {verdicts[1]}, p {p[1]:.1e}",
            f"a chain written down, 1e-12; {tested}",
        ),
        Claim(
            "pss.lazy-apart",
            "It has, if the missed steps are taken before the backup and a rejection undoes the last one only",
            "ours",
            verdict(max(apart) < 1e-12, float(steps[1]) < 1e-12, passes(verdicts[:1])),
            "holds",
            f"TV {max(apart):.1e}, of the first 64 steps' laws {steps[1]:.1e} (as published {steps[0]:.2g}); "
            f"{verdicts[0]}, p {p[0]:.2g}",
            f"a chain written down, 1e-12; {tested}",
        ),
        Claim(
            "pss.gaps-zero",
            "Gaps may be filled with zeros of time stamp 0: iteration 0 counts as a large step",
            f"{BOOK}.4",
            verdict(passes(verdicts[2:3])),
            "fails",
            f"{verdicts[2]}, p {p[2]:.1e}; the repair is a stamp before iteration 0, as in the row above",
            tested,
        ),
        Claim(
            "pss.merged-steps",
            "n missed small steps are one of sigma sqrt(n), around the ends",
            f"{BOOK}.4, eq. 16.23",
            verdict(float(data.merge_error.max()) < 1e-12 and float(data.merge_p.min()) > 1e-6),
            "holds",
            f"densities differ by {float(data.merge_error.max()):.1e}; the sampler's draws, p "
            f"{float(data.merge_p.min()):.2g}; sigma n would be off by {float(data.merge_wrong[1]):.2g} at n = 4",
            f"convolution, 1e-12; level 1e-6 each, detects a CDF gap of {smallest_gap(int(data.draws), 1e-6):.4f}",
        ),
        *pss_sampler_references.claims(data),
        Claim(
            "pss.streams",
            "Separate streams keep a camera change from shifting the light path's numbers",
            f"{BOOK}.4",
            verdict(z > 5),
            "holds",
            f"small steps that change the camera's length: accepted {changed_two[0]:.3f}, single counter "
            f"{changed_one[0]:.3f}; all: {all_two[0]:.3f}, {all_one[0]:.3f}",
            f"{z:.0f} standard errors, held to 5",
        ),
        Claim(
            "pss.zero-contribution",
            "Metropolis makes fewer samples of zero contribution than independent sampling",
            f"{BOOK}.2, table 16.1",
            verdict(dark < share and off < 5),
            "holds",
            f"{dark:.1%} against {share:.0%}; exactly {float(data.dark_exact):.2%}, {off:.1f} standard errors off",
            "quadrature; 5 standard errors",
        ),
    ]
