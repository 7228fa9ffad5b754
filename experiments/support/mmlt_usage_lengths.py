"""The three lengths of `mmlt_usage`: one chain over them or one each, and their b_k, estimated once or all along."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from scipy.stats import sem

import mcmc1d
from experiments.support.each_chain import EachHistogram
from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, over, paired, shown, under
from experiments.support.verdict import verdict
from mcmc1d.compiling import quickly
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import LargeStep, Mixture, Move, SmallStep, StepAndChange
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import FromFunction, Target
from mcmc1d.techniques import Uniform
from mcmc1d.tempering import over_parts
from mcmc1d.types import Key

SOURCE = "Hachisuka et al. 2014"
LENGTHS: tuple[Target, ...] = (
    FromFunction(lambda x: 1 + x),
    FromFunction(lambda x: 2 * x**3),
    FromFunction(lambda x: jnp.where(x > 0.98, 2.0, 0.0), breaks=(0.98,)),
)
"""What stands for the paths of three lengths; the last is lit for one sample in fifty."""
FIRST = 64
"""Samples of each length that estimate b_k at the start."""
SHARES = (0.5, 0.3, 0.2)
"""P(k), the probability with which a length is chosen; not in proportion to b_k."""
CHECKPOINTS = (64, 256, 1024, 4096, 16384)
MISSES = 1024
"""How many times b_k is estimated by the first two, to see how often it is zero."""


def histograms(
    key: jax.Array, kernel: Kernel | Move, target: Multiplexed, edges: np.ndarray, steps: int, repeats: int
) -> np.ndarray:
    """The histogram of each of many short chains by itself, (repeats, bins)."""
    apart = {"x": EachHistogram(edges, repeats)}
    found = mcmc1d.run(key, kernel, target, steps=steps, chains=repeats, blocks=1, estimators=apart)
    return found.sums["x"][0] / steps


def over_lengths() -> tuple[Multiplexed, Move]:
    """One chain over all lengths: its target and its move."""
    step = Mixture({"large": (0.1, StepAndChange(LargeStep())), "small": (0.9, StepAndChange(SmallStep(0.1)))})
    return over_parts(LENGTHS, (Uniform(),) * len(LENGTHS)), step


def lengths(key: jax.Array, edges: np.ndarray, work: int, repeats: int) -> dict[str, Any]:
    """One chain over lengths and one for each, b_k known.

    The data, for a dataset: chains of `work` steps in all, `repeats` times, and their histograms at `edges`.
    """
    masses = np.stack([length.bin_masses(edges) for length in LENGTHS])
    b = masses.sum(1)
    over, step = over_lengths()
    key, together = jax.random.split(key)
    one = b.sum() * histograms(together, step, over, edges, work, repeats)
    each = np.zeros_like(one)
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).astype(np.uint64))
    # Of each repetition only the chain of one length counts, that of P(k); what it deposits is divided by P(k), or not.
    chosen = np.searchsorted(np.cumsum(SHARES)[:-1], rng.random(repeats), side="right")
    divided, undivided = np.zeros_like(one), np.zeros_like(one)
    for k, length in enumerate(LENGTHS):
        steps = max(1, round(work * b[k] / b.sum()))
        own = Multiplexed(length, Uniform())
        found = b[k] * histograms(jax.random.fold_in(key, k), _alone(), own, edges, steps, repeats)
        each += found
        here = (chosen == k)[:, None]
        divided, undivided = divided + found * here / SHARES[k], undivided + found * here
    errors = [np.sqrt(np.mean((part - masses.sum(0)) ** 2, axis=1)) for part in (one, each)]

    return {
        "over_lengths": ("repeat", errors[0]),
        "each_length": ("repeat", errors[1]),
        "over_bias": float(np.abs(one.mean(0) - masses.sum(0)).max() / masses.sum(0).max()),
        "bias_z": (
            "chain",
            [_z(part, masses.sum(0)) for part in (one, each)],
        ),
        "divided": float(divided.sum(1).mean() / b.sum()),
        "divided_error": float(sem(divided.sum(1)) / b.sum()),
        "divided_z": _z(divided, masses.sum(0)),
        "undivided": float(undivided.sum(1).mean() / b.sum()),
        "undivided_exact": float(np.dot(SHARES, b) / b.sum()),
        "rare_share": float(b[-1] / b.sum()),
    }


def normalisers(key: Key, edges: np.ndarray, repeats: int) -> dict[str, Any]:
    """An image of all lengths after more and more steps, with b_k from the first samples or from as many as steps.

    The data, for a dataset: its RMS error over the mean, `repeats` times; how often the last b_k is zero.
    """
    masses = np.stack([length.bin_masses(edges) for length in LENGTHS])
    exact = masses.sum(0)
    images = np.zeros((2, len(CHECKPOINTS), repeats, len(exact)))
    for k, length in enumerate(LENGTHS):
        target, (b_key, chain_key) = Multiplexed(length, Uniform()), jax.random.split(jax.random.fold_in(key, k))
        b = np.asarray(_estimates(b_key, target, repeats, CHECKPOINTS))
        for i, steps in enumerate(CHECKPOINTS):
            chains = histograms(chain_key, _alone(), target, edges, steps, repeats)
            images[:, i] += np.stack([b[0], b[i]])[..., None] * chains
    rare = Multiplexed(LENGTHS[-1], Uniform())
    early = np.asarray(_estimates(jax.random.fold_in(key, len(LENGTHS)), rare, MISSES, CHECKPOINTS[:2]))
    return {
        "image_error": (
            ("estimate", "samples", "repeat"),
            np.sqrt(np.mean((images - exact) ** 2, axis=-1)) / exact.mean(),
        ),
        "missed": ("early", (early == 0).mean(1)),
        "miss_predicted": ("early", [0.98**samples for samples in CHECKPOINTS[:2]]),
    }


@quickly
def _estimates(key: Key, target: Multiplexed, repeats: int, checkpoints: tuple[int, ...]) -> jax.Array:
    """b_k by so many of the same independent samples, the mean of C(u), (checkpoints, repeats)."""
    u = jax.random.uniform(key, (repeats, checkpoints[-1], target.dim_u))
    index = jnp.zeros(u.shape[:2], jnp.int32)
    log_c = jax.vmap(jax.vmap(target.evaluate))(State(index, u)).seen.log_c
    return jnp.stack([jnp.exp(log_c[:, :count]).mean(1) for count in checkpoints])


def _alone() -> Move:
    """The move of one length's own chain."""
    return Mixture({"large": (0.1, LargeStep()), "small": (0.9, SmallStep(0.1))})


