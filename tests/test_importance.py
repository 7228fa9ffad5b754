"""Importance functions: unbiased by enumeration, exact losses, compositions, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d.image import Film, Image
from mcmc1d.importance import Floor, Product, Regions, Shader, lost_mass
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import SmallStep
from mcmc1d.pixels import Pixels, masses, pixel_values, resample
from mcmc1d.targets import Checkerboard, FromFunction, Sinusoid, Tabulated, Target, Tempered
from mcmc1d.techniques import Rectangle, Uniform
from mcmc1d.verify import RingStep, enumerate_kernel, ring

F = np.array([1.0, 3.0, 0.5, 2.0, 4.0])
RING = Tabulated(F)
OVER = Regions([0.2, 3.0, 1.0, 0.7, 2.5])
LINE = Sinusoid(0.9, 2.0, 0.1)


def high(x):
    return x > 0.5


class Undivided(Image):
    """What deposits f of another chain's samples, and is not asked whether it may."""

    def init(self, target, kernel, dtype):
        return jnp.zeros((self.pixels.count, 5), dtype)


class Plane(Target):
    """f = x y on the square, 0 where x < 1/4: integral 15/64."""

    @property
    def domain(self):
        return np.zeros(2), np.ones(2)

    def log_f(self, x):
        inside = jnp.all((x >= 0) & (x <= 1))
        return jnp.where(inside & (x[0] >= 0.25), jnp.log(x[0] * x[1]), -jnp.inf)

    def bin_masses(self, edges):
        raise ValueError("two coordinates")


@pytest.mark.parametrize(
    "importance",
    [
        RING,
        Product((RING, OVER)),
        Product((Floor(RING, 1.5), Shader(OVER, high, 4.0))),
    ],
)
def test_deposits_of_f_over_i_are_unbiased_exactly(importance):
    _, states = ring(F)
    found = enumerate_kernel(
        Metropolis(RingStep(5, {1: 0.75, -1: 0.25})), mcmc1d.Multiplexed(importance, Uniform()), states
    )
    with jax.enable_x64(True):
        at = jnp.asarray(states.u[:, 0])
        density = np.exp(jax.vmap(importance.log_f)(at))
    deposited = density.mean() * (found.law @ found.deposits)
    assert np.abs(deposited * F / density - F / 5).max() < 1e-13
    if importance is not RING:  # what the division by I repairs
        assert np.abs(deposited - F / 5).max() > 1e-2


def test_a_composition_has_the_masses_of_its_parts():
    edges, whole = np.linspace(0, 1, 5), LINE.bin_masses(np.linspace(0, 1, 5))
    assert np.allclose(Shader(LINE, high, 10.0, (0.5,)).bin_masses(edges), whole * [1, 1, 10, 10], atol=1e-11)
    assert np.allclose(Product((LINE, Regions([2, 1, 0.5, 4]))).bin_masses(edges), whole * [2, 1, 0.5, 4], atol=1e-11)
    assert np.allclose(Floor(RING, 1.5).bin_masses(np.linspace(0, 1, 6)), np.maximum(F, 1.5) / 5, atol=1e-11)


def test_the_mass_that_is_lost_is_exact():
    lost, whole = lost_mass(LINE, Regions([1, 0, 1, 1]))
    assert lost == pytest.approx(LINE.bin_masses(np.array([0.25, 0.5]))[0], abs=1e-11)
    assert whole == pytest.approx(1, abs=1e-11)
    blind = Regions([[1, 0], [1, 1]])  # the corner x < 1/2 < y, of which f fills the half x > 1/4
    lost, whole = lost_mass(Plane(), blind, [[0.25, 0.5], [0.5]])
    assert lost == pytest.approx((0.25 - 0.0625) / 2 * (1 - 0.25) / 2, abs=1e-11)
    assert whole == pytest.approx(15 / 64, abs=1e-11)


