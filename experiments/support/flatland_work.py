"""What an experiment in the plane measures of every integrator, of each scene and path length, and draws of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from experiments.support.flatland_equal import WHOLE, root
from experiments.support.flatland_glossy import marked, with_glossy_door
from experiments.support.flatland_rivals import INTEGRATORS, Rivals, dark, everyone
from experiments.support.framework import between
from mcmc1d.flatland import Paths, Scene
from mcmc1d.flatland.integrators import BidirectionalPathTracing
from mcmc1d.flatland.reference import Reference, Resolution, image

GLOSSY = Resolution(order=4, points=6, smallest=1e-2, lobe=3.0)
"""Coarser than the library's, which takes minutes: its error, which is known, is far below that of the chains."""


@dataclass(frozen=True)
class Work:
    """What two experiments have in common; each adds its scenes."""

    shortest: int = 4
    """Edges of the shortest paths."""
    longest: int = 4
    """Of the longest; the usage of the techniques is shown for these."""
    pixels: int = 16
    sigma: float = 0.05
    large: float = 0.1
    spent_on_b: float = 0.2
    """Of a chain's rays, where b is not known."""
    runs: int = 512
    """Runs of one chain for each path length, whose mean squared error is shown."""
    first: int = 64
    """Mutations by MMLT of each length, after whose rays images are looked at first."""
    doublings: int = 6
    samples: int = 2**21
    """Independent ones of each length, from which the error of fewer follows."""


def exact(scene: Scene, edges: int) -> Reference:
    """The reference images of up to so many edges."""
    return image(scene, edges, GLOSSY if scene.glossy else None)


def _members(scene: Scene, regions: bool) -> dict[str, np.ndarray]:
    whole = {WHOLE: np.ones(scene.sensor.pixels, bool)}
    return whole | marked(scene) if regions else whole


def _rays(config: Work, edges: int) -> np.ndarray:
    """Those of MMLT's mutations."""
    return edges * config.first * 2 ** np.arange(config.doublings + 1)


def measured(
    name: str,
    edges: int,
    config: Work,
    seed: int,
    *,
    regions: bool = False,
    integrators: tuple[str, ...] = INTEGRATORS,
) -> dict[str, Any]:
    """One scene and path length: what JSON can hold of it. `regions`: errors are also of the pixels that see gloss."""
    scene = with_glossy_door()[name]().with_pixels(config.pixels)
    reference = exact(scene, edges)
    paths, values = Paths(scene, edges), reference.values[-1]
    rivals = Rivals(
        paths,
        BidirectionalPathTracing().target(paths),
        values,
        np.stack(list(_members(scene, regions).values())),
        _rays(config, edges),
        config.sigma,
        config.large,
        config.runs,
        config.samples,
        integrators,
    )
    key = jax.random.fold_in(jax.random.key(seed), edges + 100 * sum(name.encode()))
    found = everyone(rivals, key) if values.max() > 1e-12 else dark(rivals)
    found |= {"reference": values, "reference_error": reference.errors[-1]}
    return {part: np.asarray(value).tolist() for part, value in found.items()}


def gathered(
    found: Sequence[dict[str, Any]],
    names: Sequence[str],
    config: Work,
    *,
    regions: bool = False,
    integrators: tuple[str, ...] = INTEGRATORS,
) -> xr.Dataset:
    """What `measured` found of each scene and length, scene by scene."""
    lengths = between(config.shortest, config.longest)
    each = [_dataset(one) for one in found]
    rows = [each[first : first + len(lengths)] for first in range(0, len(each), len(lengths))]
    # Of a scene and length with fewer techniques than another the rest is NaN.
    data = xr.concat([xr.concat(row, "edges", join="outer") for row in rows], "scene", join="outer")
    scenes = [with_glossy_door()[name]().with_pixels(config.pixels) for name in names]
    parts = [_members(scene, regions) for scene in scenes]
    return data.assign_coords(
        scene=list(names), edges=lengths, integrator=list(integrators), part=list(parts[0])
    ).assign(
        member=(("scene", "part", "pixel"), np.stack([np.stack(list(part.values())) for part in parts])),
        rays=(("edges", "budget"), np.stack([_rays(config, k) for k in lengths])),
        runs=config.runs,
        spent_on_b=config.spent_on_b,
    )


def _dataset(found: dict[str, Any]) -> xr.Dataset:
    dims = {
        "mse": ("integrator", "budget", "part", "run"),
        **dict.fromkeys(("value", "error"), ("integrator", "pixel")),
        **dict.fromkeys(("mean_error", "scale", "b_cost"), ("integrator",)),
        **dict.fromkeys(("reference", "reference_error"), ("pixel",)),
        **dict.fromkeys(("effective", "effective_error"), ("chain",)),
        **dict.fromkeys(("contribution", "contribution_error", "usage", "usage_error"), ("technique",)),
        **dict.fromkeys(("contribution_film", "usage_film", "placed_film"), ("technique", "pixel")),
    }
    data = xr.Dataset({name: (dims[name], np.asarray(value)) for name, value in found.items()})
    data["mse"] = data.mse.astype(np.float32)  # most of what is kept
    return data.assign_coords(technique=np.arange(data.sizes["technique"])) if "technique" in data.sizes else data


STYLES: dict[str, dict[str, Any]] = {
    "PT": {"color": "C3", "linestyle": ":", "marker": "x", "zorder": 3},
    "LT": {"color": "0.55", "linestyle": "--", "marker": "+"},
    "BDPT": {"color": "black", "linestyle": "-"},
    "PSSMLT, sum": {"color": "C1", "linestyle": "-"},
    "PSSMLT, max": {"color": "C1", "linestyle": "--"},
    "MLT": {"color": "C2", "linestyle": "-."},
    "MMLT": {"color": "C0", "linestyle": "-"},
    "MMLT, any technique": {"color": "C0", "linestyle": "--"},
}
"""Path and light tracing, which may fall together, have marks as well."""


def draw_errors(panel: Axes, rays: np.ndarray, squares: xr.DataArray) -> None:
    """Each integrator's RMS error against rays, in per cent, with a band of 95 %."""
    for who, style in STYLES.items():
        if who not in squares.integrator:
            continue
        middle, low, high = root(squares.sel(integrator=who).to_numpy())
        panel.fill_between(rays, 100 * low, 100 * high, color=style["color"], alpha=0.2, linewidth=0)
        panel.plot(rays, 100 * middle, markersize=3, label=who, **style)
    panel.set(xscale="log", yscale="log")
    panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    panel.yaxis.set_major_formatter(ScalarFormatter())
    panel.yaxis.set_minor_formatter(NullFormatter())


__all__ = ["STYLES", "Work", "draw_errors", "exact", "gathered", "measured"]
