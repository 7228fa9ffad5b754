"""Stages, the noise target, energy redistribution; each statistical test beside what must fail it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from mcmc1d import rendering
from mcmc1d.metropolis import Cycle
from mcmc1d.moves import LargeStep, Mixture, Proposal, SmallStep
from mcmc1d.perception import bilateral, density_statistics, noise_target, tvi, visual_error
from mcmc1d.pixels import Pixels
from mcmc1d.redistribution import energy_redistribution, independent
from mcmc1d.rendering import Renderer, Scene
from mcmc1d.stages import MultiStage, NoiseAware, Stage, plan
from mcmc1d.targets import FromFunction, Sinusoid
from mcmc1d.techniques import Tent, Uniform

SCENE = Scene(Sinusoid(0.8, 2.0, 0.1), (Uniform(), Tent()), Pixels(8))
STEP = Mixture({"large": (0.4, LargeStep()), "small": (0.6, SmallStep(0.1))})
REPLICAS = 512
RENDERER = Renderer(SCENE, STEP, REPLICAS, 2)


def scores(image):
    """The bias of each pixel in standard errors; over 6 in one of 8 with probability 3e-8 (t, 511)."""
    return (image.mean(0) - SCENE.exact()) / image.std(0, ddof=1) * REPLICAS**0.5


@pytest.mark.parametrize("b", ["exact", "apart"])
@pytest.mark.parametrize("importance", [MultiStage(SCENE.pixels), NoiseAware(MultiStage(SCENE.pixels), 50.0)])
def test_stages_are_unbiased(importance, b):
    """Detects a bias of a pixel of 6 standard errors, 2 to 4 %."""
    found = RENDERER.render(jax.random.key(0), plan(8, 1024), importance, b)
    assert np.abs(scores(found.film.image())).max() < 6


def test_b_plugged_in_is_biased():
    found = RENDERER.render(jax.random.key(0), plan(8, 1024), MultiStage(SCENE.pixels), "plugged")
    assert scores(found.film.image()).max() < -6


@pytest.mark.parametrize("mutations", [1.0, 10.0])
def test_energy_redistribution_is_unbiased(mutations):
    found = energy_redistribution(jax.random.key(0), SCENE, STEP, 2048, REPLICAS, length=20, mutations=mutations)
    assert np.abs(scores(found.film.image())).max() < 6
    assert found.work == pytest.approx(2048, rel=0.05)


class Refused(LargeStep):
    """A large step that is never accepted."""

    def propose(self, target, state, w):
        proposal = super().propose(target, state, w)
        return Proposal(proposal.state, proposal.w, jnp.full_like(proposal.log_det, -jnp.inf))


def test_the_acceptance_of_short_chains_is_that_of_all_their_kernels():
    """Of two, of which one accepts all and the other nothing: it was that of the first."""
    even, both = Scene(FromFunction(lambda x: 1 + 0 * x), Uniform(), Pixels(1)), Cycle([LargeStep(), Refused()])
    found = energy_redistribution(jax.random.key(0), even, both, 256, 2, length=4, energy=1.0)
    assert found.acceptance == pytest.approx(0.5)


def test_independent_samples_and_two_stage_are_unbiased():
    assert np.abs(scores(independent(jax.random.key(0), SCENE, 512, REPLICAS).film.image())).max() < 6
    test, final = RENDERER.two_stage(jax.random.key(2), Stage(4, 256), 768, MultiStage(SCENE.pixels))
    assert np.abs(scores(final.film.image())).max() < 6
    assert (test.work, final.work, final.film.samples) == (256, 1024, 768)


@pytest.mark.slow
def test_it_is_all_the_same_in_float64():
    """Parameters are kept in float64 until something is rendered; a carry that began in float32 did not stay one."""
    with jax.enable_x64(True):
        images = [
            RENDERER.render(jax.random.key(0), plan(8, 1024), MultiStage(SCENE.pixels), "apart").film.image(),
            independent(jax.random.key(0), SCENE, 512, REPLICAS).film.image(),
            energy_redistribution(jax.random.key(0), SCENE, STEP, 2048, REPLICAS, length=20).film.image(),
        ]
    assert np.abs([scores(image) for image in images]).max() < 6


@pytest.mark.slow
def test_a_long_stage_loses_no_deposit():
    """The weights of three steps in four are 0.3 and 0.7, which a float32 sum over 2^22 rounds to 0.25 and 0.75."""
    scene = Scene(FromFunction(lambda x: jnp.where(x < 0.5, 1.0, 0.3), breaks=(0.5,)), Uniform(), Pixels(2))
    film = Renderer(scene, LargeStep(), 1, 1).plain(jax.random.key(0), 2**22).film
    assert film.density.sum() == pytest.approx(2**22, rel=1e-5)
    assert film.image()[0] == pytest.approx([1, 0.3], rel=0.01)  # 12 standard errors


@pytest.mark.parametrize("chains", [4096, 16384])
def test_many_chains_lose_no_deposit(chains):
    """Of a constant f / I = 0.1 into one pixel: a float32 sum of a step's deposits was off by 2 % and 6 %."""
    tenth = FromFunction(lambda x: 0.1 + 0 * x)
    scene = Scene(tenth, Uniform(), Pixels(1))
    film = Renderer(scene, LargeStep(), 1, chains).plain(jax.random.key(0), 64 * chains).film
    assert film.density.sum() == pytest.approx(64 * chains, rel=1e-12)
    assert film.image()[0] == pytest.approx([0.1], rel=1e-6)  # 0.1 itself is a float32


