"""Uniform numbers for a batch of chains: JAX's threefry in counter mode, no word of it wasted."""

import math
from typing import Any

import jax
import jax.numpy as jnp

from mcmc1d.numerics import require
from mcmc1d.types import Array, Float, Int, Key, UInt32

# Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3": Threefry-2x32 with 20 rounds, as in JAX.
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def threefry(key: UInt32[Array, " 2"], high: UInt32[Array, "..."], low: UInt32[Array, "..."]) -> tuple[Array, Array]:
    """The two words of the block cipher at each counter (high, low): the bits of `jax.extend.random.threefry2x32_p`.

    Written out, because JAX rolls the rounds into a loop on a CPU, where they then pass through memory.
    """
    schedule = (key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(0x1BD11BDA))
    x, y = high + schedule[0], low + schedule[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = x + y
            y = (y << rotation) | (y >> (32 - rotation))
            y = x ^ y
        x = x + schedule[(group + 1) % 3]
        y = y + schedule[(group + 2) % 3] + jnp.uint32(group + 1)
    return x, y


def uniforms(key: Key, step: Int[Array, ""] | int, shape: tuple[int, int], dtype: Any) -> Float[Array, "r n"]:
    """Independent uniform numbers on [0, 1) for one step: multiples of 2**-23 in float32, of 2**-52 in float64.

    They are a function of the (threefry) key, the step and the position alone. `jax.random.uniform` keeps one of the
    two words of a block; both are used here, for half the cost, which is most of the cost of a step in one dimension.
    """
    count = math.prod(shape)
    wide = jnp.dtype(dtype).itemsize == 8
    blocks = count if wide else -(-count // 2)
    data = jax.random.key_data(key)
    require(
        data.shape == (2,),
        f"the random key must be one threefry key, as jax.random.key(seed) makes it, not of {data.shape} words; "
        'name the generator where it is not the default: jax.random.key(seed, impl="threefry2x32")',
    )
    x, y = threefry(data, jnp.asarray(step).astype(jnp.uint32), jnp.arange(blocks, dtype=jnp.uint32))
    if not wide:
        bits = jnp.concatenate([x, y])[:count].reshape(shape)
        one = jnp.uint32(0x3F800000)  # the bits of 1.0: with a random mantissa, a number in [1, 2)
        return (jax.lax.bitcast_convert_type((bits >> 9) | one, jnp.float32) - 1).astype(dtype)
    mantissa = ((x.astype(jnp.uint64) << 32) | y.astype(jnp.uint64)) >> 12
    one = jnp.uint64(0x3FF0000000000000)
    return (jax.lax.bitcast_convert_type(mantissa | one, jnp.float64) - 1).reshape(shape)
