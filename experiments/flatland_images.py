"""Every integrator in every scene of flatland, each pixel held to the exact image; wrong integrators, which fail."""

import zlib
from dataclasses import dataclass
from typing import Any

import jax
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from mcmc1d.flatland.integrators import INTEGRATORS, Image, integrate
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.mutants import mutants
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import catalogue, scene

LEVEL = 1e-4
"""Family-wise: that any pixel of any right image fails."""


@dataclass(frozen=True)
class Config:
    """The experiment's numbers; scenes, integrators and mutants are names, or "all"."""

    scenes: str = "box"
    integrators: str = "pt bdpt mmlt rjmlt"
    mutants: str = "r_squared techniques_missing"
    lengths: int = 2
    log2_samples: int = 22
    """Of each length: paths or mutations."""
    pixels: int = 16


PROFILES = {
    "quick": Config(),
    "paper": Config(scenes="all", integrators="all", mutants="all", lengths=5, log2_samples=25),
}


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Render each scene with each integrator, and what the mutants' own scenes and samples are."""
    scenes = _chosen(config.scenes, catalogue())
    names, wrong = _chosen(config.integrators, INTEGRATORS), _chosen(config.mutants, mutants())
    known = progress.map("references", exact_image, [(s, config.lengths, config.pixels) for s in scenes])
    exact = dict(zip(scenes, known, strict=True))
    level = LEVEL / (len(scenes) * len(names) + len(wrong))
    points = [
        (s, name, config.lengths, config.pixels, config.log2_samples, seed, level, *exact[s])
        for s in scenes
        for name in names
    ]
    rows = progress.map("images", held, points)
    caught = progress.map("mutants", catches, [(name, seed, level) for name in wrong])
    shape = (len(scenes), len(names))

    def grid(of: str) -> np.ndarray:
        return np.array([row[of] for row in rows], np.float64).reshape(shape)

    cells = ("scene", "integrator")
    return xr.Dataset(
        {
            **{of: (cells, grid(of)) for of in ("excess", "detectable", "twin", "blind", "rays")},
            "right_passes": ("mutant", [right for right, _ in caught]),
            "caught": ("mutant", [found for _, found in caught]),
            "pixels": config.pixels,
            "lengths": config.lengths,
        },
        {"scene": scenes, "integrator": names, "mutant": wrong},
    )


def _chosen(text: str, known: Any) -> list[str]:
    names = list(known) if text == "all" else text.split()
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"there is no {', '.join(unknown)}; known: {', '.join(known)}")
    return names


def exact_image(name: str, lengths: int, pixels: int) -> tuple[list[Any], list[Any]]:
    """Values and errors of the exact image, (lengths, pixels) each."""
    found = image(scene(name).with_pixels(pixels), lengths)
    return found.values.tolist(), found.errors.tolist()


def held(
    name: str,
    integrator: str,
    lengths: int,
    pixels: int,
    log2_samples: int,
    seed: int,
    level: float,
    values: list[Any],
    errors: list[Any],
) -> dict[str, float]:
    """One image against the exact one: each length and the total, every pixel.

    The worst pixel's excess in radii of the test, the median and largest smallest detectable error of a pixel that is
    not dark, whether the image without one technique's factor is caught, and whether the integrator said that it can
    not make this scene's light.
    """
    key = jax.random.fold_in(jax.random.key(seed), zlib.crc32(integrator.encode()))
    try:
        found = integrate(key, integrator, scene(name), lengths=lengths, samples=2**log2_samples, pixels=pixels)
    except ValueError as error:
        if "seen in a mirror" not in str(error):
            raise
        return {"excess": 0.0, "detectable": np.nan, "twin": np.nan, "blind": 1.0, "rays": 0.0}
    result = compare(found, np.array(values), np.array(errors), level)
    off = Image([layer.scaled((layer.edges + 1) / (layer.edges + 2)) for layer in found.layers])
    return {
        "excess": float(result.excess.max()),
        "detectable": float(result.detectable[-1].max()),
        "twin": float(not compare(off, np.array(values), np.array(errors), level).agrees),
        "blind": 0.0,
        "rays": float(found.rays),
    }


