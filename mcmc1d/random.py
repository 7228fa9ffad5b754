"""Uniform numbers for a batch of chains, from a source chosen by name: a function of key, step and position."""

import abc
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.random import threefry_2x32

from mcmc1d.checks import require
from mcmc1d.types import Array, Float, Int, Key, UInt32

# Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3": Threefry-2x32, as in JAX.
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def threefry(
    key: UInt32[Array, " 2"], high: UInt32[Array, "..."], low: UInt32[Array, "..."], rounds: int = 20
) -> tuple[Array, Array]:
    """The two words of the block cipher at each counter (high, low).

    With 20 rounds, the bits of `jax.extend.random.threefry2x32_p`. Written out, because JAX rolls the rounds into a
    loop on a CPU, where they then pass through memory.
    """
    schedule = (key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(0x1BD11BDA))
    x, y = high + schedule[0], low + schedule[1]
    for k in range(rounds):
        rotation = _ROTATIONS[k // 4 % 2][k % 4]
        x = x + y
        y = (y << rotation) | (y >> (32 - rotation))
        y = x ^ y
        if k % 4 == 3:
            group = k // 4 + 1
            x = x + schedule[group % 3]
            y = y + schedule[(group + 1) % 3] + jnp.uint32(group)
    return x, y


class Source(eqx.Module):
    """A source of random words in counter mode: nothing is carried from step to step, and any step can be had at once.

    Drawn in the loop over the steps, where a block of numbers drawn before it would pass through memory.
    """

    @abc.abstractmethod
    def words(self, key: UInt32[Array, " 2"], step: UInt32[Array, ""], count: int) -> UInt32[Array, " count"]:
        """A random 32-bit word for each position of a step."""

    @abc.abstractmethod
    def pairs(self, key: UInt32[Array, " 2"], step: UInt32[Array, ""], count: int) -> tuple[Array, Array]:
        """Two of them for each position."""

    def uniforms(self, key: Key, step: Int[Array, ""] | int, shape: tuple[int, int], dtype: Any) -> Float[Array, "r n"]:
        """Independent uniform numbers on [0, 1) for one step: multiples of 2**-23 in float32, of 2**-52 in float64.

        They are a function of the (threefry) key, the step and the position alone.
        """
        count = math.prod(shape)
        data = jax.random.key_data(key)
        require(
            data.shape == (2,),
            f"the random key must be one threefry key, as jax.random.key(seed) makes it, not of {data.shape} words; "
            'name the generator where it is not the default: jax.random.key(seed, impl="threefry2x32")',
        )
        step = jnp.asarray(step).astype(jnp.uint32)
        if jnp.dtype(dtype).itemsize < 8:
            bits = self.words(data, step, count).reshape(shape)
            one = jnp.uint32(0x3F800000)  # the bits of 1.0: with a random mantissa, a number in [1, 2)
            return (jax.lax.bitcast_convert_type((bits >> 9) | one, jnp.float32) - 1).astype(dtype)
        x, y = self.pairs(data, step, count)
        mantissa = ((x.astype(jnp.uint64) << 32) | y.astype(jnp.uint64)) >> 12
        one = jnp.uint64(0x3FF0000000000000)
        return (jax.lax.bitcast_convert_type(mantissa | one, jnp.float64) - 1).reshape(shape)


class Threefry(Source):
    """Threefry-2x32 (Salmon et al. 2011) at the counter (step, position).

    20 rounds are JAX's, and the authors' choice with a margin; 13 are the fewest that passed their battery, TestU01's
    BigCrush. `jax.random.uniform` keeps one of the two words of a block; both are used here.
    """

    rounds: int = eqx.field(static=True, default=20)

    def words(self, key: UInt32[Array, " 2"], step: UInt32[Array, ""], count: int) -> UInt32[Array, " count"]:
        return jnp.concatenate(self.pairs(key, step, -(-count // 2)))[:count]

    def pairs(self, key: UInt32[Array, " 2"], step: UInt32[Array, ""], count: int) -> tuple[Array, Array]:
        return threefry(key, step, jnp.arange(count, dtype=jnp.uint32), self.rounds)


class Hash32(Source):
    """A hash of the position under a key of the step: an eighth of threefry's cost, and tested here only.

    Threefry of (key, step) gives the odd multiplier m and the offset s of each step; the word at position i is
    mix(m i + s), `mix` the permutation `triple32` of C. Wellons, "Prospecting for hash functions" (2018), whose
    avalanche is biased by 0.02 of the ideal's spread. Within a step no word comes twice, among 2**32; two steps share
    words as often as chance has it. `rounds` under 3 leave out multiplications, for tests.
    """

    rounds: int = eqx.field(static=True, default=3)

    def words(self, key: UInt32[Array, " 2"], step: UInt32[Array, ""], count: int) -> UInt32[Array, " count"]:
        # In two halves, although one range would do: what is joined XLA works out once, into memory; anything else so
        # cheap it works out again in each of the loops that read it, at two to three times the cost.
        return jnp.concatenate(self.pairs(key, step, -(-count // 2)))[:count]

    def pairs(self, key: UInt32[Array, " 2"], step: UInt32[Array, ""], count: int) -> tuple[Array, Array]:
        # JAX's own threefry, whose bits are the same: a loop on a CPU, which is as good for two words. Written out it
        # is worked out in both halves, and LLVM takes half an hour and more over that for AVX-512.
        multiplier, offset = threefry_2x32(key, jnp.stack([step, jnp.uint32(0xFFFFFFFF)]))
        position = jnp.arange(count, dtype=jnp.uint32)
        first, second = (self._mix(i * (multiplier | 1) + offset) for i in (position, position + jnp.uint32(count)))
        return first, second

    def _mix(self, x: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
        x = x ^ (x >> 17)
        for factor, shift in ((0xED5AD4BB, 11), (0xAC4C1B51, 15), (0x31848BAB, 14))[: self.rounds]:
            x = x * jnp.uint32(factor)
            x = x ^ (x >> shift)
        return x


SOURCES: dict[str, Source] = {"threefry": Threefry(), "threefry13": Threefry(13), "hash32": Hash32()}


def source(name: str) -> Source:
    """The source of that name; `ValueError` lists the known ones."""
    require(name in SOURCES, f"there is no random-number source {name!r}; known: {', '.join(SOURCES)}")
    return SOURCES[name]


def uniforms(key: Key, step: Int[Array, ""] | int, shape: tuple[int, int], dtype: Any) -> Float[Array, "r n"]:
    """`Source.uniforms` of threefry, the default."""
    return SOURCES["threefry"].uniforms(key, step, shape, dtype)


EXAMPLES = SOURCES