class Shifted(Plane):
    """The same, one to the right and one up."""

    domain = np.ones(2), np.full(2, 2.0)

    def log_f(self, x):
        return Plane().log_f(x - 1)


def test_the_mass_that_is_lost_is_that_of_the_whole_domain():
    """It was that of the unit square."""
    lost, whole = lost_mass(Shifted(), Shifted(), [[1.25, 1.5], [1.5]])
    assert lost == 0
    assert whole == pytest.approx(15 / 64, abs=1e-11)


@pytest.mark.parametrize(
    ("importance", "message"),
    [
        (Regions([1, 0, 1, 1]), r"zero at x = 0.25.*of a mass of 1 would be lost; put a Floor"),
        (FromFunction(lambda x: x - 0.5), "FromFunction is negative at x = 0.00024"),
        (FromFunction(lambda x: jnp.where(x > 0.5, jnp.inf, 1)), "FromFunction is inf at x = 0.50024"),
        (FromFunction(lambda x: jnp.where(x > 0.5, jnp.nan, 1)), "FromFunction is NaN at x = 0.50024"),
        (Product((LINE, FromFunction(lambda x: 0.1 - x))), "Product: FromFunction is negative at x = 0.1"),
    ],
)
def test_an_importance_that_can_not_be_is_refused_with_its_point(importance, message):
    with pytest.raises(ValueError, match=message):
        Image(LINE, importance, Pixels(10))


def test_a_loss_may_be_allowed():
    assert Image(LINE, Regions([1, 0, 1, 1]), Pixels(10), allow_loss=True).pixels.count == 10


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Regions([1, -1.0]), r"region \(1,\) of 2 a side has -1"),
        (lambda: Regions([1, np.inf]), "finite and not negative"),
        (lambda: Regions(np.ones((2, 3))), "a line or a square"),
        (lambda: Regions([1, 2], 3), r"regions must lie in 1..2, not 3"),
        (lambda: Floor(LINE, 0.0), "level must be positive"),
        (lambda: Shader(LINE, high, -1.0), "finite and not negative, not -1"),
        (lambda: Product(()), "one factor at least"),
        (lambda: Product((LINE, Plane())), "must have one domain"),
        (lambda: Pixels(0), "1 at least"),
        (lambda: Image(FromFunction(jnp.ones_like, 0, 2), LINE, Pixels(4)), "lies over the unit cube"),
        (lambda: Image(LINE, LINE, Pixels(4, 2)), "an image of 2 axes"),
        (lambda: masses(Plane(), [np.array([0.0, 1.0])] * 2), "name in `cuts` where it jumps"),
    ],
)
def test_what_can_not_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_image_of_a_line_is_right_and_without_the_division_is_not():
    """24 pixels in two images, 16 blocks: over 7 standard errors (t, 15) with probability 1e-4; detects 2 % or so."""
    importance, pixels = Product((LINE, OVER)), Pixels(12)
    estimators = {"right": Image(LINE, importance, pixels), "wrong": Undivided(LINE, LINE, pixels)}
    target = mcmc1d.Multiplexed(importance, Uniform())
    size = {"steps": 200, "chains": 2048, "blocks": 16}
    found = mcmc1d.run(jax.random.key(1), SmallStep(0.3), target, estimators=estimators, **size)
    b, exact = importance.bin_masses(np.array([0.0, 1.0])), pixel_values(LINE, pixels)
    score = {}
    for name in estimators:
        image = Film.of(found.sums[name], np.full(16, b[0]), 200 * 2048 / 16).image()
        score[name] = np.abs((image.mean(0) - exact) / image.std(0, ddof=1) * 4).max()
    assert score["right"] < 7
    assert score["wrong"] > 20