def test_the_plans_of_the_text_and_of_the_listing():
    text, listing = plan(64, 10**6), plan(64, 10**6, "listing")
    assert [s.regions for s in text] == [1, 2, 4, 8, 16, 32, 35, 38, 42, 45, 48, 51, 54, 58, 61, 64]
    assert [s.regions for s in listing] == [1, 2, 4, 8, 16, 32, 32, *[s.regions for s in text[6:]]]
    assert sum(s.samples for s in text[:6]) / 10**6 == pytest.approx(0.25, abs=1e-4)
    assert sum(s.samples for s in listing[:6]) / 10**6 == pytest.approx(63 / (63 + 8.25 * 64), abs=1e-4)
    fine = plan(2**14, 10**9, "listing")
    assert sum(s.samples for s in fine[:14]) / 10**9 == pytest.approx(0.108, abs=5e-4)


def test_batches_continue_their_chains():
    """Whose starts are those of one run: a small step from batch to batch keeps consecutive images alike."""
    one = Renderer(SCENE, SmallStep(0.003), 256, 1)
    films = one.batches(jax.random.key(3), 64, 2)
    first, second = (film.density.argmax(1) for film in films)
    assert np.mean(first == second) > 0.7  # of independent ones, 1/8 and a little


def test_the_running_variances_are_consistent():
    """Of f = s (1 + a sin): inside a pixel by quadrature; of independent contributions by a second moment."""
    film = independent(jax.random.key(4), Scene(SCENE.f, Uniform(), SCENE.pixels), 2**16, 4).film
    fine = (np.arange(8000) + 0.5) / 8000
    f = (1 + 0.8 * np.sin(2 * np.pi * (2 * fine + 0.1))).reshape(8, 1000)
    inside, contribution = f.var(1), 8 * (f**2).mean(1) - f.mean(1) ** 2
    assert np.allclose(film.variance("integral").mean(0), inside, rtol=0.05, atol=2e-3)
    assert np.allclose(film.variance("contribution").mean(0), contribution, rtol=0.05)


def test_statistics_of_the_density():
    density = np.random.default_rng(0).gamma(2, size=(3, 1000))
    found = density_statistics(density)
    scaled = density / density.mean(1, keepdims=True)
    assert np.allclose(found.variance, scaled.var(1))
    assert np.allclose(found.skew, stats.skew(density, axis=1))
    assert np.allclose(found.kurtosis, stats.kurtosis(density, axis=1))
    assert density_statistics(np.ones(5)) == (0, 0, -3)


def test_the_threshold_is_constant_in_the_dark_and_webers_in_the_light():
    assert np.allclose(np.log10(tvi([0, 1e-6, 1e-4])), -2.86)
    assert np.allclose(tvi([100, 1000.0]) / [100, 1000], 10**-1.255)
    grid = 10 ** np.linspace(-6, 4, 2001)
    steps = np.diff(np.log10(tvi(grid)))
    assert np.abs(steps).max() < 0.02  # the pieces of the published fit meet within 3 %
    assert visual_error(np.array([110.0, 90.0]), np.array([100.0, 100.0]), 1.0) == pytest.approx(10 / float(tvi(100)))


def test_the_noise_target_is_limited_and_looks_where_nothing_is_known():
    rng = np.random.default_rng(1)
    mean, variance = rng.gamma(1, size=(2, 16, 16)), rng.gamma(0.2, size=(2, 16, 16))
    mean[0, 3, 4] = variance[0, 3, 4] = 0
    target = noise_target(mean, variance, 2, width=0.3)
    assert np.all(target.max((1, 2)) / target.min((1, 2)) <= 2 + 1e-9)
    assert target[0, 3, 4] == pytest.approx(target[0].max(), rel=0.02)
    assert np.allclose(target.mean((1, 2)), 1)
    assert np.allclose(noise_target(np.zeros((1, 8)), np.zeros((1, 8)), 1), 1)


