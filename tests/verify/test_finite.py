"""Exact enumeration on rings: right kernels are exact to 1e-12 in law and in deposits, wrong ones far off."""

import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.metropolis import Cycle, Metropolis
from mcmc1d.moves import (
    AimedJump,
    Antithetic,
    LargeStep,
    Mixture,
    MultipleTry,
    ReversibleJump,
    SmallStep,
    TechniqueChange,
)
from mcmc1d.state import State
from mcmc1d.techniques import Uniform
from mcmc1d.verify.finite import RingStep, enumerate_kernel, ring
from mcmc1d.verify.mutants.jumps import MUTANTS, WrongDeterminant

F = np.array([1, 3, 0.5, 2, 4.0])
T = [[0.2, 0.5, 0.3], [0.1, 0.1, 0.8], [0.6, 0.4, 0.0]]
SMALL = RingStep(5, {1: 0.6, -1: 0.4})
WIDE = RingStep(5, {1: 0.5, -1: 0.2, 2: 0.3})


def weights(x, p):
    wave = 0.15 * jnp.sin(5 * x)
    return jnp.stack([0.2 + wave, 0.5 - wave, jnp.full_like(x, 0.3)])


ONE = ring(F)
THREE = ring(F, (Uniform(),) * 3, weights=weights)
MIXED = Mixture({"step": (0.5, SMALL), "change": (0.2, TechniqueChange(T)), "jump": (0.3, AimedJump())})
RIGHT = {
    "step": (SMALL, ONE),
    "step that is never accepted one way": (WIDE, ONE),
    "change": (TechniqueChange(T), THREE),
    "reversible jump": (ReversibleJump(T), THREE),
    "aimed": (AimedJump(), THREE),
    "mixture": (MIXED, THREE),
    "cycle": (Cycle([Metropolis(SMALL), Metropolis(TechniqueChange(T), "plain")]), THREE),
}
WRONG = {
    "step without its determinant": (WrongDeterminant(SMALL, jnp.zeros_like), ONE),
    "lopsided matrix taken for symmetric": (MUTANTS["proposal_matrix_taken_for_symmetric"].subject, THREE),
    "determinant the wrong way round": (WrongDeterminant(TechniqueChange(T), jnp.negative), THREE),
}


@pytest.mark.parametrize("deposit", ["expected", "plain"])
@pytest.mark.parametrize("name", RIGHT)
def test_a_right_kernel_and_its_deposits_are_exact(name, deposit):
    kernel, (target, states) = RIGHT[name]
    kernel = kernel if isinstance(kernel, Cycle) else Metropolis(kernel, deposit)
    found = enumerate_kernel(kernel, target, states)
    assert np.abs(found.matrix.sum(1) - 1).max() < 1e-12
    assert np.abs(found.deposits.sum(1) - 1).max() < 1e-12
    assert np.abs(found.law @ found.matrix - found.law).max() < 1e-12
    assert np.abs(found.law @ found.deposits - found.law).max() < 1e-12


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_kernel_and_its_deposits_are_far_off(name):
    kernel, (target, states) = WRONG[name]
    found = enumerate_kernel(kernel, target, states)
    assert found.residual > 0.01
    assert found.deposit_residual > 0.01


def test_the_matrix_is_that_of_the_formula():
    """Metropolis-Hastings on a ring, written out."""
    matrix = np.zeros((5, 5))
    for a in range(5):
        for offset, chance in ((1, 0.6), (-1, 0.4)):
            b = (a + offset) % 5
            matrix[a, b] += chance * min(1, F[b] * (1 - chance) / (F[a] * chance))
        matrix[a, a] = 1 - matrix[a].sum()
    target, states = ONE
    assert np.abs(enumerate_kernel(SMALL, target, states).matrix - matrix).max() < 1e-12


def test_equal_cells_of_a_number_give_what_bisection_gives():
    """The offsets' probabilities are fifths; the accept is bisected."""
    target, states = ONE
    by_cells = enumerate_kernel(SMALL, target, states, numbers=[5, None])
    assert np.abs(by_cells.matrix - enumerate_kernel(SMALL, target, states).matrix).max() < 1e-12


def test_too_few_cells_of_a_number_are_found_out():
    """The opposite of a way back lies in an eighth of the number, which at the middle of a quarter is on the edge."""
    target, states = ring([1, 3, 0.5, 2, 4.0, 1.5])
    step = MultipleTry(RingStep(6, {1: 0.5, -1: 0.25, 3: 0.25}), 2, candidates=Antithetic())
    with pytest.raises(ValueError, match="the outcome changes inside of"):
        enumerate_kernel(step, target, states, numbers=[4, None, None])
    assert enumerate_kernel(step, target, states, numbers=[8, None, None]).residual < 1e-12


def test_the_law_is_the_target_and_its_weights():
    target, states = THREE
    found = enumerate_kernel(TechniqueChange(T), target, states).law
    x = (np.arange(5) + 0.5) / 5
    share = np.asarray(weights(jnp.asarray(x), None)[:2])
    share = np.concatenate([share, 1 - share.sum(0, keepdims=True)])
    assert np.allclose(found.reshape(3, 5), share * F / F.sum(), atol=1e-7)


def test_a_step_off_the_states_is_named():
    target, states = ONE
    with pytest.raises(ValueError, match=r"no state|not piecewise constant"):
        enumerate_kernel(SmallStep(0.1), target, states)
    with pytest.raises(ValueError, match="no state"):
        enumerate_kernel(SMALL, target, State(states.index[:2], states.u[:2]), numbers=[5, None])
    with pytest.raises(ValueError, match="the outcome changes inside of"):
        enumerate_kernel(LargeStep(), target, states, numbers=[5, None])


def test_a_plan_of_the_wrong_length_is_named():
    target, states = ONE
    with pytest.raises(ValueError, match="has 2 numbers"):
        enumerate_kernel(SMALL, target, states, numbers=[5])


@pytest.mark.parametrize("probabilities", [{1: 0.5}, {1: 1.5, -1: -0.5}])
def test_offsets_need_probabilities(probabilities):
    with pytest.raises(ValueError, match="sum to one"):
        RingStep(5, probabilities)
