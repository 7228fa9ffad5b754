"""What can not be sampled is refused with a line that names it; exact joint laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import moves, targets, techniques, weights

SINUSOID = targets.Sinusoid(0.9, 2.0, 0.1, 3.0)
PAIR = (techniques.Tent(0.3), techniques.PiecewiseConstant([0, 0.4, 0.6, 1], [1, 0, 2]))
LONG = techniques.PiecewiseConstant([0, 2], [1])
MANY = mcmc1d.Multiplexed(SINUSOID, (techniques.Tent(0.3), techniques.Ramp(1.0)))
KEY = jax.random.key(0)
HALF = techniques.PiecewiseConstant([0, 0.5, 1], [1, 0])


def of(function):
    return targets.FromFunction(function)


class Own(moves.Move):
    """A user's step of u alone."""

    def dim_w(self, target):
        return target.dim_u

    def propose(self, target, state, w):
        return moves.Proposal(mcmc1d.State(state.index, (state.u + w) % 1), (1 - w) % 1, jnp.zeros((), w.dtype))


def test_a_step_of_u_alone_of_a_users_own_goes_with_a_technique_change():
    moves.StepAndChange(Own()).check(MANY)
    moves.StepAndChange(moves.CoordinateStep(0.1, 0)).check(MANY)
    moves.StepAndChange(moves.ScaledStep(0.3)).check(mcmc1d.Multiplexed(SINUSOID, techniques.Tent(0.3)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mcmc1d.Multiplexed(of(lambda x: x - 0.5), PAIR), "FromFunction is negative at x = 0.00"),
        (lambda: mcmc1d.Multiplexed(of(lambda x: x / 0 * 0), PAIR), "NaN"),
        (lambda: mcmc1d.Multiplexed(of(lambda x: 0 * x), PAIR), "zero at all of 2048 probes.*give more, probes="),
        (lambda: mcmc1d.Multiplexed(of(lambda x: 1 / (0 * x)), PAIR), "infinite"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, HALF), "no technique reaches x = 0.50"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, PAIR, lambda x, p: 0.9 * p / p.sum()), "sum to 0.9, not to one"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, PAIR, lambda x, p: jnp.array([0.5, 0.5])), "weight of technique 1"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, PAIR, lambda x, p: jnp.array([1.5, -0.5])), "NaN or negative"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, ()), "one technique at least"),
        (lambda: targets.Sinusoid(1.5), "amplitude of 1.5 makes the target negative"),
        (lambda: targets.Tabulated([1, -1]), "value"),
        (lambda: targets.GaussianMixture([0.5], [0.0], [1.0]), "sigmas must be positive"),
        (lambda: techniques.Mixture(PAIR, (0.5, 0.6)), "sum to one"),
        (lambda: techniques.Tent(1.0), "mode must lie strictly between"),
        (lambda: techniques.RaisedSinusoid(1.1), "negative"),
        (lambda: techniques.RaisedSinusoid(0.5, 0), "whole number"),
        (lambda: techniques.TruncatedNormal(0.5, -1), "sigma must be positive"),
        (lambda: techniques.PiecewiseConstant([0, 1, 0.5], [1, 1]), "must rise"),
        (lambda: moves.SmallStep(0.0), "sigma must be positive"),
        (lambda: moves.TechniqueChange([[0.5, 0.4], [0.5, 0.5]]), "row"),
        (lambda: moves.Mixture({"a": (0.5, moves.LargeStep())}), "sum to one"),
        (lambda: weights.Power(-1), "beta must be positive"),
        (lambda: mcmc1d.Histogram([0, 0.5, 0.5]), "Histogram: the edges must rise"),
        (lambda: mcmc1d.Histogram(2.5), "must be a whole number"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, techniques.Tent), r"give an instance, Tent\(...\), not the class Tent"),
        (lambda: mcmc1d.Multiplexed(lambda x: x, PAIR), "FromFunction makes one of a function"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, PAIR, lambda x, p: p[:1]), r"shape \(2,\), not \(1,\)"),
        (lambda: mcmc1d.Multiplexed(SINUSOID, PAIR, lambda x, p: p.sum()), r"shape \(2,\), not \(\)"),
        (lambda: techniques.Mixture(PAIR, (1.5, -0.5)), "must not be negative"),
        (lambda: techniques.Compose((LONG, techniques.Tent())), "makes samples from 0.* to 2.*in the unit cube"),
        (
            lambda: moves.StepAndChange(moves.ScaledStep(0.3)).check(MANY),
            "ScaledStep does to u depends",
        ),
        (lambda: moves.StepAndChange(moves.ReversibleJump()).check(MANY), "ReversibleJump does to u depends"),
        (lambda: moves.StepAndChange(moves.CoordinateStep(0.1, 99)).check(MANY), "CoordinateStep"),
        (lambda: targets.FromFunction(jnp.exp, -np.inf, 0.0), "both finite"),
        (lambda: mcmc1d.exact_start(KEY, MANY, 0), "count must be a whole number, 1 at least"),
        (lambda: mcmc1d.exact_start(KEY, MANY, 10, index=7), "must lie in 0..1, not 7"),
        (lambda: mcmc1d.normalisation(KEY, MANY, 0), "samples must be a whole number, 2 at least"),
        (lambda: moves.Mixture({"a": (1.5, moves.LargeStep()), "b": (-0.5, moves.SmallStep())}), "not be negative"),
    ],
)
def test_it_is_refused_with_the_reason(make, message):
    with np.errstate(all="ignore"), pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    "target",
    [
        SINUSOID,
        targets.GaussianMixture([0.5], [0.1], [1]),
        targets.PiecewiseLinear([0, 1], [1, 2]),
        targets.Tabulated([1]),
    ],
)
@pytest.mark.parametrize("edges", [[0, 0.5, 0.5, 1], [1, 0], [0.5]])
def test_bins_that_do_not_rise_are_refused(target, edges):
    with pytest.raises(ValueError, match=f"{type(target).__name__}.bin_masses: the edges must rise"):
        target.bin_masses(np.array(edges, float))


HEURISTICS = [weights.Balance(), weights.Power(), weights.Maximum(), lambda x, p: p / p.sum()]


@pytest.mark.parametrize("heuristic", HEURISTICS)
def test_joint_law_is_the_target_shared_out(heuristic):
    edges = np.array([0, 0.1, 0.4, 0.55, 1.0])
    joint = mcmc1d.Multiplexed(SINUSOID, PAIR, heuristic).joint_masses(edges)
    masses = SINUSOID.bin_masses(edges)
    assert joint.shape == (2, 4)
    assert np.allclose(joint.sum(0), masses / masses.sum(), atol=1e-10)


def test_joint_law_of_the_balance_heuristic_in_closed_form():
    """f = 1, a ramp 2 x and a uniform: w = 2 x / (1 + 2 x), whose integral over [0, a] is a - ln(1 + 2 a) / 2."""
    target = mcmc1d.Multiplexed(of(jnp.ones_like), (techniques.Ramp(2.0), techniques.Uniform()))
    ramp = target.joint_masses(np.array([0, 0.25, 1.0]))[0]
    below = np.array([0, 0.25, 1.0]) - np.log1p(2 * np.array([0, 0.25, 1.0])) / 2
    assert np.allclose(ramp, np.diff(below), atol=1e-10)