def _z(parts: np.ndarray, exact: np.ndarray) -> float:
    """How many standard errors the mean of independent histograms is off, in its worst bin."""
    return float(np.abs((parts.mean(0) - exact) / sem(parts)).max())


def claims(data: xr.Dataset, passed: bool | None, verified: str, held: str) -> list[Claim]:
    """Lengths together or apart, and b_k; and whether the chain over all lengths was verified, in words."""
    together, apart = data.over_lengths.to_numpy(), data.each_length.to_numpy()
    gain, noise = together.mean() - apart.mean(), float(np.hypot(sem(together), sem(apart)))
    biases = data.bias_z.to_numpy()
    divided, undivided = float(data.divided_z), float(data.undivided)
    shares = ", ".join(f"{p:g}" for p in SHARES)
    missed, predicted = data.missed.to_numpy(), data.miss_predicted.to_numpy()
    tolerance = 5 * np.sqrt(predicted * (1 - predicted) / MISSES)
    once, later = data.image_error.to_numpy()
    falls, stays = paired(later[-1], later[-2], DECIDES), paired(once[-1], later[-1], DECIDES)
    return [
        Claim(
            "mmlt.lengths-law",
            "One chain over all lengths and one chain for each give the same sum, b_k known",
            f"{SOURCE}, sec. 4",
            verdict(bool(biases.max() < 6), passed),
            "holds",
            f"{biases[0]:.1f} and {biases[1]:.1f} standard errors at most; (length, x) over all: {verified}",
            f"6 s.e. in 20 bins; exact joint law, {held}",
        ),
        Claim(
            "mmlt.length-probability",
            "A contribution is divided by the probability P(k) of its length, any P, and the lengths sum to the whole",
            f"{SOURCE}, sec. 4",
            verdict(divided < 6 and abs(float(data.divided) - 1) < 6 * float(data.divided_error)),
            "holds",
            f"P = ({shares}): {float(data.divided):.4f} of b, {divided:.1f} standard errors in a bin at most; "
            f"undivided {undivided:.3f} of b, exactly {float(data.undivided_exact):.3f}",
            f"quadrature; 6 s.e., of the whole {6 * float(data.divided_error):.3f}",
        ),
        Claim(
            "mmlt.lengths-apart",
            "One chain for each length is more efficient than one over all lengths",
            f"{SOURCE}, sec. 4",
            verdict(gain > 3 * noise),
            "holds",
            f"RMS error {apart.mean():.5f} apart, {together.mean():.5f} together, at equal steps",
            f"3 s.e. of the difference, {3 * noise:.5f}",
        ),
        Claim(
            "mmlt.b-once",
            "b_k estimated once may be zero where b_k is not, and less likely progressively",
            f"{SOURCE}, sec. 4",
            verdict(*(np.abs(missed - predicted) < tolerance), missed[0] > missed[1] + tolerance.sum()),
            "holds",
            f"a length lit for 2% of u, {float(data.rare_share):.1%} of b: missed by {CHECKPOINTS[0]} samples in "
            f"{missed[0]:.3f} of the cases (predicted {predicted[0]:.3f}), by {CHECKPOINTS[1]} in {missed[1]:.4f} "
            f"({predicted[1]:.4f})",
            f"binomial, 5 s.e. of {MISSES} estimates, {tolerance[0]:.3f} and {tolerance[1]:.3f}",
        ),
        Claim(
            "mmlt.b-progressive",
            "With b_k estimated progressively the error of the image keeps falling; estimated once it stays behind",
            f"{SOURCE}, sec. 4",
            verdict(under(0.75, falls), over(1.5, stays)),
            "holds",
            f"RMS error of an image of three lengths from {CHECKPOINTS[-2]} to {CHECKPOINTS[-1]} steps: times "
            f"{shown(falls)}; with b_k of {FIRST} samples it is then {shown(stays)} times as large",
            f"0.75 and 1.5; intervals of {data.sizes['repeat']} repetitions that miss with {DECIDES:.0e}",
        ),
    ]
