"""Metropolis in stages in the plane: images pixel by pixel, what a stage samples, and mistakes that must fail.

False-alarm rate 1e-4 for each image, over its pixels; what it would have caught is asserted with it.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.flatland import Light, Paths
from mcmc1d.flatland.importance import OverPixels, Shader, Touches
from mcmc1d.flatland.integrators import Image, Stacked, StagedMLT
from mcmc1d.flatland.integrators.compare import compare
from mcmc1d.flatland.integrators.exposure import _candidates, exact_starts, highest_seen
from mcmc1d.flatland.reference import image
from mcmc1d.flatland.scenes import scene
from mcmc1d.starts import StartError

pytestmark = pytest.mark.slow

ALARM = 1e-4
BOX = scene("box").with_pixels(4)
SETTINGS = {"linear": 2, "floor": 0.25, "spent_on_b": 2.0, "chains": 4096, "test_regions": 1.0}


@pytest.fixture(scope="module")
def exact():
    found = image(BOX, 2)
    return found.values[1:], found.errors[1:]


def held(layer, exact):
    return compare(Image([layer]), *exact, level=ALARM)


@pytest.mark.parametrize("scheme", ["two_stage", "multi_stage", "noise_aware"])
def test_stages_meet_every_pixel_of_the_box(scheme, exact):
    """Of two edges. Twin: the importance is not divided out, in the mean only."""
    made = StagedMLT(scheme, **SETTINGS).render(jax.random.key(4), BOX, 2, 2**19)
    result = held(made, exact)
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.3, result.detectable
    assert len(made.layers) == (1 if scheme == "two_stage" else 4)
    shares = [np.mean(layer.scale) for layer in made.layers]
    kept = Stacked(tuple(a._replace(scale=float(s)) for a, s in zip(made.layers, shares, strict=True)))
    assert not held(kept, exact).agrees


def test_a_shader_is_divided_out(exact):
    """Twin: the image of the deposits as they are, from the same chains."""
    method = StagedMLT("one_stage", shader=Shader(Touches(BOX, "floor"), 10.0), **SETTINGS)
    result = held(method.render(jax.random.key(5), BOX, 2, 2**19), exact)
    assert result.agrees, result.excess
    assert result.detectable.max() < 0.3, result.detectable
    stage = next(method.staged(jax.random.key(5), BOX, 2, 2**19))
    undivided = 4 * stage.b * stage.film.density[0] / stage.samples
    assert np.abs(undivided / exact[0][0] - 1).max() > 0.5
    # A pixel's light comes by the floor or does not: f / p is the same for all its samples, as Cauchy and Schwarz say.
    film = stage.film
    assert np.ptp(film.value / film.density) > 8 * (film.value / film.density).min()
    np.testing.assert_allclose(film.contribution * film.density, film.value**2, rtol=1e-5)


def test_starts_have_the_law_of_each_row(exact):
    """In each pixel 6 standard errors of its share, 1e-8 by the normal law, detects 0.03. Twin: the other row's law."""
    values = np.array([[1.0, 1, 1, 1], [8, 1, 0.5, 3]])
    paths = Paths(BOX, 2)
    target = StagedMLT().target(paths)
    start = exact_starts(jax.random.key(6), target, values, 2**13, highest_seen(jax.random.key(7), target))
    x = jax.jit(jax.vmap(lambda i, u: target.forward(i, u)[0]))(start.index, start.u)
    pixel = np.asarray(jax.jit(jax.vmap(paths.pixel))(x)).reshape(2, -1)
    found = np.stack([np.bincount(row, minlength=4) for row in pixel]) / pixel.shape[1]
    shares = values * exact[0] / (values * exact[0]).sum(1, keepdims=True)
    error = np.sqrt(shares * (1 - shares) / pixel.shape[1])
    assert np.all(np.abs(found - shares) < 6 * error)
    assert np.any(np.abs(found - shares[::-1]) > 6 * error)


def test_starts_are_rejected_by_a_number_that_is_finer_than_float32s():
    """Of one number of 23 bits whatever is dark, but for one in 2^23, would be kept one time in 2^23."""
    *_, uniform = _candidates(jax.random.key(6), StagedMLT().target(Paths(BOX, 2)), 0)
    low = uniform[uniform < 1 / 16].astype(np.float64)
    assert 0.45 < np.mean(low * 2**23 % 1) < 0.55  # of 512 numbers, 4 standard errors


def test_the_importance_is_the_light_times_its_factors():
    paths = Paths(BOX, 2)
    values, shader = np.array([1.0, 2, 4, 8]), Shader(Touches(BOX, "floor"), 3.0)
    light, target = Light(paths), OverPixels(Light(paths), values, shader)
    u = jnp.asarray(np.random.default_rng(0).random((256, 3)))
    x = jax.jit(jax.vmap(lambda u: StagedMLT().target(paths).forward(jnp.asarray(1), u)[0]))(u)
    pixel, on, ratio = (
        np.asarray(a)
        for a in jax.jit(
            jax.vmap(lambda x: (paths.pixel(x), shader.predicate(paths, x), target.log_f(x) - light.log_f(x)))
        )(x)
    )
    lit = np.isfinite(ratio)
    assert 0 < on[lit].mean() < 1
    np.testing.assert_allclose(np.exp(ratio[lit]), (values[pixel] * np.where(on, 3, 1))[lit], rtol=1e-5)


def test_a_length_without_light_is_dark():
    made = StagedMLT("noise_aware", **{**SETTINGS, "chains": 8}).render(jax.random.key(0), BOX, 1, 2**10)
    assert not made.value.any()
    assert made.rays > 0


def test_plans():
    stages = StagedMLT("multi_stage").stages(32, 10**5)
    assert all(kept for _, kept in stages)
    assert [s.regions for s, _ in stages[:5]] == [1, 2, 4, 8, 16]
    (first, kept), (second, last) = StagedMLT("two_stage").stages(32, 1600)
    assert (first, kept, second, last) == ((1, 100), False, (8, 1500), True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"chains": 1}, "must be a whole number, 2 at least, not 1"),
        ({"test_share": 1.0}, "test_share and test_regions are shares"),
        ({"spent_on_b": 0.0}, "spent_on_b must be positive"),
        ({"candidates": 0}, "StagedMLT: candidates must be a whole number, 1 at least, not 0"),
        ({"linear": 0}, "StagedMLT: linear must be a whole number, 1 at least, not 0"),
        ({"floor": -0.1}, "StagedMLT: floor must be positive"),
        ({"luminance": 0.0}, "StagedMLT: luminance must be positive"),
    ],
)
def test_settings_that_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        StagedMLT(**settings)


def test_starts_take_no_more_candidates_than_are_allowed():
    with pytest.raises(StartError, match="of 4096 states after 16384 candidates"):
        StagedMLT(chains=4096, candidates=2**14).render(jax.random.key(0), BOX, 2, 4096)


def test_what_can_not_be_done_is_said():
    with pytest.raises(ValueError, match="no segment 'roof'; known: "):
        Touches(BOX, "roof")
    with pytest.raises(ValueError, match="b is estimated for one replica"):
        next(StagedMLT().staged(jax.random.key(0), BOX, 2, 64, replicas=2))
    with pytest.raises(ValueError, match="tells b of no shader"):
        next(StagedMLT(shader=Shader(Touches(BOX, "floor"))).staged(jax.random.key(0), BOX, 2, 64, exact=np.ones(4)))
