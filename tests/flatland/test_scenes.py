"""The catalogue: what each scene is for is checked by a small path tracer of its own, and no ray sees a back."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from experiments.support.flatland import draw_paths, draw_scene
from mcmc1d.flatland.plane import cross
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Wall
from mcmc1d.flatland.scenes import catalogue, office, polygon

SCENES = {name: make() for name, make in catalogue().items()}
OPEN = {"open", "occluder", "mirror_caustic"}
LOBES = ("lambert", "glossy", "mirror")


def vectors(angles):
    return np.stack([np.cos(angles), np.sin(angles)], -1)


def normals(scene):
    along = scene.ends[:, 1] - scene.ends[:, 0]
    return np.stack([-along[:, 1], along[:, 0]], -1) / np.hypot(*along.T)[:, None]


def cast(scene, origins, rays, own):
    """The segment that each ray meets first, -1 for none, and where; not the one it starts from, `own`."""
    along, gap = scene.ends[:, 1] - scene.ends[:, 0], scene.ends[None, :, 0] - origins[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = cross(rays[:, None], along[None])
        far, place = cross(gap, along[None]) / across, cross(gap, rays[:, None]) / across
    far = np.where((far > 0) & (place >= 0) & (place <= 1), far, np.inf)
    starts = np.flatnonzero(own >= 0)
    far[starts, own[starts]] = np.inf
    first, nearest = far.argmin(1), far.min(1)
    hit = np.isfinite(nearest)
    return np.where(hit, first, -1), origins + np.where(hit, nearest, 0)[:, None] * rays


def sees_fronts(scene, per_segment, rng):
    """Rays from random points of all fronts: whether each meets a front, a back (False), or nothing (front, missed)."""
    own = np.repeat(np.arange(len(scene.segments)), per_segment)
    share = rng.uniform(0.001, 0.999, own.size)[:, None]
    origins = scene.ends[own, 0] * (1 - share) + scene.ends[own, 1] * share
    turn = rng.uniform(-1.57, 1.57, own.size) + np.arctan2(*normals(scene)[own].T[::-1])
    rays = vectors(turn)
    first, _ = cast(scene, origins, rays, own)
    return (first < 0) | (np.sum(rays * normals(scene)[first], -1) < 0), first < 0


@dataclass
class Traced:
    """Paths from the sensor: pixel of each, what each carries by its edges (paths, edges), and the lobes it took."""

    pixels: np.ndarray
    carried: np.ndarray
    lobes: np.ndarray
    backs: int

    def image(self, count):
        """Of shape (edges, pixels): the paths with exactly that many edges."""
        return np.stack([self.carried[self.pixels == j].mean(0) for j in range(count)], -1)


def start(scene, paths, rng):
    sensor, film = scene.sensor, rng.permutation((np.arange(paths) + rng.random(paths)) / paths)
    pixels = np.minimum((film * sensor.pixels).astype(int), sensor.pixels - 1)
    if isinstance(sensor, Pinhole):
        phi = np.arctan((2 * film - 1) * np.tan(sensor.half_angle))
        rays = vectors(np.arctan2(sensor.direction[1], sensor.direction[0]) + phi)
        return pixels, np.broadcast_to(sensor.position, rays.shape), rays, np.full(paths, -1), np.ones(paths)
    k = scene.sensor_segment
    at = scene.ends[k, 0] + film[:, None] * (scene.ends[k, 1] - scene.ends[k, 0])
    theta = np.arcsin(rng.uniform(-1, 1, paths))  # proportional to the cosine, whose integral is 2
    rays = vectors(np.arctan2(*normals(scene)[k][::-1]) + theta)
    return pixels, at, rays, np.full(paths, k), np.full(paths, 2.0)


def glossy_angles(exponents, rng):
    """alpha with the density cos^n(alpha) / I_n on (-pi/2, pi/2), by a table of the cumulative density."""
    grid, alpha = np.linspace(-np.pi / 2, np.pi / 2, 4001), np.zeros(len(exponents))
    for n in np.unique(exponents):
        here = exponents == n
        mass = np.cumsum(np.cos(grid) ** int(n))
        alpha[here] = np.interp(rng.random(here.sum()), mass / mass[-1], grid)
    return alpha


def trace(scene, paths, edges, seed=0):
    rng = np.random.default_rng(seed)
    pixels, at, rays, own, weight = start(scene, paths, rng)
    table = {key: np.array([getattr(s.material, key) for s in scene.segments]) for key in (*LOBES, "emission")}
    exponents = np.array([s.material.exponent for s in scene.segments])
    carried, lobes, backs = np.zeros((paths, edges)), np.full((paths, edges), -1), 0
    for edge in range(edges):
        own, at = cast(scene, at, rays, own)
        normal = normals(scene)[own]
        cos_in = -np.sum(rays * normal, -1)
        backs += int(np.sum((own >= 0) & (cos_in <= 0) & (weight > 0)))
        weight = np.where((own >= 0) & (cos_in > 0), weight, 0)
        carried[:, edge] = weight * table["emission"][own]
        shares = np.cumsum([table[lobe][own] for lobe in LOBES], 0)
        taken = np.sum(rng.random(paths) * shares[-1] >= shares[:-1], 0)
        lobes[:, edge] = np.where(weight > 0, taken, -1)
        theta_in = np.arctan2(cross(normal, -rays), cos_in)
        alpha = glossy_angles(exponents[own], rng)
        theta = np.choose(taken, [np.arcsin(rng.uniform(-1, 1, paths)), alpha - theta_in, -theta_in])
        cos_out = np.cos(theta)
        lost = np.where(taken == 1, cos_out / np.maximum(np.maximum(cos_in, cos_out), 1e-300), 1)
        weight = weight * shares[-1] * np.where((np.abs(theta) < np.pi / 2) & (cos_in > 0), lost, 0)
        rays = vectors(np.arctan2(normal[:, 1], normal[:, 0]) + theta)
    return Traced(pixels, carried, lobes, backs)


PATHS = {"lab": 2000, "office": 2000, "mirror_caustic": 100_000}  # the last one's lamp is small, and hit by chance
TRACED = {name: trace(s, PATHS.get(name, 16_000), 8) for name, s in SCENES.items()}
IMAGES = {name: traced.image(SCENES[name].sensor.pixels) for name, traced in TRACED.items()}
EACH = pytest.mark.parametrize("name", SCENES)


# --- every scene ----------------------------------------------------------------------------------------------------


def test_the_catalogue_has_the_scenes_that_the_experiments_name():
    small = {"furnace", "open", "occluder", "box", "door", "glossy_corner", "three_rooms", "mirror_caustic"}
    assert set(SCENES) == small | {"lab", "office"}
    assert all(s.name == name for name, s in SCENES.items())
    assert sum(isinstance(s.sensor, Wall) for s in SCENES.values()) == 2
    assert all(s.sensor.pixels == 16 for s in SCENES.values())


@EACH
def test_no_ray_sees_a_back_and_none_leaves_a_closed_room(name):
    fronts, missed = sees_fronts(SCENES[name], 4 if len(SCENES[name].segments) > 100 else 300, np.random.default_rng(1))
    assert fronts.all()
    assert TRACED[name].backs == 0
    assert missed.any() == (name in OPEN)


@pytest.mark.parametrize(("name", "k"), [("box", 1), ("door", 15), ("mirror_caustic", 5), ("open", 1)])
def test_a_segment_turned_over_is_seen_from_its_back(name, k):
    segments = list(SCENES[name].segments)
    segments[k] = replace(segments[k], start=segments[k].end, end=segments[k].start)
    fronts, _ = sees_fronts(Scene(name, tuple(segments), SCENES[name].sensor), 300, np.random.default_rng(1))
    assert not fronts.all()


@EACH
def test_light_reaches_the_sensor_and_more_than_one_of_its_pixels(name):
    image = IMAGES[name].sum(0)
    assert np.isfinite(image).all()
    assert np.count_nonzero(image) >= 12


@EACH
def test_coordinates_are_simple_numbers_and_nothing_is_tiny(name):
    ends = SCENES[name].ends
    assert np.allclose(ends, np.round(ends, 3), rtol=0, atol=1e-12)
    assert 1 <= np.ptp(ends.reshape(-1, 2), axis=0).max() <= 10
    assert SCENES[name].lengths.min() > 0.02


# --- what each is for -----------------------------------------------------------------------------------------------


def test_the_furnace_glows_evenly():
    assert np.allclose(IMAGES["furnace"], 0.5 ** np.arange(8)[:, None], rtol=0, atol=1e-12)
    kinds = {s.material for s in SCENES["furnace"].segments}
    assert any(m.mirror == 0.5 for m in kinds)
    assert any(m.lambert == 0.5 for m in kinds)


def test_the_tracer_agrees_with_the_closed_form_of_an_unoccluded_lamp():
    """Over the floor, E = L_e (sin b - sin a) at each place; the blocker taken away."""
    bare = Scene("bare", SCENES["occluder"].segments[:2], Wall("floor"))
    x = (np.arange(16) + 0.5) * 5 / 16
    exact = 2 * ((3 - x) / np.hypot(3 - x, 3) - (2 - x) / np.hypot(2 - x, 3))
    found = trace(bare, 160_000, 1).image(16)[0]
    assert np.allclose(found, exact, rtol=0.15)  # a pixel's standard error is under 4 %, its midpoint's error 1 %


def test_the_glossy_lobe_returns_the_known_share():
    """Of an even sky, a glossy wall of exponent 20 returns 0.976 rho at normal incidence."""
    wall, sky = Material(glossy=1.0), Material(1.0)
    far = 1e4
    room = polygon([(-far, 0.0), (far, 0.0), (far, far), (-far, far)], [wall, sky, sky, sky])
    found = trace(Scene("sky", tuple(room), Pinhole((0.0, 1.0), (0.0, -1.0), 1e-6, 1)), 40_000, 2).image(1)[1, 0]
    assert abs(found - 0.976) < 0.002


def test_the_blocker_has_an_umbra_between_two_penumbrae():
    direct = IMAGES["occluder"][0]
    assert np.all(direct[4:8] == 0)
    assert np.all(direct[[0, 1, 11, 12, 13, 14, 15]] > 0.1)


def test_no_light_enters_the_cameras_room_directly():
    """The door's first light has touched two walls; it falls on every pixel later."""
    image = IMAGES["door"]
    assert np.all(image[:2] == 0)
    assert np.all(image[2:].sum(0) > 0)
    lamp = SCENES["door"].segments[0]
    for share in np.linspace(0.01, 0.99, 50):
        at = np.asarray(lamp.start) * (1 - share) + np.asarray(lamp.end) * share
        rays = vectors(np.linspace(-np.pi, 0, 2002)[1:-1])
        _, where = cast(SCENES["door"], np.broadcast_to(at, rays.shape), rays, np.zeros(2000, int))
        assert where[:, 0].min() > 2.7  # the door's inner face


