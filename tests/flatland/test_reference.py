"""The exact images against closed forms, against brute force, and refined; in another guise: test_reference_guises."""

import itertools
from typing import Any

import numpy as np
import pytest
from rooms import BAR, BLACK, COARSE, EYE, GREY, L_SHAPE, LAMP, SQUARE, TRIANGLE, WHITE, box, ring
from scipy.integrate import quad

from mcmc1d.flatland import reference
from mcmc1d.flatland.reference import Resolution, operators
from mcmc1d.flatland.reference.glossy import lobe, lobe_norm
from mcmc1d.flatland.reference.rays import Geometry, fan, hits
from mcmc1d.flatland.scene import Material, Pinhole, Scene, Segment, Wall

# --- rays -----------------------------------------------------------------------------------------------------------


def first_hits(segments, points, directions):
    """By brute force: for each point and direction, the nearest segment; -1 for none."""
    a = np.array([s.start for s in segments], float)
    d = np.array([s.end for s in segments], float) - a
    gap = a - points[:, None]
    across = directions[:, None, 0] * d[:, 1] - directions[:, None, 1] * d[:, 0]
    across = np.where(across == 0, 1e-300, across)
    r = (gap[..., 0] * d[:, 1] - gap[..., 1] * d[:, 0]) / across
    t = (gap[..., 0] * directions[:, None, 1] - gap[..., 1] * directions[:, None, 0]) / across
    r = np.where((t >= 0) & (t <= 1) & (r > 1e-9), r, np.inf)
    return np.where(np.isfinite(r.min(1)), r.argmin(1), -1)


def test_the_intervals_hold_what_brute_force_hits():
    extra = [*ring(BAR, WHITE, "b"), Segment((1.4, 0), (1.4, 0.5), WHITE), Segment((0.2, 1.1), (0.4, 1.3), WHITE)]
    scene = Scene("rays", box(extra=extra)[1:], EYE)  # without its floor: some rays hit nothing
    rng = np.random.default_rng(3)
    points = rng.uniform([0.05, 0.05], [1.95, 0.55], (40, 2))
    turn = rng.uniform(0, 2 * np.pi, 40)
    normals = np.stack([np.cos(turn), np.sin(turn)], -1)
    geometry = Geometry.of(scene)
    found = hits(geometry, fan(np.arange(40), points, normals, np.full(40, -1), np.pi / 2))
    for i in range(40):
        angle = rng.uniform(-np.pi / 2, np.pi / 2, 200)
        along = np.cos(angle)[:, None] * normals[i] + np.sin(angle)[:, None] * np.array([normals[i][1], -normals[i][0]])
        truth = first_hits(scene.segments, np.broadcast_to(points[i], along.shape), along)
        front = np.sum(geometry.normal[truth] * along, 1) < 0
        mine = found[found.row == i]
        inside = (angle[:, None] > mine.low) & (angle[:, None] < mine.high)
        seen = np.where(inside.any(1), mine.segment[inside.argmax(1)], -1)
        assert np.all(inside.sum(1) <= 1)
        assert np.array_equal(seen, np.where(front & (truth >= 0), truth, -1))


# --- the furnace ----------------------------------------------------------------------------------------------------

WALLS: dict[str, dict[str, Any]] = {
    "lambert": {"lambert": 0.5},
    "mirror": {"mirror": 0.5},
    "half": {"lambert": 0.3, "mirror": 0.2},
}
ROOMS = {
    "square": ring(SQUARE, BLACK),
    "L": ring(L_SHAPE, BLACK),
    "triangle": ring(TRIANGLE, BLACK),
    "inner": [*ring(SQUARE, BLACK), *ring(BAR, BLACK, "b")],
}


@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("walls", WALLS)
def test_furnace(room, walls):
    """Every length, every pixel: L_e rho^(k - 1), of radiance, and twice that of irradiance."""
    lengths = 2 if walls == "half" else 6
    glow = Material(emission=1.5, **WALLS[walls])
    segments = tuple(Segment(s.start, s.end, glow, s.name) for s in ROOMS[room])
    for sensor, factor in ((EYE, 1.0), (Wall("w1", 3), 2.0)):
        if (room, walls) == ("inner", "half") and sensor is EYE:
            continue  # the slowest
        found = reference.image(Scene("furnace", segments, sensor), lengths, COARSE)
        truth = factor * 1.5 * 0.5 ** np.arange(lengths)
        assert np.allclose(found.values, truth[:, None], rtol=1e-10, atol=0)
        assert np.allclose(found.total, factor * reference.furnace(1.5, 0.5, lengths), rtol=1e-10)


