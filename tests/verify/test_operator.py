"""The operator's predictions against long simulations: laws of wrong kernels, autocorrelation and gap of right ones.

Every comparison allows five standard errors of the simulation, or more: under 6e-7 a test where it is normal.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d.metropolis import Cycle, Metropolis
from mcmc1d.moves import Mixture, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.pooled import floored, samples
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Mixture as MixtureTechnique
from mcmc1d.techniques import PiecewiseConstant, Ramp, Tent, Uniform
from mcmc1d.verify.goodness import total_variation
from mcmc1d.verify.mutants.jumps import Frozen, no_jacobian
from mcmc1d.verify.operator import Operator, step_operator, transition_operator
from mcmc1d.weights import Maximum

EDGES = np.linspace(0, 1, 21)
POINTS = 2**17
SIGMA = 0.06
TWO = mcmc1d.Multiplexed(Sinusoid(0.9), (Tent(), PiecewiseConstant([0, 0.5, 1], [1.6, 0.4])))


def kernel(jump):
    return Mixture({"small": (0.5, SmallStep(0.1)), "jump": (0.5, jump)})


@pytest.fixture(scope="module")
def right():
    return transition_operator(kernel(ReversibleJump()), TWO, points=POINTS)


@pytest.fixture(scope="module")
def wrong():
    return transition_operator(kernel(no_jacobian(ReversibleJump())), TWO, points=POINTS)


def test_a_right_kernel_keeps_the_exact_law(right):
    law = right.law_of(EDGES)
    assert total_variation(law.masses, TWO.joint_masses(EDGES)) < 1e-3
    assert law.noise + law.grid < 2e-3
    assert repr(right).startswith("<Operator on ")


@pytest.mark.slow
def test_slivers_between_the_cells_of_u_and_of_x_are_no_traps():
    """The maximum heuristic makes cells with a point or two of the net, all of whose proposals are dark."""
    target = mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), (Tent(0.4), Ramp(1.2)), Maximum())
    for seed in range(4):
        law = transition_operator(StepAndChange(SmallStep(0.1)), target, points=2**15, seed=seed).law_of(EDGES)
        assert total_variation(law.masses, target.joint_masses(EDGES)) < 1e-3 + 2 * law.noise < 0.02


@pytest.mark.slow
def test_the_noise_of_a_law_is_what_its_errors_are():
    """Of a floored index four cells of u say little of x, and the starts inside them all.

    Eight laws of 20 bins, two nets each: errors over noise came to 0.93, 0.94 and 1.40 at the seeds 0 to 2 (this is 0);
    with the starts of one net for all, a mistake that was made, to 2.10, 1.57 and 2.66.
    """
    target = floored(mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), (Tent(0.3), Ramp(1.2), Uniform())))
    exact = Sinusoid(0.9, 1.5, 0.1).bin_masses(EDGES)
    flux = transition_operator(SmallStep(0.1), target, points=2**20, scrambles=16, u_cells=2).flux
    off, noise = [], []
    for k in range(0, 16, 2):
        pair = dataclasses.replace(flux, scrambles=flux.scrambles[k : k + 2], points=flux.points[k : k + 2])
        law = Operator(pair).law_of(EDGES, lambda u: samples(target.target, u))
        off.append(total_variation(law.masses[0], exact / exact.sum()))
        noise.append(law.noise)
    assert 0.5 < np.mean(off) / np.mean(noise) < 1.5


def test_the_law_of_a_wrong_kernel_is_the_one_simulated(wrong):
    """2^22 steps after a burn-in of 200; the noise of both makes 0.002 of total variation, the mistake 0.2.

    The sum over 40 bins is beyond twice its expectation with a probability under 1e-9, were the bins independent.
    """
    move = kernel(no_jacobian(ReversibleJump()))
    burnt = mcmc1d.run(jax.random.key(1), move, TWO, steps=200, chains=4096)
    estimators = {"joint": mcmc1d.Histogram(20, joint=True)}
    run = mcmc1d.run(
        jax.random.key(2), move, TWO, steps=1024, chains=4096, blocks=16, estimators=estimators, start=burnt.state
    )
    joint, errors = run.mean("joint"), run.standard_error("joint")
    law = wrong.law_of(EDGES)
    assert total_variation(law.masses, TWO.joint_masses(EDGES)) > 0.1
    noise = np.hypot(errors, law.standard_error).sum() * np.sqrt(2 / np.pi) / 2
    assert noise < 4e-3
    assert total_variation(law.masses, joint) < 1e-3 + 2 * noise


def test_detailed_balance_names_the_wrong_move(right, wrong):
    for operator_, jump_is_right in ((right, True), (wrong, False)):
        kinds = operator_.detailed_balance_residual().by_kind
        assert kinds["small"][0] < 10 * kinds["small"][1] + 1e-4
        assert (kinds["jump"][0] < 10 * kinds["jump"][1] + 1e-4) == jump_is_right


@pytest.fixture(scope="module")
def one_dimension():
    return mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), Uniform())


@pytest.fixture(scope="module")
def plain(one_dimension):
    return transition_operator(SmallStep(SIGMA), one_dimension, points=2**15)


def test_autocorrelation_time_and_gap_are_those_of_a_long_simulation(plain, one_dimension):
    """2048 independent stationary chains of 1024 steps, on an asymmetric target of two modes.

    The variance of a mean over n steps has a relative standard error of sqrt(2 / 2047) = 3.1 %, and is tau / 2n = 2 %
    short of its limit; 18 % is five standard errors away. Between lags 30 and 60 the slowest function alone is left:
    the rate of decay is known to 2 %, held to 10 %.
    """
    x = mcmc1d.trace(jax.random.key(3), SmallStep(SIGMA), one_dimension, steps=1024, chains=2048).x.astype(np.float64)
    tau = plain.integrated_autocorrelation_time(lambda x: x)
    assert 0.82 < tau * x.var() / (1024 * x.mean(0).var(ddof=1)) < 1.18
    assert np.isclose(plain.asymptotic_variance(lambda x: x) / tau, x.var(), rtol=0.03)
    y = x - x.mean()
    early, late = (np.mean(y[lag:] * y[:-lag]) for lag in (30, 60))
    assert abs((1 - (late / early) ** (1 / 30)) / plain.spectral_gap() - 1) < 0.1


def test_a_smaller_step_would_have_failed_that_test(plain, one_dimension):
    other = transition_operator(SmallStep(0.05), one_dimension, points=2**15)
    ratio = other.integrated_autocorrelation_time(lambda x: x) / plain.integrated_autocorrelation_time(lambda x: x)
    assert ratio > 1.25
    assert other.spectral_gap() < 0.85 * plain.spectral_gap()


def test_values_on_cells_and_a_function_agree(plain):
    centres = plain.flux.cells.places[2] / 200 + 0.0025
    by_cells = plain.integrated_autocorrelation_time(centres)
    assert np.isclose(by_cells, plain.integrated_autocorrelation_time(lambda x: x), rtol=0.01)


def test_the_law_of_a_function_of_x(plain, one_dimension):
    law = plain.law_of([0, 0.25, 1], lambda x: x**2).masses
    exact = one_dimension.target.bin_masses(np.array([0, 0.5, 1]))
    assert np.allclose(law, exact / exact.sum(), atol=2e-3)


def test_a_cycle_is_right_and_not_reversible(one_dimension):
    cycle = Cycle([Metropolis(SmallStep(0.1)), Metropolis(SmallStep(0.4))])
    law = transition_operator(cycle, one_dimension, points=2**16).law_of(EDGES)
    exact = one_dimension.target.bin_masses(EDGES)
    assert total_variation(law.masses[0], exact / exact.sum()) < 5 * law.noise + 2e-3


def test_a_kernel_that_never_moves_has_no_law_of_its_own(one_dimension):
    with pytest.raises(ValueError, match=r"reducible|not unique"):
        transition_operator(Frozen(SmallStep()), one_dimension, points=1024, x_cells=20, u_cells=20).stationary()


def test_four_dimensions_are_too_many():
    nested = Tent()
    for _ in range(3):
        nested = MixtureTechnique((nested, Ramp()), [0.5, 0.5])
    with pytest.raises(ValueError, match="three at most"):
        transition_operator(SmallStep(), mcmc1d.Multiplexed(Sinusoid(), nested))


def log_density(x):
    return -2 * x[0]


def make_step(fold):
    def step(key, x):
        a, b = jax.random.split(key)
        proposed = fold(x + 0.3 * jax.random.normal(a, x.shape))
        accepted = jnp.log(jax.random.uniform(b)) < log_density(proposed) - log_density(x)
        return jnp.where(accepted, proposed, x)

    return step


@pytest.mark.parametrize(("fold", "is_right"), [(lambda x: x % 1, True), (lambda x: jnp.clip(x, 0, 1), False)])
def test_a_plain_step_that_wraps_is_right_and_one_that_clamps_is_wrong(fold, is_right):
    box = {"log_density": log_density, "lower": [0.0], "upper": [1.0]}
    law = step_operator(make_step(fold), **box, cells=40, points=POINTS).law_of(EDGES)
    exact = np.diff(np.exp(-2 * EDGES)) / (np.exp(-2) - 1)
    distance = total_variation(law.masses[0], exact)
    assert (distance < 1e-2) == is_right
    assert is_right or distance > 0.05


def test_the_nets_draw_steps_of_their_own():
    """With the keys of the first in all of them the spread, and so the noise, would be next to nothing."""
    operator = step_operator(
        lambda key, x: jax.random.uniform(key, x.shape),
        log_density=lambda x: 0.0 * x[0],
        lower=0,
        upper=1,
        cells=4,
        points=2**12,
    )
    first, second = (np.asarray(flux.sum(0)).ravel() for flux in operator.flux.scrambles)
    assert 1e-3 < np.abs(first - second).max() < 0.05  # 0.0068, the standard deviation of a mean of 4096
