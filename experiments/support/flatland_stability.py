"""Errors of chains' images, run by run, at equal rays: Bitterli et al. 2017, figure 5 and its videos, in the plane."""

from typing import Any

import jax
import numpy as np
import xarray as xr
from scipy.stats import norm, sem

import mcmc1d
from experiments.support.bootstrap import critical, ratios
from experiments.support.flatland_acceptance import SOURCE
from experiments.support.flatland_chains import METHODS, films, mixed_kernel, mixes
from experiments.support.framework import Claim
from experiments.support.intervals import under
from experiments.support.verdict import among, verdict
from mcmc1d.checks import require
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import RJMLT
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import catalogue, scene

LEVEL = 0.01
"""Of each claim, all scenes of the catalogue and looks together, however many are run."""
LOOKS = (-5, -3, -1)
"""The checkpoints that claims look at: a sixteenth, a quarter and all of the rays."""
STATISTICS = ("mse", "deviation", "flicker")
"""Mean of the squared error over runs; its standard deviation over runs; the root mean square of pixels' deviations.

In the last each pixel counts alike: its deviations are in units of their root mean square over all methods and runs.
"""
SHARP = 0.1
"""Of a pixel, or of the image's mean if that is more: the error that an image must be able to show."""
_LIT = 0.01
"""Of the image's mean: what a pixel has at least whose own value its spread is a share of."""
_B = 2**16
"""Samples for b at once, as many as exact starts look at: one program for both."""


def converge(
    name: str,
    lengths: list[int],
    pixels: int,
    runs: int,
    steps: list[int],
    moves: tuple[float, float, float],
    batches: int,
    seed: int,
) -> dict[str, Any]:
    """Of one scene's image of these lengths: each run's errors after so many steps, and how exact their mean is.

    b is the exact image's, as in the paper (section 7.2); of the exactness alone, that of independent samples.
    Arguments: `moves`, sigma and the shares of large steps and jumps; `batches`, of 2^16 samples for b. Raises
    `ValueError` where no length has light.
    """
    shown = scene(name).with_pixels(pixels)
    exact = image(shown, lengths[-1])
    rows = [k - 1 for k in lengths]
    reference, known = exact.values[rows].sum(0), exact.errors[rows].sum(0)
    residual = np.zeros((len(METHODS), len(steps), runs, pixels))
    own, wrong, of_b = np.zeros((len(METHODS), runs, pixels)), np.zeros((len(METHODS), pixels)), 0.0
    lit_lengths = [k for k in lengths if exact.values[k - 1].max() > 1e-12]
    require(bool(lit_lengths), f"{name}: paths of {', '.join(map(str, lengths))} edges bring no light")
    for edges in lit_lengths:
        paths, true = Paths(shown, edges), exact.values[edges - 1]
        target, n = RJMLT().target(paths), len(paths.eye_lengths)
        key = jax.random.fold_in(jax.random.key(seed), edges + 100 * sum(name.encode()))
        drawn = [
            mcmc1d.normalisation(jax.random.fold_in(key, len(METHODS) + k), target, _B).value for k in range(batches)
        ]
        b = float(np.mean(drawn))
        for k, (method, mix) in enumerate(mixes(n, *moves).items()):
            # A jump traces no ray: at equal work there are more mutations.
            walked = 1 - moves[2] if method.startswith("RJMLT") else 1.0
            checkpoints = np.round(np.array(steps) / walked).astype(int).tolist()
            kernel, label = mixed_kernel(moves[0], *mix), f"{method}, {edges} edges"
            found = films(label, jax.random.fold_in(key, k), kernel, target, paths, runs, checkpoints, {}).films
            residual[k] += pixels * true.mean() * found - true
            own[k] += pixels * b * found[-1]
            wrong[k] += (1 - 1 / n) * pixels * b * found[-1].mean(0)
        of_b = of_b + (true * sem(drawn) / b) ** 2
    lit = reference > _LIT * reference.mean()
    square = residual[..., lit] ** 2
    spread = np.full((len(METHODS), pixels), np.nan)
    spread[:, lit] = residual[:, -1][..., lit].std(1, ddof=1) / reference[lit]
    miss = LEVEL / (len(catalogue()) * len(METHODS))
    noise = np.hypot(sem(own, axis=1, ddof=1), np.sqrt(of_b))
    far = np.array([critical(one, miss) for one in own])[:, None]
    # In a pixel that no path reaches both are zero.
    radius = np.maximum(far * noise + known, np.finfo(float).tiny)
    scale = np.maximum(reference, reference.mean())
    found = {
        "squared": ((residual / reference.mean()) ** 2).mean(-1),
        "flickers": (square / square.mean((0, 2), keepdims=True)).mean(-1),
        "spread": spread,
        "excess": np.abs(own.mean(1) - reference) / radius,
        "twin": np.abs(wrong - reference) / radius,
        "detectable": (radius + norm.ppf(0.99) * noise) / scale,
        "rays": sum(lit_lengths) * np.array(steps),
    }
    return {part: value.tolist() for part, value in found.items()}


