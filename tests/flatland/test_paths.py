"""Paths as bijections, and the light that they carry: held to autodiff, to the furnace and to exact pixels.

Statistical tests: false-alarm rate 1e-5 each; what each would have caught stands with it.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import mcmc1d
from mcmc1d import moves
from mcmc1d.flatland import (
    Bidirectional,
    Exposure,
    Joined,
    Light,
    Material,
    Paths,
    Pinhole,
    Scene,
    Segment,
    Wall,
    independent,
    picture,
    scattering,
)
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import polygon, scene
from mcmc1d.verify import check_technique

pytestmark = pytest.mark.slow

CORNERS = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.5, 1.2), (1.5, 2.0), (0.0, 2.0)]
MIXED = [
    Material(emission=1, lambert=0.4, mirror=0.3),
    Material(lambert=0.3, glossy=0.4),
    Material(emission=0.5, lambert=0.2, glossy=0.3, exponent=5, mirror=0.3),
]
CAMERA = Pinhole((0.5, 0.5), (1, 0.3), 0.7, 4)


def room(materials, sensor=CAMERA):
    """A room with a corner that looks inward, one material a wall."""
    sides = polygon(CORNERS, [materials[k % len(materials)] for k in range(6)])
    named = [Segment(side.start, side.end, side.material, f"w{k}") for k, side in enumerate(sides)]
    return Scene("room", tuple(named), sensor)


def furnace(lambert, mirror, sensor=CAMERA):
    return room([Material(emission=1, lambert=lambert, mirror=mirror)], sensor)


# --- bijections -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("edges", "sensor"), [(1, Wall("w1")), (3, CAMERA), (6, CAMERA)])
def test_every_technique_is_a_bijection_with_its_log_determinant(edges, sensor):
    """Round trips and autodiff at random points, of all techniques in one program; mirrors, glossy lobes, mixtures."""
    family = Bidirectional(Paths(room(MIXED, sensor), edges))

    @jax.jit
    def look(index, u, fresh):
        def flat(u):
            x, v, log_det = family.forward(index, u)
            return jnp.concatenate([x, v]), (x, v, log_det)

        jacobian, (x, v, log_det) = jax.jacfwd(flat, has_aux=True)(u)
        back, log_det_back = family.inverse(index, x, v)
        other, log_det_other = family.inverse(index, x, fresh)
        again, v_again, log_det_again = family.forward(index, other)
        log_p = jnp.stack(family.log_probs(x))[index]
        trip = jnp.max(jnp.abs(back - u))
        return trip, log_det, jnp.linalg.slogdet(jacobian)[1], log_det_back, log_p, jnp.linalg.cond(jacobian), (
            jnp.max(jnp.abs(again - x)), jnp.max(jnp.abs(v_again - fresh), initial=0), log_det_again + log_det_other,
        )  # fmt: skip

    n, rng = 600, np.random.default_rng(edges)
    index = jnp.asarray(np.arange(n) % len(family.members))
    u, fresh = rng.random((n, family.dim_u)), rng.random((n, family.dim_u - family.dim_x))
    with jax.enable_x64(True):
        found = jax.vmap(look)(index, jnp.asarray(u), jnp.asarray(fresh))
    trip, log_det, by_autodiff, log_det_back, log_p, condition, (x_again, v_again, other) = (
        jax.tree.map(np.asarray, part) for part in found
    )
    tolerance = 1e-8 * np.maximum(1, condition / 1e4)
    assert np.isfinite(log_det).all()
    for error in (trip, log_det - by_autodiff, log_det + log_det_back, log_det_back - log_p, x_again, v_again, other):
        assert np.all(np.abs(error) <= tolerance), np.max(np.abs(error) / tolerance)


def test_the_family_is_its_members():
    """Together, from walks that are taken once, and each alone: the same paths, numbers and densities."""
    family = Bidirectional(Paths(room(MIXED), 2))
    u = jnp.asarray(np.random.default_rng(0).random((50, family.dim_u)), jnp.float32)

    @jax.jit
    def both(u):
        together = [family.forward(i, u) for i in range(3)]
        alone = [member.forward(u) for member in family.members]
        back = [(family.inverse(i, x, v)[0], family.members[i].inverse(x, v)[0]) for i, (x, v, _) in enumerate(alone)]
        return together, alone, back

    together, alone, back = jax.vmap(both)(u)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), together, alone)
    for one, other in back:
        np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.parametrize(("edges", "t", "sensor"), [(2, 3, CAMERA), (1, 0, Wall("w1"))])
def test_contract(edges, t, sensor):
    """At the edges of the cube and in float32 too: lobes, a mirror, and light that meets the sensor or does not."""
    check_technique(Joined(Paths(room(MIXED, sensor), edges), t), points=1000).raise_if_failed()


@pytest.mark.parametrize("t", [0, 1])
def test_contract_with_a_lamp_among_walls_and_a_mirror_beside_the_sensor(t):
    """In float32 the lamp's last number was NaN; a place before the sensor had a density; the box is all but empty."""
    corners = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (2.5, 1.5), (1.5, 1.8), (0.0, 1.5)]
    lambert, mirror, lamp = Material(lambert=0.5), Material(mirror=0.85), Material(emission=4.0)
    mixed = Material(lambert=0.2, mirror=0.4, glossy=0.2, exponent=3)
    walls = polygon(corners, [lambert, mirror, lamp, lambert, mixed, lambert])
    floor = Segment(walls[0].start, walls[0].end, lambert, "floor")
    member = Joined(Paths(Scene("lamp", (floor, *walls[1:]), Wall("floor")), 2), t)
    check_technique(member, points=1000).raise_if_failed()
    ends = jnp.asarray([0.0, 0.3, 1 - 2**-24], jnp.float32)
    u = jnp.stack(jnp.meshgrid(*[ends] * member.dim_u), -1).reshape(-1, member.dim_u)
    assert np.isfinite(jax.vmap(lambda u: member.forward(u)[0])(u)).all()
    with jax.enable_x64(True):
        assert np.isneginf(member.log_prob(jnp.array([-0.5, 3.987437, 4.011687])))