def catches(name: str, seed: int, level: float) -> tuple[bool, bool]:
    """Whether the right twin of a mutant passes, and whether the mutant is caught."""
    mutant = mutants()[name]
    if mutant.layer != "image":
        return True, True  # a round trip, which the tests make
    of = mutant.scene.with_pixels(4)
    known = image(of, max(mutant.lengths))
    at = [k - 1 for k in mutant.lengths]

    def agrees(integrator: Any) -> bool:
        found = integrate(jax.random.key(seed), integrator, of, lengths=mutant.lengths, samples=mutant.samples)
        return compare(found, known.values[at], known.errors[at], level).agrees

    return agrees(mutant.right), not agrees(mutant.subject)


def draw(data: xr.Dataset) -> Figure:
    """For each scene and integrator, the worst pixel, and the error of the total that would have been found."""
    excess, detectable = data.excess.to_numpy(), data.detectable.to_numpy()
    figure, axes = plt.subplots(figsize=(7.0, 0.36 * len(excess) + 1.3))
    axes.imshow(np.minimum(excess, 1.2), aspect="auto", cmap="Blues", vmin=0, vmax=2.0)
    for (row, column), value in np.ndenumerate(excess):
        blind = bool(data.blind[row, column])
        text = "blind" if blind else f"{value:.2f}\n{detectable[row, column]:.1%}"
        axes.text(column, row, text, ha="center", va="center", fontsize=6, color="black" if value <= 1 else "C3")
    axes.set_xticks(range(excess.shape[1]), [str(n).replace("_", "\n") for n in data.integrator.to_numpy()], fontsize=6)
    axes.set_yticks(range(excess.shape[0]), [str(n).replace("_", " ") for n in data.scene.to_numpy()], fontsize=6)
    axes.tick_params(which="both", length=0)
    axes.minorticks_off()
    axes.set_title("worst pixel, in radii of the test (over 1 fails); smallest error of the total found", fontsize=7)
    return figure


def table(data: xr.Dataset) -> Table:
    """The same numbers."""
    result = Table("scene", *[str(n) for n in data.integrator.to_numpy()], title="flatland_images", box=SIMPLE)
    for row, name in enumerate(data.scene.to_numpy()):
        cells = [
            "blind" if float(data.blind[row, c]) else f"{float(data.excess[row, c]):.2f} {float(d):.1%}"
            for c, d in enumerate(data.detectable[row])
        ]
        result.add_row(str(name), *cells)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Right integrators agree with the exact images; wrong ones do not; light tracing says what it can not see."""
    excess, seen = data.excess.to_numpy(), data.blind.to_numpy() == 0
    detectable, twins = data.detectable.to_numpy()[seen], data.twin.to_numpy()[seen]
    caught, right = data.caught.to_numpy(), data.right_passes.to_numpy()
    missed = [str(m) for m in data.mutant.to_numpy()[~(caught & right)]]
    shape = f"{data.sizes['scene']} scenes, {data.sizes['integrator']} integrators, {int(data.lengths)} lengths"
    found = f"{np.median(detectable):.2%} of a pixel's total in the median image, {np.max(detectable):.2%} at most"
    return [
        Claim(
            "flatland.images",
            f"Per pixel, per length and in total, in absolute scale, images are exact: {shape}",
            "Veach 1997; Hachisuka et al. 2014, eqs. 16 to 20; Bitterli et al. 2017, eqs. 8 to 14",
            "holds" if excess.max() <= 1 else "fails",
            "holds",
            f"worst pixel at {excess.max():.2f} of what would have failed",
            f"family-wise {LEVEL:g}, empirical Bernstein; would have found {found}",
        ),
        Claim(
            "flatland.mutants",
            f"Each of {len(caught)} wrong integrators is caught, and is right without its mistake",
            "ours; origins in mcmc1d.flatland.mutants",
            "fails" if missed else "holds",
            "holds",
            f"{int((caught & right).sum())} of {len(caught)}" + (f"; not {', '.join(missed)}" if missed else ""),
            f"one technique's share left out is caught in {int(twins.sum())} of {twins.size} images",
        ),
    ]
