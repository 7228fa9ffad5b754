import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.random import threefry2x32_p
from scipy import stats

import mcmc1d
from mcmc1d import moves, targets, techniques
from mcmc1d.random import SOURCES, Hash32, Threefry, source, threefry, uniforms


@pytest.fixture(autouse=True, params=[np.float32, np.float64], ids=["float32", "float64"])
def dtype(request):
    with jax.enable_x64(request.param == np.float64):
        yield request.param


@pytest.fixture(params=list(SOURCES))
def numbers(request):
    return source(request.param)


def draw(seed, step, shape, dtype, numbers=SOURCES["threefry"]):
    return np.asarray(numbers.uniforms(jax.random.key(seed), step, shape, dtype))


def test_threefrys_bits_are_jaxs():
    rng = np.random.default_rng(0)
    key = jnp.asarray(rng.integers(2**32, size=2, dtype=np.uint32))
    high, low = (jnp.asarray(np.r_[w, 0, 2**32 - 1].astype(np.uint32)) for w in rng.integers(2**32, size=(2, 1000)))
    ours = threefry(key, high, low)
    theirs = threefry2x32_p.bind(jnp.full_like(high, key[0]), jnp.full_like(high, key[1]), high, low)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (1, 7), (3, 333), (4, 256)])
def test_uniforms_are_multiples_of_a_power_of_two_in_the_unit_interval(dtype, shape, numbers):
    u = draw(1, 5, shape, dtype, numbers)
    assert u.shape == shape
    assert u.dtype == dtype
    assert ((u >= 0) & (u < 1)).all()
    scaled = np.ldexp(u, np.finfo(dtype).nmant)
    np.testing.assert_array_equal(scaled, np.round(scaled))
    assert np.any(np.asarray(scaled, np.int64) % 2 == 1) or u.size < 20  # the last bit is used


def test_uniforms_differ_by_position_step_and_key(dtype, numbers):
    """No number comes twice; by chance two of 2400 would agree, in float32 with probability 0.3, so six are let pass.

    False-alarm rate: 1e-6 (a Poisson count of mean 0.35 above 6) in float32, 1e-9 in float64.
    """
    drawn = [draw(seed, step, (3, 201), dtype, numbers) for seed, step in ((0, 0), (0, 1), (1, 0), (1, 1))]
    everything = np.concatenate([u.ravel() for u in drawn])
    repeats = everything.size - np.unique(everything).size
    assert repeats <= (6 if dtype == np.float32 else 0)
    np.testing.assert_array_equal(draw(1, 1, (3, 201), dtype, numbers), drawn[3])


def test_the_default_is_threefry_and_a_step_given_as_an_array_is_the_same_step(dtype):
    key = jax.random.key(0)
    np.testing.assert_array_equal(uniforms(key, jnp.asarray(7), (2, 5), dtype), draw(0, 7, (2, 5), dtype))


# --- statistics of whole steps ---

LEVEL = 1e-7


def suspicions(numbers, dtype, seed=3):
    """The smallest p-value of each kind, corrected for how many there are: 2**20 numbers, 64 steps of four rows.

    One test each: equal cells of the unit interval, by the upper and by the lowest bits; pairs of neighbours in
    position, row, step and key on a grid of 16 x 16 cells, which see any dependence of the upper four bits; triples of
    rows on 8 x 8 x 8; collisions of 32-bit words across all that was drawn.
    """
    key, n, steps = jax.random.key(seed), 4096, 64
    every = jax.jit(jax.vmap(lambda key, k: numbers.uniforms(key, k, (4, n), dtype), in_axes=(None, 0)))
    u = np.asarray(every(key, jnp.arange(steps)), np.float64)  # steps, rows, positions
    other = np.asarray(every(jax.random.key(seed + 1), jnp.arange(steps)), np.float64)

    def flat(cells, count):
        return stats.chisquare(np.bincount(cells.ravel().astype(int), minlength=count)).pvalue

    def pair(a, b):
        return flat(np.floor(a * 16) * 16 + np.floor(b * 16), 256)

    low = np.ldexp(u, np.finfo(dtype).nmant).astype(np.int64) % 256
    found = {
        "upper bits": flat(np.floor(u * 1024), 1024),
        "lowest bits": flat(low, 256),
        "position": pair(u[..., :-1], u[..., 1:]),
        "far position": pair(u[..., : n // 2], u[..., n // 2 :]),
        "row": pair(u[:, :-1], u[:, 1:]),
        "step": pair(u[:-1], u[1:]),
        "key": pair(u, other),
        "low by position": flat((low[..., :-1] % 16) * 16 + low[..., 1:] % 16, 256),
        "rows": flat((np.floor(u[:, 0] * 8) * 8 + np.floor(u[:, 1] * 8)) * 8 + np.floor(u[:, 2] * 8), 512),
    }
    return {name: min(1, p * len(found)) for name, p in found.items()}


def test_steps_are_uniform_and_independent(dtype, numbers):
    """False-alarm rate 1e-7 for each source and precision.

    Smallest error caught, with probability 0.99: one cell of 1024 off by 25 % of its mass, or every cell of a grid of
    256 by 1 % (a noncentrality of 100, from 2**20 numbers).
    """
    found = suspicions(numbers, dtype)
    assert min(found.values()) > LEVEL, found


@pytest.mark.parametrize("wrong", [Threefry(6), Hash32(0), Hash32(1)], ids=["threefry6", "hash0", "hash1"])
def test_too_few_rounds_are_caught(wrong, dtype):
    """The twins: rounds and multiplications left out."""
    assert min(suspicions(wrong, dtype).values()) < LEVEL


def test_an_unknown_source_is_refused(dtype):
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Uniform())
    for go in (mcmc1d.run, mcmc1d.trace):
        with pytest.raises(ValueError, match=r"no random-number source 'philox'; known: threefry, threefry13, hash32"):
            go(jax.random.key(0), moves.SmallStep(), target, steps=1, chains=2, random="philox")