@pytest.mark.parametrize("walls", ["lambert", "mirror"])
def test_the_whole_furnace(walls):
    glow = Material(emission=1.5, **WALLS[walls])
    segments = tuple(Segment(s.start, s.end, glow, s.name) for s in ROOMS["triangle"])
    found = reference.converged(Scene("furnace", segments, Pinhole((0.7, 0.3), (1, 0.3), 0.5, 2)), COARSE)
    assert np.allclose(found.values, reference.furnace(1.5, 0.5), rtol=1e-9)
    assert found.errors.max() < 1e-8


# --- closed forms ---------------------------------------------------------------------------------------------------

FLOOR, ABOVE = ((0.0, 0.0), (2.0, 0.0)), ((1.2, 1.5), (0.4, 1.1))
SCREEN = ((0.5, 0.6), (0.9, 0.7))


def below(screens=(), pixels=1, material=WHITE):
    segments = [Segment(*FLOOR, material, "floor"), Segment(*ABOVE, LAMP), *(Segment(*s) for s in screens)]
    return Scene("lamp", tuple(segments), Wall("floor", pixels))


def rotated(points, angle):
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return [tuple(map(float, point)) for point in np.asarray(points) @ turn]


@pytest.mark.parametrize("angle", [0.05, 0.3, 0.5625, 1.7, 4.4])
def test_an_oblique_wall_in_pieces_is_as_bright_as_a_straight_one(angle):
    """Pieces that are in line but for rounding hid all else from each other: a third of the light was lost."""

    def room(angle):
        corners = rotated([(0, 0), (2, 0), (2, 2), (1.3, 2), (0.6, 2), (0, 2)], angle)
        materials = [GREY, GREY, GREY, LAMP, GREY, GREY]
        pairs = itertools.pairwise([*corners, corners[0]])
        walls = tuple(Segment(a, b, m) for (a, b), m in zip(pairs, materials, strict=True))
        eye, ahead = rotated([(0.3, 0.6), (1, 0.1)], angle)
        return Scene("pieces", walls, Pinhole(eye, ahead, 0.6, 4))

    straight, oblique = reference.image(room(0.0), 4), reference.image(room(angle), 4)
    assert np.all(np.abs(oblique.values - straight.values) <= oblique.errors + straight.errors)
    lit = straight.values > 0
    assert np.abs(oblique.values[lit] / straight.values[lit] - 1).max() < 1e-6


def test_crossed_strings():
    found = reference.image(below(), 1)
    truth = reference.irradiance_between(FLOOR, ABOVE)
    assert abs(found.values[0, 0] - truth) < 1e-13
    assert abs(found.values[0, 0] - truth) <= found.errors[0, 0]


@pytest.mark.parametrize("screens", [(), (SCREEN,), (SCREEN, ((1.1, 0.4), (1.5, 0.5)))])
def test_irradiance_by_visible_intervals(screens):
    found = reference.image(below(screens, 5), 1)
    edges = np.linspace(0, 2, 6)

    def irradiance(x):
        return reference.emitter_irradiance((x, 0), (0, 1), ABOVE, 1.0, screens)

    # Shadow lines: of the screens' ends under the lamp's ends.
    lines = [x for s in screens for p in s for q in ABOVE if 0 < (x := p[0] - p[1] * (q[0] - p[0]) / (q[1] - p[1])) < 2]
    for j, (a, b) in enumerate(itertools.pairwise(edges)):
        cuts = sorted([a, b, *(x for x in lines if a < x < b)])
        truth = sum(quad(irradiance, u, v, epsabs=1e-13)[0] for u, v in itertools.pairwise(cuts)) / (b - a)
        assert abs(found.values[0, j] - truth) < 1e-12
        assert abs(found.values[0, j] - truth) <= found.errors[0, j]


