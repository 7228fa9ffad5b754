"""An image of the line, rendered in stages: its bias by N and by where b comes from; two readings of Algorithm 2."""

import jax
import numpy as np
import xarray as xr
from scipy.stats import sem
from scipy.stats import t as student

from experiments.support.framework import Claim
from experiments.support.intervals import ratio
from experiments.support.stage_methods import METHODS, PAPER, render
from experiments.support.sweep import Sweep
from experiments.support.verdict import verdict
from mcmc1d.moves import LargeStep, Mixture, SmallStep
from mcmc1d.perception import error
from mcmc1d.pixels import Pixels, resample
from mcmc1d.rendering import NORMALISERS, Renderer, Scene
from mcmc1d.stages import MultiStage, plan
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Uniform
from mcmc1d.types import Key

SCHEMES = ("text", "listing")
"""Where the stages of Algorithm 2 come from."""
FINE = 2**14
"""The side of an image whose stages are counted: the shares hardly depend on it."""
SMALLEST = 256
"""The fewest samples of a biased image: 4 of them for its first stage."""
PIXEL_SAMPLES = 4 * SMALLEST
"""Samples of each image that is held to the exact one pixel by pixel: enough of them in each for a mean that is
nearly normal."""
LEVEL = 1e-5
"""Of all pixels together."""


def measure(side: int, sizes: int, replicas: int, key: Key, progress: Sweep) -> xr.Dataset:
    """Biases of the whole image; of each pixel, by every method; what text and listing make of the same work."""
    samples = [SMALLEST * 4**j for j in range(sizes)]
    line = line_of(side)
    kernel = Mixture({"large": (0.5, LargeStep()), "small": (0.5, SmallStep(0.1))})
    renderer, exact = Renderer(line, kernel, replicas, 1), line.exact()
    total = float(exact.mean())
    bias = np.zeros((len(NORMALISERS), sizes, replicas))
    for row, b in enumerate(NORMALISERS):
        for column, count in enumerate(samples):
            own = jax.random.fold_in(key, 10 * row + column)
            found = renderer.render(own, plan(side, count), MultiStage(line.pixels), b)
            bias[row, column] = found.film.image().mean(1) / total - 1
            progress("bias", row * sizes + column + 1, bias[..., 0].size)
    schemes = np.zeros((len(SCHEMES), 2, replicas))
    for row, scheme in enumerate(SCHEMES):
        stages = plan(side, samples[-1], scheme)
        image = renderer.render(jax.random.fold_in(key, 100 + row), stages, MultiStage(line.pixels)).film.image()
        schemes[row] = image.mean(1) / total - 1, error(image, exact)
        progress("text and listing", row + 1, len(SCHEMES))
    off, noise = np.zeros((2, len(METHODS), side))
    for row, method in enumerate(METHODS):
        image = render(line, method, PIXEL_SAMPLES, replicas, jax.random.fold_in(key, 200 + row), kernel).film.image()
        off[row], noise[row] = image.mean(0) / exact - 1, sem(image) / exact
        progress("pixel by pixel", row + 1, len(METHODS))
    return xr.Dataset(
        {
            "bias": (("b", "samples", "seed"), bias),
            "scheme_found": (("scheme", "found", "seed"), schemes),
            "pixel_off": (("algorithm", "line_pixel"), off),
            "pixel_noise": (("algorithm", "line_pixel"), noise),
        },
        {
            "b": list(NORMALISERS),
            "samples": samples,
            "scheme": list(SCHEMES),
            "found": ["bias", "error"],
            "algorithm": list(METHODS),
        },
    )


def line_of(side: int) -> Scene:
    """What is rendered."""
    return Scene(Sinusoid(0.8, 2.0, 0.1), Uniform(), Pixels(side))


def plugged_limit(side: int) -> float:
    """The bias of the whole image that is left as N grows, with b the total of the image so far.

    Where regions are no whole pixels, b of f over the interpolated image is not the image's total, even of an exact
    one; and a stage in which they are repeats the scale of the image so far.
    """
    line = line_of(side)
    exact, adapt = line.exact(), MultiStage(line.pixels)
    total, samples = 0.0, 0
    for stage in plan(side, FINE**2):
        scale = 1.0
        if samples > 0:
            image = exact[None] * total / samples
            values = 1 / adapt.relative(image, stage.regions)
            plugged = (resample(image, stage.regions, 1) * values).mean()
            scale = float(plugged / (line.region_masses(stage.regions) * values).sum())
        total, samples = total + scale * stage.samples, samples + stage.samples
    return total / samples - 1