def test_in_the_glossy_corner_light_comes_by_glossy_walls():
    traced = TRACED["glossy_corner"]
    assert traced.carried[:, 0].sum() == 0
    twice = (traced.lobes[:, 0] == 1) & (traced.lobes[:, 1] == 1)
    assert traced.carried[twice, 2].sum() > 0.5 * traced.carried.sum()


def test_three_rooms_are_passed_by_three_edges_at_least():
    assert np.all(IMAGES["three_rooms"][:2] == 0)
    assert np.all(IMAGES["three_rooms"][2:].sum(0) > 0)


def test_the_mirror_throws_a_caustic_and_paths_go_mirror_floor_mirror():
    image, traced = IMAGES["mirror_caustic"], TRACED["mirror_caustic"]
    assert np.all(image[0] == 0)
    assert image[1, 8:12].sum() > 0.99 * image[1].sum() > 0
    assert np.argmax(image[1]) in (9, 10)
    # Edges: from the sensor to a mirror, to the floor, to a mirror, to the lamp.
    path = (traced.lobes[:, :3] == [2, 0, 2]).all(1)
    assert np.count_nonzero(traced.carried[path, 3]) > 20


def test_the_lab_has_many_small_lamps():
    lamps = [s for s in SCENES["lab"].segments if s.material.emission > 0]
    assert len(lamps) == 33
    assert max(s.length for s in lamps) < 0.11
    assert max(s.material.emission for s in lamps) / min(s.material.emission for s in lamps) > 10


