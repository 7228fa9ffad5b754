"""Operations, counted by hand."""

import jax
import jax.numpy as jnp

from experiments.support.roofline import operations


def test_operations_are_those_of_each_number():
    x = jnp.zeros(10)
    assert operations(lambda x: 2 * x + 1, x) == 20
    assert operations(lambda x: jnp.exp(x).reshape(2, 5), x) == 160
    assert operations(lambda x: jnp.where(x > 0, x, 1), x) == 20
    assert operations(jnp.sum, x) == 10


def test_loops_count_their_turns_and_branches_the_dearest():
    x = jnp.zeros(10)
    assert operations(lambda x: jax.lax.scan(lambda c, _: (c * c, None), x, length=7)[0], x) == 70
    assert operations(lambda x: jax.lax.cond(x[0] > 0, lambda y: y + y * y, lambda y: y, x), x) == 21
    assert operations(jax.jit(lambda x: x + x), x) == 10
