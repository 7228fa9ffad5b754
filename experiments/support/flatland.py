"""Pictures of flatland: scenes as line drawings that a paper's column can hold, and paths on them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from mcmc1d.flatland import Bidirectional, Light, Material, Paths, Pinhole, Scene
from mcmc1d.flatland.plane import cross
from mcmc1d.numerics import cast
from mcmc1d.types import Array

# Okabe and Ito's colours; what they tell apart is also told apart by width and dashes, for print without colour. The
# order is the legend's.
_STYLES: dict[str, dict[str, Any]] = {
    "black": {"colors": "0.6", "linewidths": 0.8},
    "Lambert": {"colors": "black", "linewidths": 0.8},
    "glossy": {"colors": "#009E73", "linewidths": 1.3, "linestyles": [(0, (2.5, 0.7))]},
    "mirror": {"colors": "#0072B2", "linewidths": 1.6},
    "lamp": {"colors": "#E69F00", "linewidths": 3.2},
}
_SHADE = "0.85"
_SENSOR = "#CC79A7"


def draw_scene(axes: Axes, scene: Scene, *, legend: bool = True) -> None:
    """Draw a scene's segments, a shade on the black back of each, and its sensor, to scale and without axes.

    A segment is drawn as what it scatters most of; where it emits, a thick warm line lies under that. A pinhole is a
    point with what it sees; a wall sensor is a band before its segment's front.
    """
    size = float(np.ptp(scene.ends.reshape(-1, 2), axis=0).max())
    backs = list(_backs(scene.ends, 0.012 * size))
    axes.add_collection(PolyCollection(backs, facecolors=_SHADE, edgecolors="none", zorder=1))
    kinds = np.array([_kind(segment.material) for segment in scene.segments])
    emits = np.array([segment.material.emission > 0 for segment in scene.segments])
    thinner = min(1.0, (60 / len(kinds)) ** 0.25)  # small things stay apart in a scene of many
    shown = []
    for order, (kind, style) in enumerate(_STYLES.items()):
        here = emits if kind == "lamp" else kinds == kind
        if here.any():
            drawn = {**style, "linewidths": thinner * style["linewidths"], "capstyle": "butt"}
            zorder = 2 if kind == "lamp" else 3 + 0.1 * order
            axes.add_collection(LineCollection(scene.ends[here].tolist(), zorder=zorder, **drawn))
            shown.append(_entry(kind, style))
    shown.append(_draw_sensor(axes, scene, size))
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.03)
    axes.set_axis_off()
    if legend:
        axes.legend(
            handles=shown, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=len(shown), columnspacing=1.0,
            handletextpad=0.4, borderaxespad=0.2, handlelength=1.8,
        )  # fmt: skip


def draw_paths(axes: Axes, paths: np.ndarray, *, color: Any = "#D55E00", linewidth: float = 0.5, **style: Any) -> None:
    """Draw paths, of shape (paths, vertices, 2), as polylines over a scene; a vertex of NaN ends its path.

    `color`: one, or one for each path. `style`: of matplotlib's `LineCollection`.
    """
    paths = np.asarray(paths, np.float64)
    if paths.ndim != 3 or paths.shape[-1] != 2:
        raise ValueError(f"draw_paths: paths have the shape (paths, vertices, 2), not {paths.shape}")
    ended = np.cumsum(np.isnan(paths).any(-1), axis=1) > 0
    lines = [path[~end] for path, end in zip(paths, ended, strict=True)]
    axes.add_collection(LineCollection(lines, colors=color, linewidths=linewidth, **{"zorder": 5, **style}))


def draw_techniques(scene: Scene, edges: int, count: int, seed: int) -> Figure:
    """A scene, and beside it what each technique (s, t) makes of paths with so many edges that carry light.

    At most `count` paths of each; a technique that made none among 2^12 says so.
    """
    family = Bidirectional(Paths(scene, edges))
    u = np.random.default_rng(seed).random((len(family.lengths), _TRIES, family.dim_u))
    with jax.enable_x64(True):
        points, lit = (np.asarray(part) for part in _walked(family, jnp.asarray(u)))
    columns = min(3, len(family.lengths) + 1)
    rows = -(-(len(family.lengths) + 1) // columns)
    width, height = np.ptp(scene.ends.reshape(-1, 2), axis=0)
    # As high as the scene is, with room for a title and a legend.
    figure, axes = plt.subplots(
        rows, columns, figsize=(7.0, rows * (7.0 / columns * min(height / width, 1.5) + 0.6)), squeeze=False
    )
    draw_scene(axes.flat[0], scene)
    axes.flat[0].set_title(scene.name)
    for panel, t, made, carries in zip(axes.flat[1:], family.lengths, points, lit, strict=False):
        draw_scene(panel, scene, legend=False)
        draw_paths(panel, made[carries][:count], alpha=0.6)
        share = f"{carries.mean():.1%} lit" if carries.any() else "none lit"
        panel.set_title(f"s = {edges + 1 - t}, t = {t}: {share}")
    for panel in axes.flat[len(family.lengths) + 1 :]:
        panel.axis("off")
    return figure


_TRIES = 2**12


@eqx.filter_jit
def _walked(family: Bidirectional, u: Array) -> tuple[Array, Array]:
    """The vertices of the paths that each technique makes, and which carry light."""
    family = cast(family, u.dtype)
    light = Light(family.paths)

    def one(index: Array, u: Array) -> tuple[Array, Array]:
        x = family.forward(index, u)[0]
        return family.paths.vertices(x), jnp.isfinite(light.log_f(x))

    return jax.vmap(jax.vmap(one, in_axes=(None, 0)))(jnp.arange(len(family.lengths)), u)


def _kind(material: Material) -> str:
    lobes = {"Lambert": material.lambert, "glossy": material.glossy, "mirror": material.mirror}
    if material.reflectance > 0:
        return max(lobes, key=lambda lobe: lobes[lobe])
    return "lamp" if material.emission > 0 else "black"


def _entry(label: str, style: dict[str, Any]) -> Line2D:
    dashes = style.get("linestyles", ["-"])[0]
    return Line2D([], [], color=style["colors"], linewidth=style["linewidths"], linestyle=dashes, label=label)


def _normals(ends: np.ndarray) -> np.ndarray:
    along = ends[:, 1] - ends[:, 0]
    return np.stack([-along[:, 1], along[:, 0]], -1) / np.hypot(*along.T)[:, None]


def _backs(ends: np.ndarray, depth: float) -> np.ndarray:
    """A strip behind each segment, of shape (segments, 4, 2): of `depth`, less in what is thin."""
    behind = -_normals(ends)
    free = _reach(ends, ends.mean(1), behind)
    behind *= np.minimum(depth, 0.5 * free)[:, None]
    return np.stack([ends[:, 0], ends[:, 1], ends[:, 1] + behind, ends[:, 0] + behind], 1)


def _draw_sensor(axes: Axes, scene: Scene, size: float) -> Patch | Line2D:
    sensor, segment = scene.sensor, scene.sensor_segment
    if segment is not None:
        start, end = scene.ends[segment]
        up = 0.025 * size * _normals(scene.ends)[segment]
        band = [start.tolist(), end.tolist(), (end + up).tolist(), (start + up).tolist()]
        axes.add_patch(Polygon(band, facecolor=_SENSOR, alpha=0.35, edgecolor="none", zorder=1.5))
        return Patch(facecolor=_SENSOR, alpha=0.35, label="wall sensor")
    assert isinstance(sensor, Pinhole)
    at = np.asarray(sensor.position, np.float64)
    middle = np.arctan2(sensor.direction[1], sensor.direction[0])
    angles = np.linspace(middle - sensor.half_angle, middle + sensor.half_angle, 361)
    rays = np.stack([np.cos(angles), np.sin(angles)], -1)
    seen = at + _reach(_framed(scene.ends, at), np.broadcast_to(at, rays.shape), rays)[:, None] * rays
    fan = Polygon([at.tolist(), *seen.tolist()], facecolor=_SENSOR, alpha=0.15, edgecolor="none", zorder=0.5)
    axes.add_patch(fan)
    for edge in (seen[0], seen[-1]):
        axes.plot(*np.stack([at, edge]).T, color=_SENSOR, linewidth=0.5, zorder=0.6)
    axes.plot(*at, "o", color=_SENSOR, markersize=3, zorder=6)
    return Line2D([], [], color=_SENSOR, marker="o", markersize=3, linewidth=0.5, label="pinhole")


def _framed(ends: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The segments and the sides of their bounding box: where the drawing of a ray ends that meets nothing."""
    points = np.concatenate([ends.reshape(-1, 2), at[None]])
    low, high = points.min(0), points.max(0)
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return np.concatenate([ends, np.stack([corners, np.roll(corners, -1, 0)], 1)])


def _reach(ends: np.ndarray, origins: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """How far each ray goes before it meets a segment, from its origin on; infinite where it meets none."""
    along, gap = ends[:, 1] - ends[:, 0], ends[None, :, 0] - origins[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = cross(rays[:, None], along[None])
        far, place = cross(gap, along[None]) / across, cross(gap, rays[:, None]) / across
    hit = (far > 1e-9) & (place >= 0) & (place <= 1)
    return np.where(hit, far, np.inf).min(1)


__all__ = ["draw_paths", "draw_scene"]