def test_radiance_of_a_lambert_wall():
    """L_o = rho / 2 E; a pixel so narrow that its mean is the value at its middle, to 1e-9."""
    scene = Scene("lamp", below((SCREEN,)).segments, Pinhole((1.7, 0.3), (-0.7, -0.3), 1e-5, 1))
    found = reference.image(scene, 2)
    truth = 0.35 * reference.emitter_irradiance((1.0, 0.0), (0, 1), ABOVE, 1.0, (SCREEN,))
    assert found.values[0, 0] == 0
    assert truth > 0.05
    assert abs(found.values[1, 0] - truth) < 1e-9


def albedo(exponent, angle):
    """The share of uniform illumination that the lobe sends back at an angle, by reciprocity of what it keeps."""
    cuts = sorted({angle, -angle})
    return quad(lambda x: lobe(exponent, angle, x) * np.cos(x), -np.pi / 2, np.pi / 2, points=cuts, epsabs=1e-12)[0]


def test_the_energy_of_a_glossy_lobe():
    """0.976 rho at the normal and 0.855 rho at 1 rad, for n = 20; the wall is seen under uniform illumination."""
    assert abs(albedo(20, 0.0) - 0.976) < 6e-4
    assert abs(albedo(20, 1.0) - 0.855) < 6e-4
    assert abs(lobe_norm(2) - np.pi / 2) < 1e-14
    room = ring([(0, 0), (4, 0), (4, 3), (0, 3)], LAMP)
    room[0] = Segment((0, 0), (4, 0), Material(emission=1.0, glossy=0.8), "w0")
    for angle in (0.0, 1.0):
        eye = Pinhole((2 - np.tan(angle), 1.0), (np.sin(angle), -np.cos(angle)), 1e-3, 1)
        found = reference.image(Scene("glossy", tuple(room), eye), 2, Resolution(order=6, smallest=0.1))
        wrong = abs(found.values[1, 0] - 0.8 * albedo(20, angle))
        assert wrong < 1e-4 * found.values[1, 0]
        assert wrong <= found.errors[1, 0]


def test_what_memory_does_not_hold_is_made_roughly_and_says_so(monkeypatch):
    """Of two glossy walls: the default would be too large, the rougher one's image is within its errors of it."""
    shiny = Material(glossy=0.9, exponent=12)
    walls = ((0.5, 0), (2, 0)), ((2.4, 0.3), (2.2, 1.4))
    lamp = Segment((1.4, 2.2), (0.6, 1.9), LAMP)
    scene = Scene("two", (*(Segment(*ends, shiny) for ends in walls), lamp), Pinhole((0.2, 0.8), (1.0, -0.75), 0.1, 1))
    fine = reference.image(scene, 3)
    monkeypatch.setattr(operators, "_MOST_ENTRIES", 300_000)
    rough = reference.image(scene, 3)
    assert np.all(rough.errors[1:] > 3 * fine.errors[1:])
    assert np.all(np.abs(rough.values - fine.values) <= rough.errors + fine.errors)
    monkeypatch.setattr(operators, "_MOST_ENTRIES", 100)
    with pytest.raises(ValueError, match="memory does not hold; pass a coarser resolution=, such as"):
        reference.image(scene, 3)


def test_two_glossy_walls_by_nested_quadrature():
    """Three edges: the eye sees a glossy floor, it a glossy wall, and that a lamp; nothing stands between."""
    shiny = Material(glossy=0.9, exponent=12)
    floor, wall, lamp = ((0.5, 0), (2, 0)), ((2.4, 0.3), (2.2, 1.4)), ((1.4, 2.2), (0.6, 1.9))
    eye = Pinhole((0.2, 0.8), (1.0, -0.75), 0.1, 1)
    scene = Scene("two", (Segment(*floor, shiny), Segment(*wall, shiny), Segment(*lamp, LAMP)), eye)
    found = reference.image(scene, 3, Resolution(order=6, smallest=0.05))
    nodes, weights = np.polynomial.legendre.leggauss(160)
    u, w = (nodes + 1) / 2, weights / 2

    def along(pair):
        a, b = np.array(pair, float)
        d = (b - a) / np.linalg.norm(b - a)
        return a + u[:, None] * (b - a), d, np.array([-d[1], d[0]]), w * np.linalg.norm(b - a)

    def between(x, y):
        v = y - x
        r = np.linalg.norm(v, axis=-1)
        return v / r[..., None], r

    (z, dz, nz, wz), (e, _, ne, we) = along(wall), along(lamp)
    to_lamp, r = between(z[:, None], e[None])
    geometry = (to_lamp @ nz) * -(to_lamp @ ne) / r * we
    total = 0.0
    axis = np.array([0.8, -0.6])
    film, film_w = np.polynomial.legendre.leggauss(12)
    for x, weight in zip(np.tan(0.1) * film, film_w / 2, strict=True):
        ray = axis + x * np.array([0.6, 0.8])
        y = np.array([0.2, 0.8]) - 0.8 / ray[1] * ray
        out = np.arcsin(-ray[0] / np.linalg.norm(ray))
        to_wall, s = between(y, z)
        theta = np.arcsin(to_wall[:, 0])
        back, inwards = np.arcsin(-to_wall @ dz), np.arcsin(to_lamp @ dz)
        second = 0.9 * (lobe(12, back[:, None], inwards) * geometry).sum(1)
        total += weight * np.sum(0.9 * lobe(12, out, theta) * to_wall[:, 1] * -(to_wall @ nz) / s * wz * second)
    assert total > 1e-3
    assert abs(found.values[2, 0] / total - 1) < 1e-4


