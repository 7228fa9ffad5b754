"""Hoberock and Hart 2010, table 1, in the plane: six algorithms at equal rays, with all of its columns.

What differs from the paper:

- three of its four regimes: `box` for the Cornell box, `door` and `three_rooms` for the dark room, `lab` for the lab;
  the quick profile has `box` and `door`. Not the head in glass, seen by caustics alone;
- paths of one length, 3 to 5 edges, where the paper ends paths of any length by Russian roulette;
- path tracing, and BDPT in `door` and `three_rooms`, both with the power heuristic; "path" is the same, with one
  technique at random for each path, where BDPT tries all;
- shadow rays that are blocked, of those that are cast, by independent paths and by proposals; the paper: of paths;
- 32 pixels and 2^13 paths or mutations a run, 24 to 33 thousand rays (paper profile: 2^15), by 8 chains that start
  exactly, with b known, for 48 to 554 million rays;
- large steps with probability 0.1 (the paper: 0.5 in the Cornell box, 0.001 elsewhere), small ones normal with 0.05;
- two-stage: a test image of a sixteenth of the work, at a quarter of the resolution (the paper: 1e6 rays, of 50 to 500
  million, 0.2 to 2 %);
- the image's mean is shown at 50 cd/m^2, of which the paper says nothing;
- errors are of many runs, to the exact image; those of the paper are of one, to a long run of MLT.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import jax
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.table import Table

from experiments.support.flatland_held import FACTORS, LEVEL, held
from experiments.support.flatland_stages import Contest, Images, pooled
from experiments.support.flatland_table1 import REGIMES, claims
from experiments.support.flatland_table1_draw import draw_table1, table1
from experiments.support.framework import Claim, chosen
from experiments.support.stage_methods import BRIGHT, METHODS, PAPER
from experiments.support.sweep import Sweep
from mcmc1d.checks import require
from mcmc1d.flatland.integrators import BidirectionalPathTracing, PathTracing
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene
from mcmc1d.perception import density_statistics, error, visual_error
from mcmc1d.weights import Power


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    scenes: str = "box door"
    pixels: int = 32
    runs: int = 32
    at_once: int = 16
    """Runs that one program does side by side."""
    samples: int = 2**13
    """Paths and mutations of each run: rays, divided by the edges of a path."""
    chains: int = 8
    """Of each run."""
    sigma: float = 0.05
    large: float = 0.1
    length: int = 100
    """Of a chain of ERPT, as in the paper."""
    shadows: int = 2**9
    """Proposals of each run that are looked at for their shadow rays."""
    held_chains: int = 2**13
    """Of MLT's images, in one stage or more, that are held to the exact one apart from the runs."""
    held_samples: int = 0
    """Mutations of each of those; none is made of none: bounds tell nothing of one that is cheap."""


PROFILES = {
    "quick": Config(),
    "paper": Config(
        scenes="box lab door three_rooms",
        runs=256,
        samples=2**15,
        shadows=2**11,
        held_samples=2**21,
    ),
}

LONG = True
"""Its quick profile takes more than a minute: of several experiments it is begun early."""

_TRACED, _JOINED = PathTracing(Power()), BidirectionalPathTracing(Power())
SCENES = {
    "box": (3, _TRACED),
    "lab": (3, _TRACED),
    "door": (4, _JOINED),
    "three_rooms": (5, _JOINED),
}
"""The edges of the paths, and what makes them."""
PARTS = ("image", "density", "acceptance", "shadow")


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Every algorithm on every scene."""
    names, whole = chosen(config.scenes, REGIMES), config.samples % (2 * config.pixels) == 0
    require(whole, f"samples are a multiple of twice the {config.pixels} pixels, not {config.samples}")
    points = [(name, method, asdict(config), seed) for name in names for method in METHODS]
    exact = dict(zip(names, progress.map("references", reference, [(n, config.pixels) for n in names]), strict=True))
    found = progress.map("algorithms", measure, [(*point, exact[point[0]]) for point in points])

    def part(of: str) -> np.ndarray:
        values = np.array([one[of] for one in found], np.float64)
        return values.reshape(len(names), len(METHODS), *values.shape[1:])

    images, density = part("image"), part("density")
    truth = np.array([exact[name][0] for name in names])
    moments = density_statistics(density)
    columns = {
        "shadow": part("shadow"),
        "acceptance": part("acceptance"),
        **moments._asdict(),
        "error": error(images, truth[:, None, None]),
        "visual": visual_error(images, truth[:, None, None], (BRIGHT / truth.mean(-1))[:, None, None, None]),
    }
    cells = ("scene", "algorithm", "run")
    return xr.Dataset(
        {
            **{name: (cells, value) for name, value in columns.items()},
            "image": ((*cells, "pixel"), images),
            "density": ((*cells, "pixel"), density),
            "exact": (("scene", "pixel"), truth),
            "rays": (("scene", "algorithm"), part("rays")),
            "excess": ((*cells[:2], "factor"), part("excess")),
            "detectable": (cells[:2], part("detectable")[..., 0]),
            "held_chains": config.held_chains,
        },
        {"scene": names, "algorithm": list(METHODS), "factor": list(FACTORS)},
    )


def reference(name: str, pixels: int) -> tuple[list[float], list[float]]:
    """The exact image of the scene's path length, and its errors."""
    found = image(scene(name).with_pixels(pixels), SCENES[name][0])
    return found.values[-1].tolist(), found.errors[-1].tolist()


def measure(
    name: str, method: str, fields: dict[str, Any], seed: int, exact: tuple[list[float], list[float]]
) -> dict[str, Any]:
    """All runs of one algorithm on one scene, and an image held to the exact one: what JSON can hold of them."""
    c, (edges, of) = Config(**fields), SCENES[name]
    shown, (values, errors) = scene(name).with_pixels(c.pixels), np.array(exact)
    common = values, c.at_once, c.samples, c.chains, c.sigma, c.large, c.length, c.shadows
    contest = Contest(shown, edges, of, *common)
    key = jax.random.fold_in(jax.random.key(seed), METHODS.index(method) + 100 * sum(name.encode()))
    made: Callable[..., Images] = {"path": contest.path, "ERPT": contest.redistribution}.get(
        method, lambda key: contest.staged(key, method)
    )
    require(c.runs % c.at_once == 0, f"runs, {c.runs}, must be a multiple of at_once, {c.at_once}")
    batches = c.runs // c.at_once
    found = [made(jax.random.fold_in(key, k)) for k in range(batches)]
    rays = edges * np.mean([one.samples for one in found])
    parts = {part: np.concatenate([getattr(one, part) for one in found]).tolist() for part in PARTS}
    layers = [one.layer for one in found if one.layer is not None]
    layer = pooled(layers) if layers else None
    if layer is None and c.held_samples > 0:
        layer = contest.apart(jax.random.fold_in(key, batches), method, c.held_chains, c.held_samples)
    level = LEVEL / (len(SCENES) * len(METHODS))
    return {"rays": float(rays), **parts, **held(layer, values, errors, level)}


def draw(data: xr.Dataset) -> Figure:
    """A row a scene: the scene, a run of each over the exact image, its samples, errors; below, the table."""
    return draw_table1(data, {name: edges for name, (edges, _) in SCENES.items()})


def table(data: xr.Dataset) -> Table:
    """Table 1 with all its columns; errors over the square of the mean."""
    return table1(data)


def judge(data: xr.Dataset) -> list[Claim]:
    """What the paper says of its table, each against the runs."""
    return claims(data, PAPER)