@pytest.mark.parametrize("exponent", [1, 2, 5, 20, 200])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_glossy_lobe_inverts(exponent, dtype):
    with jax.enable_x64(True):
        u = jnp.asarray(np.concatenate([np.linspace(0, 1, 2000, endpoint=False), np.logspace(-6, -1, 100)]), dtype)
        alpha = jax.jit(jax.vmap(lambda u: scattering._quantile(exponent, u)))(u)
        back = jax.jit(jax.vmap(lambda a: scattering._cdf(exponent, jnp.sin(a), jnp.cos(a), a)))(alpha)
    assert alpha.dtype == dtype
    assert np.max(np.abs(np.asarray(back - u))) < (1e-13 if dtype == jnp.float64 else 3e-6)


# --- light ----------------------------------------------------------------------------------------------------------


def target(of, edges, lengths=None):
    paths = Paths(of, edges)
    return mcmc1d.Multiplexed(Light(paths), Bidirectional(paths, lengths))


def agrees(found, exact, floor=0.0):
    """Whether all pixels agree, at a false-alarm rate of 1e-5 for the image."""
    z = np.abs(found.value - exact) / np.maximum(found.error, floor)
    return bool(z.max() < norm.isf(1e-5 / 2 / len(exact)))


@pytest.mark.parametrize(("lambert", "mirror", "sensor"), [(0.5, 0.0, CAMERA), (0.2, 0.4, Wall("w1", 4))])
def test_the_furnace_is_grey(lambert, mirror, sensor):
    """2^18 paths of three edges: would have caught an error of 5 %; and a reflectance 5 % off is caught."""
    found = independent(jax.random.key(1), target(furnace(lambert, mirror, sensor), 3), 2**18)
    scale = 1.0 if isinstance(sensor, Pinhole) else 2.0
    exact = np.full(4, scale * (lambert + mirror) ** 2)
    assert np.max(found.error / exact) < 0.05 / (norm.isf(1e-5 / 8) + 2.3)
    assert agrees(found, exact)
    assert not agrees(found, exact * 1.05**2)


def test_path_tracing_alone_is_exact_in_the_furnace():
    """A walk from the sensor that meets a lamp at every wall has no variance; in float32 about one in 3e4 slips out."""
    with jax.enable_x64(True):
        found = independent(jax.random.key(0), target(furnace(0.5, 0.0), 3, lengths=(4,)), 2**15)
    # Each pixel gets its share of the samples, a binomial of its own.
    np.testing.assert_allclose(found.value.mean(), 0.25, rtol=1e-12)


def test_chains_that_jump_between_techniques_make_the_exact_image():
    """Reversible jumps in the box, three edges, pixel by pixel in absolute scale: 15 % off would have been caught."""
    box = scene("box").with_pixels(4)
    exact = image(box, 3).values[2]
    light = target(box, 3)
    assert isinstance(light.target, Light)
    kernel = moves.Mixture({"small": (0.8, moves.SmallStep(0.05)), "jump": (0.2, moves.ReversibleJump())})
    estimators = {"image": Exposure(light.target.paths)}
    # Thirty-two blocks: the standard error is known to an eighth, and the threshold allows for it.
    run = mcmc1d.run(
        jax.random.key(3), kernel, light, steps=160, chains=8192, blocks=32, estimators=estimators, dtype=jnp.float32
    )
    found = picture(run, "image", exact.mean())
    assert np.max(found.error / exact) < 0.15 / 9
    assert agrees(found, exact, floor=1e-9) or np.max(np.abs(found.value - exact) / found.error) < 5.5
    assert not agrees(found, exact[::-1])
    assert not agrees(found, 1.16 * exact)