# --- brute force ---------------------------------------------------------------------------------------------------


def test_brute_force():
    """Points 1 / 700 of the walls' length apart, visibility by tests of pairs: three lengths, in a room with a T."""
    segments = box(extra=[Segment((1.4, 0), (1.4, 0.5), WHITE), *ring(BAR, WHITE, "b")])
    found = reference.image(Scene("box", segments, Wall("floor", 1)), 3)
    count = [int(700 * s.length / 7) for s in segments]
    share = [(np.arange(n) + 0.5) / n for n in count]
    ends = [np.array([s.start, s.end], float) for s in segments]
    x = np.concatenate([e[0] + t[:, None] * (e[1] - e[0]) for e, t in zip(ends, share, strict=True)])
    k = np.repeat(np.arange(len(segments)), count)
    width = np.array([s.length for s in segments])[k] / np.array(count)[k]
    along = np.array([(e[1] - e[0]) / np.linalg.norm(e[1] - e[0]) for e in ends])[k]
    normal = np.stack([-along[:, 1], along[:, 0]], -1)
    v = x[None] - x[:, None]
    r = np.linalg.norm(v, axis=-1) + np.eye(len(x))
    v = v / r[..., None]
    cosines = np.maximum(np.einsum("ijc,ic->ij", v, normal), 0), np.maximum(-np.einsum("ijc,jc->ij", v, normal), 0)
    nearest = [first_hits(segments, np.broadcast_to(x[i], v[i].shape), v[i]) for i in range(len(x))]
    kernel = cosines[0] * cosines[1] / r * (np.array(nearest) == k[None]) * width
    sent, rho = (np.array([getattr(s.material, name) for s in segments])[k] for name in ("emission", "lambert"))
    for row in found.values:
        irradiance = kernel @ sent
        assert abs((irradiance * width)[k == 0].sum() / 2.0 / row[0] - 1) < 4e-3
        sent = rho / 2 * irradiance


# --- errors ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("sensor", "right"), [(EYE, Material(mirror=0.8)), (Wall("floor", 4), GREY)])
def test_errors_bound_what_refining_changes(sensor, right):
    scene = Scene("bar", box(right, extra=[Segment((0.7, 0.65), (1.0, 0.8), WHITE)]), sensor)
    resolution = Resolution(order=3, points=8, smallest=1e-2)
    found, finer = (reference.image(scene, 2 if right.mirror else 3, r) for r in (resolution, resolution.finer()))
    assert np.all(np.abs(found.values - finer.values) <= found.errors)
    assert finer.errors.max() < 1e-5 * finer.total.mean()


def test_faults():
    scene = Scene("room", tuple(ring(SQUARE, Material(emission=1.0, lambert=1.0))), EYE)
    with pytest.raises(ValueError, match="keeps all its light"):
        reference.converged(scene, COARSE)
    mirrors = Scene("mirrors", tuple(ring(SQUARE, Material(emission=1.0, mirror=1.0))), EYE)
    with pytest.raises(ValueError, match="absorb a little"):
        reference.converged(mirrors, COARSE)
    with pytest.raises(ValueError, match="lengths must be a whole number, 1 at least"):
        reference.image(scene, 0)
    with pytest.raises(ValueError, match="must be under 1"):
        reference.furnace(1.0, 1.0)