def test_the_bilateral_filter_smooths_and_keeps_edges():
    rng = np.random.default_rng(2)
    edge = np.where(np.arange(40) < 20, 1.0, 9.0) + rng.normal(0, 0.1, (1, 40))
    smooth = bilateral(edge, 1, 2.0, np.array([0.5]))
    assert np.abs(np.diff(smooth[0])[:18]).max() < np.abs(np.diff(edge[0])[:18]).max() / 2
    assert smooth[0, 20] - smooth[0, 19] > 7.5
    assert np.allclose(bilateral(np.full((1, 5, 5), 3.0), 2, 1.0, np.array([0.0])), 3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plan(1, 100), "has no stages"),
        (lambda: plan(8, 100, "paper"), '"text" or "listing"'),
        (lambda: plan(0, 100), "plan: side must be a whole number, 1 at least, not 0"),
        (lambda: plan(8, 0), "plan: samples must be a whole number, 1 at least, not 0"),
        (lambda: plan(8, 100, linear=0), "plan: linear must be a whole number, 1 at least, not 0"),
        (lambda: MultiStage(SCENE.pixels, 0.0), "MultiStage: floor must be positive and finite, not 0.0"),
        (
            lambda: NoiseAware(MultiStage(SCENE.pixels), -1.0),
            "NoiseAware: exposure must be positive and finite, not -1.0",
        ),
        (lambda: RENDERER.render(jax.random.key(0), plan(8, 64), MultiStage(SCENE.pixels), "image"), "b must be"),
        (lambda: RENDERER.render(jax.random.key(0), [], MultiStage(SCENE.pixels)), "one stage at least"),
        (lambda: RENDERER.render(jax.random.key(0), [Stage(9, 64)], MultiStage(SCENE.pixels)), "9 regions a side"),
        (lambda: Renderer(SCENE, STEP, 0), "Renderer: replicas must be a whole number"),
        (lambda: energy_redistribution(jax.random.key(0), SCENE, STEP, 2, 1, length=100), "no chain was started"),
        (lambda: energy_redistribution(jax.random.key(0), SCENE, STEP, 64, 1, energy=0.0), "energy must be positive"),
    ],
)
def test_what_can_not_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("value", "message"),
    [(np.inf, "NaN, infinite or negative"), (np.nan, "NaN, infinite"), (-1.0, "or negative"), (0.0, "b, the integral")],
)
def test_an_importance_that_can_not_be_sampled_is_refused(value, message):
    """It was drawn from for ever: no candidate is ever kept, and none exceeds the bound."""
    with pytest.raises(ValueError, match=f"in stage 0.*{message}|{message}.*in stage 0"):
        RENDERER.render(jax.random.key(0), [Stage(2, 64)], lambda film, k: np.array([[value, value]]))


@pytest.mark.parametrize(
    ("f", "chains", "message"),
    [
        # The height of the peak lies on the grid of the bound, and nearly no candidate ever falls on it.
        (lambda x: jnp.where(jnp.abs(x - 512.5 / 1024) < 1e-7, 1e7, 1e-3), 64, "262144 candidates for each.* narrow"),
        # Between the probes of Multiplexed, and those of the exact masses.
        (lambda x: jnp.where(jnp.abs(x - 252 / 2048) < 2e-5, jnp.nan, 1.0), 4096, "NaN or infinite somewhere"),
    ],
)
def test_starts_that_can_not_be_drawn_are_refused(f, chains, message):
    scene = Scene(FromFunction(f, breaks=(512.5 / 1024 - 1e-7, 512.5 / 1024 + 1e-7)), Uniform(), Pixels(8))
    with pytest.raises(ValueError, match=message):
        Renderer(scene, SmallStep(0.1), 2, chains).plain(jax.random.key(0), 4096)


def test_no_key_serves_twice(monkeypatch):
    """The k-th part of a split is the key folded with k: b's samples were a neighbouring replica's starts."""
    used = []

    def noted(function, split):
        def call(keys, *rest):
            each = [jax.random.split(key) for key in keys] if split else [keys]  # as a film splits its own
            used.extend(map(bytes, np.asarray(jax.random.key_data(jnp.concatenate(each)))))
            return function(keys, *rest)

        return call

    for name, split in (("_densities", False), ("_expose", True)):
        monkeypatch.setattr(rendering, name, noted(getattr(rendering, name), split))
    RENDERER.render(jax.random.key(0), plan(4, 2**10), MultiStage(SCENE.pixels), "apart")
    assert len(used) == len(set(used)) > 3 * REPLICAS