def test_a_chain_that_samples_another_density_is_refused():
    with pytest.raises(ValueError, match=r"must sample the importance function Product; its target, Sinusoid, is anot"):
        mcmc1d.run(
            jax.random.key(0),
            SmallStep(),
            mcmc1d.Multiplexed(LINE, Uniform()),
            steps=1,
            chains=8,
            estimators={"image": Image(LINE, Product((LINE, OVER)), Pixels(4))},
        )


def test_a_new_table_does_not_compile_again():
    calls = []

    def f(x):
        calls.append(x)
        return 1 + x

    target, pixels = FromFunction(f), Pixels(4)
    traced = 0
    for k in range(3):
        importance = Product((target, Regions(np.full(4, 1.0 + k), np.asarray(2 + k % 2, np.int32))))
        mcmc1d.run(
            jax.random.key(k),
            SmallStep(),
            mcmc1d.Multiplexed(importance, Uniform()),
            steps=2,
            chains=8,
            estimators={"image": Image(target, importance, pixels)},
        )
        traced = len(calls) if k == 0 else traced
    assert len(calls) == traced


def test_pixels_of_a_square_and_of_a_line():
    square = Pixels(4, 2)
    assert int(square.cell(jnp.array([0.3, 0.99]))) == 1 * 4 + 3
    assert int(square.cell(jnp.array([0.3, 0.99]), 2)) == 0 * 4 + 1
    assert int(Pixels(4).cell(jnp.asarray(1.0))) == 3
    image = pixel_values(Plane(), square).reshape(4, 4)
    middle = (np.arange(4) + 0.5) / 4
    assert np.allclose(image, np.where(middle > 0.25, middle, 0)[:, None] * middle, atol=1e-12)
    assert np.allclose(pixel_values(Plane(), Pixels(4)), np.where(middle > 0.25, middle, 0) / 2, atol=1e-12)


def test_resampling_keeps_the_mean_and_cuts_pixels():
    image = np.random.default_rng(0).random((3, 8, 8))
    assert np.allclose(resample(image, 5, 2).mean((1, 2)), image.mean((1, 2)))
    assert np.allclose(resample(image, 4, 2), image.reshape(3, 4, 2, 4, 2).mean((2, 4)))
    assert np.allclose(resample(np.array([1.0, 2.0, 3.0]), 2, 1), [4 / 3, 8 / 3])


@pytest.mark.parametrize("chains", [2, 8])
def test_a_planar_image_of_a_run_has_its_deposits_where_they_are(chains):
    """All of f in one quarter of the square, whatever the number of chains a block."""

    class Quarter(Target):
        @property
        def domain(self):
            return np.zeros(2), np.ones(2)

        def log_f(self, x):
            return jnp.where((x[0] > 0.5) & (x[1] < 0.5) & jnp.all((x >= 0) & (x <= 1)), 0.0, -jnp.inf)

        def bin_masses(self, edges):
            raise NotImplementedError

    f = Quarter()
    target = mcmc1d.Multiplexed(f, Rectangle())
    estimators = {"image": Image(f, f, Pixels(2, 2))}
    run = mcmc1d.run(jax.random.key(0), SmallStep(0.1), target, steps=8, chains=chains, blocks=1, estimators=estimators)
    assert run.sums["image"][0, :, 0] == pytest.approx([0, 0, 8 * chains, 0])


def test_a_power_of_a_target_and_a_product_keep_its_outline():
    """A board whose lines fall on no even division of the square."""
    checks = Checkerboard(np.array([[1.0, 0.0, 2.0], [0.5, 1.0, 0.0], [0.0, 3.0, 1.0]]))
    edges = np.linspace(0, 1, 4)
    exact = checks.bin_masses((edges, edges))
    for made, power in ((Tempered(checks, 0.5), 0.5), (Product((checks, checks)), 2.0)):
        with np.errstate(divide="ignore"):
            wanted = np.where(exact > 0, (9 * exact) ** power / 9, 0)
        np.testing.assert_allclose(made.bin_masses((edges, edges)), wanted, atol=1e-10)
