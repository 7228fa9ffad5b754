"""The plane end to end: joint masses, histograms, and the moves of the library on planar techniques."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d.moves import AimedJump, Mixture, MultipleTry, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.moves.multiple_try import by_target
from mcmc1d.planar_histogram import Histogram2D
from mcmc1d.targets import Ring
from mcmc1d.targets.planar import board
from mcmc1d.techniques import ConcentricDisk, MarginalConditional, PolarDisk, Triangle
from mcmc1d.verify import verify
from mcmc1d.verify.mutants.jumps import no_jacobian

pytestmark = pytest.mark.slow

TABLE = MarginalConditional([[1, 2, 0.5, 1], [3, 1, 1, 0.2], [1, 0.3, 2, 1]])
LEANING = Triangle([[0.1, 0.2], [0.9, 0.1], [0.3, 0.95]])
DISK = ConcentricDisk((0.5, 0.5), 0.45)
TARGET = mcmc1d.Multiplexed(Ring(), (TABLE, DISK))
EDGES = np.linspace(0, 1, 9)


def both(jump):
    return Mixture({"small": (0.6, SmallStep(0.1)), "jump": (0.4, jump)})


def test_joint_masses_sum_to_the_law_of_x_and_weigh_it():
    target = mcmc1d.Multiplexed(Ring(), (TABLE, DISK, LEANING))
    joint, x = target.joint_masses((EDGES, EDGES)), target.target.bin_masses((EDGES, EDGES))
    np.testing.assert_allclose(joint.sum(0), x / x.sum(), rtol=0, atol=1e-12)
    few = (EDGES[[0, 3, 8]], EDGES[[0, 5, 8]])
    coarse = target.joint_masses(few)
    again = np.add.reduceat(np.add.reduceat(joint, [0, 3], axis=1), [0, 5], axis=2)
    np.testing.assert_allclose(coarse, again, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kernel", [both(ReversibleJump()), both(AimedJump())])
def test_jumps_between_planar_techniques_keep_the_law(kernel):
    """At level 1e-5; 2^14 replicas show a CDF gap of 0.035 with probability 0.99."""
    assert verify(kernel, TARGET, replicas=2**14).passed


def test_multiple_try_keeps_the_law_of_a_board_with_holes():
    """At level 1e-5; 2^14 replicas show a CDF gap of 0.035 with probability 0.99; a hole must never be hit."""
    target = mcmc1d.Multiplexed(board(), (TABLE, PolarDisk((0.4, 0.6), 0.4)))
    assert verify(MultipleTry(StepAndChange(SmallStep(0.1)), 3, by_target), target, replicas=2**14).passed


def test_a_jump_without_its_jacobian_is_caught_in_the_plane():
    report = verify(both(no_jacobian(ReversibleJump())), TARGET, replicas=2**14)
    assert report.verdict.value == "FAIL"
    assert any("index, x[0], x[1]" in failure.name for failure in report.failures)


def test_what_a_run_adds_up_converges_to_the_exact_masses():
    """Every cell within 7 standard errors of 8 blocks: by Student's t with 7 degrees of freedom, 0.04 for 200 cells.

    Its own twin: the masses turned about are far off.
    """
    joint = TARGET.joint_masses((EDGES, EDGES[::2]))
    fine = np.linspace(0, 1, 65)
    masses = TARGET.target.bin_masses((fine, fine))
    mean = masses.sum(1) @ (fine[1:] + fine[:-1]) / 2 / masses.sum()
    exact = {"x": joint.sum(0), "joint": joint, "mean": mean}
    estimators = {
        "x": Histogram2D(EDGES, EDGES[::2]),
        "joint": Histogram2D(EDGES, EDGES[::2], joint=True),
        "mean": mcmc1d.Expectation(lambda x: x[0]),
    }
    run = mcmc1d.run(jax.random.key(3), both(AimedJump()), TARGET, steps=200, chains=2048, estimators=estimators)
    for name, value in exact.items():
        found, error = run.mean(name), run.standard_error(name)
        assert found.shape == np.shape(value)
        # The mean of the cells' middles is that of x but for 1e-4 of curvature inside the cells.
        assert np.all(np.abs(found - value) <= 7 * error + 1e-4), name
        if found.ndim:
            assert abs(found.sum() - 1) < 1e-6
            assert np.any(np.abs(found - value[..., ::-1, :]) > 20 * error + 1e-3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Histogram2D([0, 1], [1, 0]), "y_edges: the edges must rise"),
        (lambda: TARGET.joint_masses((EDGES[1:], EDGES)), "do not cover the domain"),
        (lambda: TARGET.joint_masses(EDGES), "edges are a pair"),
        (
            lambda: Histogram2D([0, 0.5], [0, 1]).init(TARGET, mcmc1d.Metropolis(SmallStep()), jnp.float32),
            "extend the edges",
        ),
    ],
)
def test_what_can_not_be_is_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()
