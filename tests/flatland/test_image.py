"""Sums of layers: their values, errors, and how far they stray."""

import numpy as np
import pytest

from mcmc1d.flatland.integrators import Image, Layer, Stacked, Sums
from mcmc1d.flatland.integrators.compare import compare, radius

ONE = Layer(2, 3.0, Sums(100, np.array([20.0, 40.0]), np.array([6.0, 18.0]), 1.0), None, 200.0)
B = Sums(10, np.array([20.0]), np.array([44.0]), 5.0)
TWO = Layer(2, 1.0, Sums(50, np.array([10.0, 0.0]), np.array([4.0, 0.0]), 1.0), B, 70.0)


def test_a_sum_of_layers_adds_up():
    both = Stacked((ONE, TWO))
    assert np.allclose(both.value, [3 * 0.2 + 2 * 0.2, 3 * 0.4])
    assert np.allclose(both.error**2, ONE.error**2 + TWO.error**2)
    assert (both.edges, both.rays) == (2, 270.0)
    assert np.allclose(both.scaled(0.5).value, both.value / 2)
    assert np.allclose(both.scaled(0.5).error, both.error / 2)


def test_a_stack_strays_as_the_root_of_its_layers():
    """Sixteen layers that may depend on each other stray as if they did not, but for what their dependence costs."""
    many = Sums(10**6, np.array([2e5]), np.array([6e4]), 1.0)
    for layer in (ONE._replace(deposits=many), TWO._replace(deposits=many, normaliser=many)):
        apart, stacked = radius([layer] * 16, 1e-4), radius([Stacked((layer,) * 16)], 1e-4)
        assert np.all(apart < stacked)
        assert np.all(stacked < 1.5 * apart)
        assert np.all(stacked < 16 / 2.5 * radius([layer], 1e-4))


def test_the_radius_of_a_stack_has_no_unit():
    for unit in (1e-9, 1e9):
        scaled = radius([Stacked((ONE, TWO)).scaled(unit)], 1e-4) / unit
        assert np.allclose(scaled, radius([Stacked((ONE, TWO))], 1e-4), rtol=0.02)


def test_the_radius_holds_where_the_past_chooses_the_next_layer():
    """1500 stacks of eight, in which a layer weighs more as long as those before it have erred one way."""
    rng, chance = np.random.default_rng(7), 0.05
    off, around = np.zeros(1500), np.zeros(1500)
    for k in range(1500):
        layers = []
        for _ in range(8):
            weight = 1.0 if off[k] > 0 else 4.0
            lit = rng.binomial(400, [chance]).astype(float)
            layers.append(Layer(2, weight, Sums(400, lit, lit, 1.0), None, 0.0))
            off[k] += weight * (lit[0] / 400 - chance)
        around[k] = radius([Stacked(tuple(layers))], 0.1)[0]
    assert np.mean(np.abs(off) > around) <= 0.1
    assert np.mean(np.abs(off) > around / 10) > 0.2


@pytest.mark.parametrize("normalised", [False, True])
def test_the_radius_holds_for_rare_bright_paths(normalised):
    """1500 images of two lengths: at most 0.1 of them beyond the radius of that level; but it is not far beyond all."""
    rng, chance = np.random.default_rng(5), np.array([0.003, 0.05, 0.5])
    beyond = np.zeros((2, 3))
    exact = np.sum([scale * chance * (0.02 if normalised else 1) for scale in (1.0, 3.0)], axis=0)
    for _ in range(1500):
        layers = []
        for scale in (1.0, 3.0):
            lit, bright = rng.binomial(400, chance).astype(float), float(rng.binomial(2000, 0.02))
            b = Sums(2000, np.array([bright]), np.array([bright]), 1.0) if normalised else None
            layers.append(Layer(2, scale, Sums(400, lit, lit, 1.0), b, 0.0))
        off = np.abs(sum(layer.value for layer in layers) - exact)
        around = radius(layers, 0.1)
        beyond += [off > around, off > around / 10]
    held, tenth = beyond / 1500
    assert np.all(held <= 0.1)
    assert tenth[-1] > 0.2


def test_nothing_is_compared_with_what_is_no_number():
    image = Image([ONE])
    for numbers in ([[np.nan, 1.2]], [[np.inf, 1.2]]):
        with pytest.raises(ValueError, match="the exact image is NaN or infinite"):
            compare(image, np.array(numbers))
    broken = Image([ONE._replace(deposits=ONE.deposits._replace(total=np.array([np.nan, 40.0])))])
    with pytest.raises(ValueError, match="the image is NaN"):
        compare(broken, np.array([[0.6, 1.2]]))


def test_what_has_no_bound_neither_agrees_nor_differs():
    endless = Image([ONE._replace(deposits=ONE.deposits._replace(bound=np.inf))])
    found = compare(endless, np.array([[50.0, 1.2]]))
    assert not found.agrees
    assert not found.differs
    bounded = compare(Image([ONE]), np.array([[50.0, 1.2]]))
    assert bounded.differs
    assert not bounded.agrees


def test_light_where_the_exact_image_is_dark_is_never_said_to_agree_within_nothing():
    """A dark length is held to the light of all lengths; where there is none at all nothing agrees, but the dark."""
    dim = Layer(1, 1.0, Sums(10**6, np.array([10.0, 0.0]), np.array([5.0, 0.0]), 1.0), None, 1.0)
    lit = Layer(2, 1.0, Sums(10**6, np.array([1e5, 3e5]), np.array([4e4, 2e5]), 1.0), None, 1.0)
    for dark in (0.0, 1e-24):  # what is left by rounding is no light
        held = compare(Image((dim, lit)), np.array([[dark, 0.0], [0.1, 0.3]]))
        assert held.agrees
        assert held.detectable[0] == pytest.approx((radius([dim], 1e-5 / 6) + 2.326 * dim.error) / 0.2, rel=1e-3)
    alone = compare(Image((dim,)), np.zeros((1, 2)))
    assert not alone.agrees
    assert not alone.differs
    assert "nothing would be found in some" in str(alone)
    black = Layer(1, 1.0, Sums(10**6, np.zeros(2), np.zeros(2), 1.0), None, 1.0)
    assert compare(Image((black,)), np.zeros((1, 2))).agrees
