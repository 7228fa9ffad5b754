import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.random import threefry2x32_p
from scipy import stats

from mcmc1d.random import threefry, uniforms


@pytest.fixture(autouse=True, params=[np.float32, np.float64], ids=["float32", "float64"])
def dtype(request):
    with jax.enable_x64(request.param == np.float64):
        yield request.param


def draw(seed, step, shape, dtype):
    return np.asarray(uniforms(jax.random.key(seed), step, shape, dtype))


def test_threefrys_bits_are_jaxs():
    rng = np.random.default_rng(0)
    key = jnp.asarray(rng.integers(2**32, size=2, dtype=np.uint32))
    high, low = (jnp.asarray(np.r_[w, 0, 2**32 - 1].astype(np.uint32)) for w in rng.integers(2**32, size=(2, 1000)))
    ours = threefry(key, high, low)
    theirs = threefry2x32_p.bind(jnp.full_like(high, key[0]), jnp.full_like(high, key[1]), high, low)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (1, 7), (3, 333), (4, 256)])
def test_uniforms_are_multiples_of_a_power_of_two_in_the_unit_interval(dtype, shape):
    u = draw(1, 5, shape, dtype)
    assert u.shape == shape
    assert u.dtype == dtype
    assert ((u >= 0) & (u < 1)).all()
    scaled = np.ldexp(u, np.finfo(dtype).nmant)
    np.testing.assert_array_equal(scaled, np.round(scaled))
    assert np.any(np.asarray(scaled, np.int64) % 2 == 1) or u.size < 20  # the last bit is used


def test_uniforms_differ_by_position_step_and_key(dtype):
    """No number comes twice; by chance two of 2400 would agree, in float32 with probability 0.3, so six are let pass.

    False-alarm rate: 1e-6 (a Poisson count of mean 0.35 above 6) in float32, 1e-9 in float64.
    """
    drawn = [draw(seed, step, (3, 201), dtype) for seed, step in ((0, 0), (0, 1), (1, 0), (1, 1))]
    everything = np.concatenate([u.ravel() for u in drawn])
    repeats = everything.size - np.unique(everything).size
    assert repeats <= (6 if dtype == np.float32 else 0)
    np.testing.assert_array_equal(draw(1, 1, (3, 201), dtype), drawn[3])


def test_a_step_given_as_an_array_is_the_same_step(dtype):
    np.testing.assert_array_equal(draw(0, 7, (2, 5), dtype), draw(0, jnp.asarray(7), (2, 5), dtype))


def test_uniforms_are_uniform_and_independent(dtype):
    """False-alarm rate 3e-7 (three tests at 1e-7 each), in each precision.

    Smallest error caught: a gap of 0.0057 in the distribution function (DKW, n = 2**18); a cell of 256 off by 20 %
    of its mass; a correlation of 0.01 between neighbours in position or step.
    """
    u = np.stack([draw(3, step, (1, 2**16), dtype)[0] for step in range(4)]).astype(np.float64)
    level = 1e-7
    gap = stats.ks_1samp(u.ravel(), stats.uniform.cdf).statistic
    assert 2 * np.exp(-2 * u.size * gap**2) > level
    assert stats.chisquare(np.bincount((u.ravel() * 256).astype(int), minlength=256)).pvalue > level
    half = u.shape[1] // 2  # where one word of a block goes over into the other
    pairs = {"position": (u[:, :-1], u[:, 1:]), "step": (u[:-1], u[1:]), "word": (u[:, :half], u[:, half:])}
    for name, (a, b) in pairs.items():
        correlation = np.corrcoef(a.ravel(), b.ravel())[0, 1]
        assert abs(correlation) * np.sqrt(a.size) < stats.norm.isf(level / 6), name