def test_the_office_is_large_and_the_same_each_time():
    assert len(SCENES["office"].segments) == 799
    assert office() == SCENES["office"]
    assert {lobe for s in SCENES["office"].segments for lobe in LOBES if getattr(s.material, lobe) > 0} == set(LOBES)


# --- drawing --------------------------------------------------------------------------------------------------------


@EACH
def test_a_drawing_holds_every_segment_and_names_what_is_in_it(name):
    figure = Figure()
    axes = figure.subplots()
    draw_scene(axes, SCENES[name])
    lines = [c for c in axes.collections if isinstance(c, LineCollection)]
    drawn = {tuple(map(tuple, line)) for c in lines for line in c.get_segments()}
    assert drawn == {(s.start, s.end) for s in SCENES[name].segments}
    shades = next(c for c in axes.collections if isinstance(c, PolyCollection)).get_paths()
    middles = np.array([path.vertices[:4].mean(0) for path in shades])
    assert np.all(np.sum((middles - SCENES[name].ends[:, 0]) * normals(SCENES[name]), -1) < 0)  # on the backs
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert "lamp" in labels
    assert ("mirror" in labels) == (name in ("furnace", "mirror_caustic", "office"))
    assert labels[-1] == ("pinhole" if isinstance(SCENES[name].sensor, Pinhole) else "wall sensor")


def test_paths_end_where_they_are_lost():
    axes = Figure().subplots()
    draw_paths(axes, np.array([[[0, 0], [1, 1], [2, 0]], [[0, 0], [np.nan, np.nan], [3, 3]]]))
    assert [len(line) for line in axes.collections[0].get_segments()] == [3, 1]
    with pytest.raises(ValueError, match=r"\(paths, vertices, 2\), not \(3, 2\)"):
        draw_paths(axes, np.zeros((3, 2)))