def _stages(scheme: str) -> tuple[int, float]:
    """How many stages grow linearly, from half the side on, and the samples' share of those before them."""
    stages = plan(FINE, 10**9, scheme)
    doubling = FINE.bit_length() - 1  # 1, 2, 4 ... FINE / 2
    early = sum(stage.samples for stage in stages[:doubling])
    return len(stages) - doubling, early / sum(stage.samples for stage in stages)


def claims(data: xr.Dataset) -> list[Claim]:
    """Induction, its failure and its repair; each method pixel by pixel; the text's stages and the listing's."""
    bias = data.bias.mean("seed").to_numpy()
    spread = data.bias.std("seed", ddof=1).to_numpy() / data.sizes["seed"] ** 0.5
    scores = np.abs(bias / spread).max(1)
    sizes = ", ".join(str(n) for n in data.samples.to_numpy())
    limit = plugged_limit(data.sizes["line_pixel"])
    unbiased = "5 standard errors at each N; "
    z = np.abs(data.pixel_off / data.pixel_noise).fillna(0)  # neither noise nor an error
    far = float(student.isf(LEVEL / (2 * z.size), data.sizes["seed"] - 1))
    counts, early = zip(*(_stages(scheme) for scheme in SCHEMES), strict=True)
    totals = data.scheme_found.sel(found="bias").to_numpy()
    apart = np.abs(totals.mean(1)) / (totals.std(1, ddof=1) / totals.shape[1] ** 0.5)
    listed = ratio(*(data.scheme_found.sel(found="error", scheme=s).to_numpy() for s in reversed(SCHEMES)))
    return [
        Claim(
            "imp.induction",
            "Multi-stage is unbiased by induction, with b exact or estimated apart",
            f"{PAPER}, sec. 4.2",
            verdict(max(scores[:2]) < 5),
            "holds",
            f"bias {bias[0, 0]:+.2%} (exact), {bias[1, 0]:+.2%} (apart) at N = {SMALLEST}; "
            f"{max(scores[:2]):.1f} s.e. at most",
            f"{unbiased}{5 * spread[:2].max():.2%} at most",
        ),
        Claim(
            "imp.induction-plugged",
            "Multi-stage is unbiased by induction with b the total of the image so far, as in the listing",
            f"{PAPER}, Alg. 2",
            verdict(scores[2] <= 5),
            "fails",
            f"bias {', '.join(f'{value:+.2%}' for value in bias[2])} at N = {sizes}",
            f"{unbiased}{5 * spread[2].max():.2%} at most",
        ),
        Claim(
            "imp.induction-plugged-limit",
            "That bias vanishes as N grows",
            f"ours; {PAPER}, Alg. 2",
            verdict(abs(limit) < 1e-9),
            "fails",
            f"its limit is {limit:+.2%}: where regions are no whole pixels, b of f over the interpolated image is not "
            f"the image's total, and the last stage repeats the scale of the image so far; {bias[2, -1]:+.2%} at N = "
            f"{data.samples.to_numpy()[-1]}, standard error {spread[2, -1]:.2%}",
            "quadrature, 1e-9",
        ),
        Claim(
            "imp.methods-unbiased",
            "Independent samples, MLT, ERPT, two-stage, multi-stage and noise-aware are unbiased in every pixel",
            f"{PAPER}, table 1; Cline, Talbot, Egbert 2005",
            verdict(float(z.max()) < far),
            "holds",
            ", ".join(f"{m} {float(z.sel(algorithm=m).max()):.1f}" for m in data.algorithm.to_numpy())
            + f" s.e. at most, N = {PIXEL_SAMPLES}",
            f"{far:.1f} s.e. of {data.sizes['seed']} seeds ({z.size} pixels, {LEVEL:g} together), "
            f"{far * float(data.pixel_noise.max()):.1%} of a pixel at most",
        ),
        Claim(
            "imp.stages-of-the-listing",
            "The listing's stages are the text's: ten linear ones, after a quarter of the samples for the doubling",
            f"{PAPER}, sec. 4.2, Alg. 2",
            verdict(counts[0] == counts[1] and abs(early[0] - early[1]) < 1e-3),
            "fails",
            f"text {counts[0]} and {early[0]:.1%}, listing {counts[1]} and {early[1]:.1%}; both are unbiased "
            f"({apart[0]:.1f}, {apart[1]:.1f} s.e.), the listing's squared error at N = {data.samples.to_numpy()[-1]} "
            f"times {listed[0]:.3f} [{listed[1]:.3f}, {listed[2]:.3f}]",
            f"counted at {FINE} pixels a side; 5 s.e.; 95 % t interval, {totals.shape[1]} seeds",
        ),
    ]
