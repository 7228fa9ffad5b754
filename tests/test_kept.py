"""What a target finds beside log f, and a state keeps."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import LargeStep, Mixture, ReversibleJump, SmallStep
from mcmc1d.pooled import Pooled, PooledDeposit, pooled
from mcmc1d.targets import Sinusoid, Target
from mcmc1d.techniques import Ramp, Several, Tent
from mcmc1d.verify import check_move

PAIR = Tent(0.3), Ramp(1.2)


class Keeping(Target):
    """A sinusoid that keeps the eighth that x lies in, and whether that is the first."""

    off: float = 0.0

    def log_f(self, x):
        return Sinusoid(0.9, 1.5, 0.1).log_f(x)

    def look(self, x):
        eighth = (x * 8).astype(jnp.int32)
        return self.log_f(x) + self.off, {"eighth": eighth, "first": eighth == 0}

    def bin_masses(self, edges):
        return Sinusoid(0.9, 1.5, 0.1).bin_masses(edges)


MOVES = ReversibleJump(), SmallStep(0.2), Mixture({"jump": (0.5, ReversibleJump()), "small": (0.5, SmallStep(0.2))})


@pytest.mark.parametrize("move", MOVES, ids=["jump", "step", "mixture"])
def test_it_goes_with_the_state_through_steps_and_jumps(move):
    target, kernel = mcmc1d.Multiplexed(Keeping(), PAIR), Metropolis(move)
    start = mcmc1d.exact_start(jax.random.key(0), target, 500)
    numbers = jnp.asarray(np.random.default_rng(0).random((500, kernel.dim_w(target))))
    step = jax.jit(jax.vmap(lambda s, w: kernel.step(target, target.evaluate(s), w)))(start, numbers)
    seen = step.state.seen
    assert step.info.accepted.any()
    np.testing.assert_array_equal(seen.kept["eighth"], (seen.x * 8).astype(jnp.int32))
    np.testing.assert_array_equal(seen.kept["first"], seen.x < 1 / 8)


def test_what_is_kept_need_not_be_numbers_for_a_move_to_be_checked():
    report = check_move(ReversibleJump(), mcmc1d.Multiplexed(Keeping(), PAIR))
    assert report.passed, report


def test_a_target_that_says_two_things_is_refused():
    with pytest.raises(ValueError, match="Keeping: look says another log f than log_f at x"):
        mcmc1d.Multiplexed(Keeping(0.1), PAIR)


def test_a_family_need_not_know_of_it():
    """`look` returned five things before there was a sixth."""

    class Five(Several):
        def look(self, target, index, u):
            return tuple(super().look(target, index, u))[:5]

    target = mcmc1d.Multiplexed(Keeping(), Five(PAIR))
    assert target.evaluate(mcmc1d.State(jnp.asarray(1), jnp.asarray([0.3]))).seen.kept == ()


@pytest.mark.parametrize("combine", ["sum", "maximum"])
def test_pooled_deposits_are_of_what_the_techniques_make_at_both_ends(combine):
    """Against contributions that are worked out anew from both u."""
    target = pooled(mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), PAIR), combine)
    own, kernel = Pooled(mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), PAIR), combine), PooledDeposit(LargeStep())

    @jax.vmap
    def both(u, w):
        step = kernel.step(target, target.evaluate(mcmc1d.State(jnp.asarray(0), u)), w)
        a, weight, x = step.info.acceptance[0], [], []
        for place, share in ((u, 1 - a), (w[:1], a)):
            made, log_c = own.contributions(place)
            x.append(made)
            weight.append(share * jnp.exp(log_c - own.combined(log_c)))
        return step.deposits.x, step.deposits.weight, jnp.concatenate(x), jnp.concatenate(weight)

    u, w = (jnp.asarray(np.random.default_rng(k).random((300, 1 + k))) for k in range(2))
    x, weight, anew, expected = jax.jit(both)(u, w)
    np.testing.assert_allclose(x, anew, rtol=1e-6)
    np.testing.assert_allclose(weight, expected, rtol=2e-5, atol=1e-6)


def test_a_move_that_evaluates_without_it_is_named():
    class Forgetful(SmallStep):
        def propose(self, target, state, w):
            proposal = super().propose(target, state, w)
            there = target.evaluate(proposal.state)
            bare = dataclasses.replace(there, eval=dataclasses.replace(there.seen, kept=()))
            return dataclasses.replace(proposal, state=bare)

    target = pooled(mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), PAIR))
    with pytest.raises(ValueError, match="Forgetful returns a state that it has evaluated itself"):
        mcmc1d.run(jax.random.key(0), PooledDeposit(Forgetful(0.1)), target, steps=2, chains=8)