def compared(squared: np.ndarray, flickers: np.ndarray) -> np.ndarray:
    """Of each method but MMLT its ratios to it, with intervals: (statistics, methods, scenes, looks, 3).

    `squared` and `flickers`: of (scenes, methods, checkpoints, runs).
    """
    looked = [np.moveaxis(values[:, :, LOOKS], 1, 0) for values in (squared, flickers)]
    shape = (len(METHODS) - 1, *looked[0].shape[1:])
    miss = LEVEL / (len(catalogue()) * len(LOOKS))
    pairs = [(one[1:], np.broadcast_to(one[0], shape)) for one in looked]
    above, below = (np.stack([pair[k] for pair in pairs]).reshape(-1, shape[-1]) for k in (0, 1))
    found = ratios(above, below, miss)
    means, deviations = (part.reshape(2, *shape[:-1], 3) for part in found)
    return np.stack([means[0], deviations[0], np.sqrt(means[1])])


def stability_claims(data: xr.Dataset) -> list[Claim]:
    """Whether images are exact; errors, their variation over runs, and a pixel's from run to run, against MMLT's."""
    said = {
        "mse": ("{} has a lower squared error than MMLT, averaged over runs", "fig. 5"),
        "deviation": ("the squared error of {} varies less from run to run than MMLT's (standard deviation)", "fig. 5"),
        "flicker": (
            "the pixels of {} vary less from run to run than MMLT's (root mean square, all pixels alike)",
            "sec. 7.2, Temporal Stability (videos; the number is ours)",
        ),
    }
    claims = [_exact(data)]
    for method, suffix in ((METHODS[2], ""), (METHODS[3], "-uniform")):
        for statistic in STATISTICS:
            what, where = said[statistic]
            word, number, held = _against_mmlt(data.ratio.sel(statistic=statistic), method, data.sizes["run"])
            source = "ours" if suffix else f"{SOURCE}, {where}"
            name, statement = (
                f"plane.rjmlt{suffix}-{statistic}",
                f"At equal rays {what.format(method.replace(',', ' with'))}",
            )
            claims.append(Claim(name, statement, source, word, "holds", number, held))
    return claims


def _exact(data: xr.Dataset) -> Claim:
    worst, sharp = float(data.excess.max()), data.detectable.max(["method", "pixel"])
    caught = (data.twin.max("pixel") > 1).to_numpy()
    finds = ", ".join(f"{float(sharp.sel(scene=name)):.0%} in {name}" for name in data.scene.to_numpy())
    return Claim(
        "plane.rjmlt-exact",
        "MMLT and RJMLT agree with the exact image in every pixel, b from independent samples",
        "ours, flatland",
        verdict(worst <= 1, True if float(sharp.max()) <= SHARP else None),
        "holds",
        f"worst pixel at {worst:.2f} of what would have failed",
        f"family-wise {LEVEL:g}, bootstrap of the largest of a method's pixels; finds, in the worst pixel, {finds} "
        f"(open above {SHARP:.0%}); twin: without one technique's share, {caught.sum()} of {caught.size} caught",
    )


def _against_mmlt(ratio: xr.DataArray, method: str, runs: int) -> tuple[str, str, str]:
    """Verdict, number and tolerance of a method's ratio to MMLT."""
    by_name, words, width = {}, [], 1.0
    for name in ratio.scene.to_numpy():
        looks = ratio.sel({"rival": method, "scene": name}).to_numpy()
        by_name[str(name)] = under(1, *(tuple(one) for one in looks))
        middle, low, high = looks[-1]
        width = max(width, high / middle)
        counts = f"under 1 at {int((looks[:, 2] < 1).sum())}, over at {int((looks[:, 1] > 1).sum())}"
        words.append(f"{name}: times {middle:.2f} [{low:.2f}, {high:.2f}], {counts} of {len(looks)} looks")
    twin = ratio.sel(rival=METHODS[1]).to_numpy()
    refuted = int((twin[..., 1] > 1).any(-1).sum())
    level = f"{LEVEL:g} (where tails are long up to twice)" if ratio.statistic == "deviation" else f"{LEVEL:g}"
    held = (
        f"1; studentised bootstrap of {runs} runs, family-wise {level} over {len(catalogue())} scenes and "
        f"{len(LOOKS)} looks; at the last finds a ratio under {1 / width:.2f} in any scene with probability a half; "
        f"twin: {METHODS[1]}, refuted in {refuted} of {len(twin)}"
    )
    return among(by_name), "; ".join(words), held


__all__ = ["LOOKS", "STATISTICS", "compared", "converge", "stability_claims"]
