"""Work for the few of a batch that ask for it: the same numbers as for all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d.batching import only_where
from mcmc1d.moves import AimedJump, LargeStep, Mixture, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.verify import check_move, hard_target


def work(scale, x):
    return {"sum": scale * jnp.sin(x).sum(), "both": jnp.outer(x, x), "count": jnp.int32(3)}


@pytest.mark.parametrize("size", [1, 5, 16, 1000])
@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_those_that_ask_get_what_all_would_and_the_others_zeros(size, share):
    rng = np.random.default_rng(size)
    needed, x = jnp.asarray(rng.random(size) < share), jnp.asarray(rng.normal(size=(3, size)))
    few = jax.jit(jax.vmap(lambda n, x: only_where(n, work, 2.0, x), in_axes=(0, -1)))(needed, x)
    every = jax.vmap(lambda x: work(2.0, x), in_axes=-1)(x)
    for name, values in every.items():
        mask = np.asarray(needed).reshape(-1, *[1] * (values.ndim - 1))
        np.testing.assert_allclose(few[name], np.where(mask, values, 0), rtol=1e-6)


def test_what_is_undefined_where_nobody_asks_stays_out_of_values_and_derivatives():
    x = jnp.linspace(-1.0, 1.0, 41)

    def root(x):
        return only_where(x > 0.3, jnp.sqrt, x)

    value, slope = jax.vmap(lambda x: jax.jvp(root, (x,), (1.0,)))(x)
    asked = np.asarray(x) > 0.3
    np.testing.assert_allclose(value, np.where(asked, np.sqrt(np.abs(x)), 0), rtol=1e-6)
    np.testing.assert_allclose(slope[asked], 0.5 / np.sqrt(x[asked]), rtol=1e-5)


def test_one_chain_alone_and_batches_of_batches():
    assert only_where(jnp.asarray(True), jnp.sqrt, jnp.asarray(4.0)) == 2
    assert only_where(jnp.asarray(False), jnp.sqrt, jnp.asarray(4.0)) == 0
    x = jnp.arange(12.0).reshape(3, 4)
    found = jax.vmap(jax.vmap(lambda x: only_where(x > 5, jnp.sqrt, x)))(x)
    np.testing.assert_allclose(found, np.where(x > 5, np.sqrt(x), 0), rtol=1e-6)


def mixture(seldom=()):
    moves = {
        "large": (0.2, StepAndChange(LargeStep())),
        "small": (0.4, SmallStep(0.1)),
        "jump": (0.2, ReversibleJump()),
        "aimed": (0.2, AimedJump()),
    }
    return Mixture(moves, seldom=seldom)


@pytest.mark.slow
@pytest.mark.parametrize("seldom", [("jump",), ("large", "small", "jump", "aimed")])
def test_a_mixtures_chains_are_the_same_whatever_is_seldom(seldom):
    target = hard_target()
    ran = [
        mcmc1d.run(jax.random.key(1), mixture(names), target, steps=50, chains=300, blocks=2).state
        for names in ((), seldom)
    ]
    np.testing.assert_array_equal(ran[0].index, ran[1].index)
    np.testing.assert_allclose(ran[0].u, ran[1].u, atol=1e-4)


@pytest.mark.slow
def test_a_mixture_with_seldom_moves_keeps_the_contract():
    moves = {"small": (0.6, SmallStep(0.1)), "jump": (0.4, ReversibleJump())}
    assert check_move(Mixture(moves, seldom=("jump",)))


def test_a_seldom_move_that_is_not_there():
    with pytest.raises(ValueError, match="seldom names no move of it: hop"):
        mixture(("hop",))
