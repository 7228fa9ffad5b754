"""Integrators held to exact images, pixel by pixel and in absolute scale; and what they refuse.

Statistical tests: false-alarm rate 1e-5 each; what each would have caught is asserted with it.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.flatland import Bidirectional, Light, Material, Paths, Pinhole, Scene, Segment, Wall
from mcmc1d.flatland.integrators import MMLT, RJMLT, LightTracing, PathTracing, integrate
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.sampling import undefined_light
from mcmc1d.flatland.scenes import polygon, scene
from mcmc1d.techniques.family import apart

pytestmark = pytest.mark.slow

CORNERS = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.5, 1.2), (1.5, 2.0), (0.0, 2.0)]
MIXED = [
    Material(emission=1, lambert=0.4, mirror=0.3),
    Material(lambert=0.3, glossy=0.4),
    Material(emission=0.5, lambert=0.2, glossy=0.3, exponent=5, mirror=0.3),
]


def room(sensor):
    sides = polygon(CORNERS, [MIXED[k % 3] for k in range(6)])
    return Scene("room", tuple(replace(side, name=f"w{k}") for k, side in enumerate(sides)), sensor)


@pytest.mark.parametrize(("of", "edges"), [(room(Wall("w1")), 2), (room(Pinhole((0.5, 0.5), (1, 0.3), 0.7)), 3)])
def test_one_look_at_a_state_finds_what_two_walks_and_two_looks_do(of, edges):
    """Sample, forgotten numbers, light and all densities of every technique; mirrors, lobes, blocked joints."""
    family = Bidirectional(Paths(of, edges))
    light = Light(family.paths)
    n = 500
    index = jnp.asarray(np.arange(n) % len(family.lengths), jnp.int32)
    with jax.enable_x64(True):
        u = jnp.asarray(np.random.default_rng(0).random((n, family.dim_u)))
        both = jax.jit(jax.vmap(lambda i, u: (family.look(light, i, u), apart(family, light, i, u))))
        one, other = jax.tree.map(np.asarray, both(index, u))
    dark = np.isneginf(other[3])
    assert 0.1 < dark.mean() < 0.9
    for found, known in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-9)


# The others are the right twins of `test_wrong_integrators`.
@pytest.mark.parametrize("name", ["pt", "bdpt_maximum", "pssmlt_sum", "rjmlt_aimed", "mlt"])
def test_the_box_by_two_edges(name):
    """Would have caught 30 % in any pixel with probability 0.99; and the number of techniques left out is caught."""
    box = scene("box").with_pixels(4)
    exact = image(box, 2)
    found = integrate(jax.random.key(7), name, box, lengths=(2,), samples=2**18)
    at = slice(1, 2)
    result = compare(found, exact.values[at], exact.errors[at])
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.3, result.detectable
    assert not compare(found, exact.values[at] * 3, exact.errors[at]).agrees
    assert not compare(found, exact.values[at][:, ::-1], exact.errors[at]).agrees


def test_a_length_without_light_is_dark_and_a_scene_without_any_is_an_error():
    box = scene("box").with_pixels(2)
    assert integrate(jax.random.key(0), "mmlt", box, lengths=2, samples=2**14).values[0].max() == 0
    lamp = Segment((0.0, 0.0), (1.0, 0.0), Material(emission=1))  # its front looks up, and the pinhole down
    away = Scene("away", (lamp,), Pinhole((0.5, 1.0), (0.0, 1.0), 0.3, 2))
    with pytest.raises(ValueError, match="scene away: no path of 1 edges brought light to the sensor"):
        integrate(jax.random.key(0), "bdpt", away, lengths=1, samples=2**12)


def test_what_only_a_mirror_shows_is_no_light_tracers():
    furnace = scene("furnace").with_pixels(2)
    with pytest.raises(ValueError, match=r"LightTracing: scene furnace: of the light of 2 edges, .* seen in a mirror"):
        integrate(jax.random.key(0), "lt", furnace, lengths=2)
    part = integrate(jax.random.key(0), LightTracing(partial=True), furnace, lengths=(2,), samples=2**14)
    assert 0 < part.total.mean() < 0.5


def test_rays_are_counted_and_a_jump_traces_none():
    box = scene("box").with_pixels(2)
    by = {
        name: integrate(jax.random.key(0), integrator, box, lengths=(2,), samples=2**14).rays
        for name, integrator in {
            "pt": PathTracing(),
            "mmlt": MMLT(chains=64),
            "rjmlt": RJMLT(chains=64, jump=0.5),
        }.items()
    }
    for_b = 2 * 2**12
    assert by["pt"] == 2 * 2**14
    assert by["mmlt"] == 2 * 2**14 + for_b
    # Half of the mutations jump: 8192, give or take five standard deviations of 64.
    assert abs((by["rjmlt"] - for_b) / 2 - 2**13) < 5 * 64


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"integrator": "bidirectional"}, "there is no integrator 'bidirectional'; "),
        ({"lengths": (0, 1)}, "lengths: a number of edges must be a whole number, 1 at least, not 0"),
        ({"lengths": (1, 1)}, "lengths are different numbers of edges"),
        ({"samples": 1}, "samples must be a whole number, 2 at least"),
    ],
)
def test_refusals(changes, message):
    given = {"integrator": "pt", "lengths": 2, "samples": 2**10} | changes
    with pytest.raises(ValueError, match=message):
        integrate(jax.random.key(0), given.pop("integrator"), scene("box"), **given)


def test_settings_that_are_refused():
    with pytest.raises(ValueError, match="must sum to 1 at most"):
        RJMLT(large=0.8, jump=0.3)
    with pytest.raises(ValueError, match="chains, for a standard error, must be a whole number, 2 at least"):
        MMLT(chains=1)


def test_light_that_is_no_number_is_told_with_the_length_of_its_paths():
    """Of a target of theirs; of what has none it is told without."""
    found = str(undefined_light(PathTracing().target(Paths(scene("box"), 2))))
    assert found == "paths of 2 edges: the light of a path is NaN or infinite; look at the scene's lamps"
    assert (
        str(undefined_light(None, " here")) == "the light of a path is NaN or infinite here; look at the scene's lamps"
    )
