"""What the contract of a move sees: holes in a technique, wrong indices, and how much of it is left out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d import Multiplexed, State
from mcmc1d.moves import AimedJump, LargeStep, Move, MultipleTry, Proposal, SmallStep, TechniqueChange
from mcmc1d.moves.technique import LOPSIDED
from mcmc1d.special import normal_quantile
from mcmc1d.targets import Checkerboard, Sinusoid
from mcmc1d.techniques import Rectangle, Uniform
from mcmc1d.verify import check_move, hard_target
from mcmc1d.verify.mutants.jumps import MUTANTS, WrongDeterminant


class UnknownSlope(Move):
    """A large step whose derivative is not a number at a few of the points: nothing can be said of it there."""

    share: float

    def dim_w(self, target):
        return target.dim_u

    def propose(self, target, state, w):
        hidden = jnp.where(w[0] < self.share, jnp.sqrt(jnp.where(w[0] < self.share, 0.0, 1.0) * w[0]), 0.0)
        return Proposal(State(state.index, w), state.u + 0 * hidden, jnp.zeros((), w.dtype))


class Stretched(Move):
    """A small step that is off by 1e-4 on the way back, far more than rounding; its own slope is steep."""

    def dim_w(self, target):
        return target.dim_u

    def propose(self, target, state, w):
        proposal = SmallStep(0.1).propose(target, state, w)
        steep = 1e-4 * jnp.sin(1e7 * state.u) / 1e7
        return Proposal(proposal.state, proposal.w + 1e-4 + steep, proposal.log_det)


class LogitStep(Move):
    """A Gaussian step of log(u / (1 - u)); its log-determinant times a factor, which is 1 where it is right.

    The derivative of a sigmoid near 1 has as few digits as 1 - u' has: it is autodiff that is off there.
    """

    factor: float = 1.0

    def dim_w(self, target):
        return target.dim_u

    def propose(self, target, state, w):
        there = jnp.log(state.u) - jnp.log1p(-state.u) + 0.7 * normal_quantile(w)
        density = jax.nn.log_sigmoid(there) + jax.nn.log_sigmoid(-there) - jnp.log(state.u) - jnp.log1p(-state.u)
        return Proposal(State(state.index, jax.nn.sigmoid(there)), 1 - w, self.factor * density.sum())


def failures(move, target=None):
    return {f.equation: f for f in check_move(move, target, points=2000, dtypes=[np.float64]).failures}


@pytest.mark.slow
def test_a_sigmoid_is_differentiated_badly_at_its_end():
    assert check_move(LogitStep(), points=2000)
    assert any("autodiff" in equation for equation in failures(LogitStep(1.001)))


def test_the_hard_target_has_a_hole_where_the_target_is_bright():
    target = hard_target()
    with jax.enable_x64(True):
        x = jnp.linspace(0.36, 0.49, 14)
        assert np.all(np.isneginf(jax.vmap(target.techniques[1].log_prob)(x)))
        assert target.joint_masses(np.array([0, 0.35, 0.5, 1]))[:, 1].sum() > 0.1
        reversed_f = jax.vmap(target.target.log_f)(1 - x)
        assert np.abs(reversed_f - jax.vmap(target.target.log_f)(x)).min() > 0.1


@pytest.mark.parametrize("name", ["wrong_beside_a_hole", "index_off_by_one"])
def test_a_mistake_beside_a_hole_and_a_wrong_index_are_caught(name):
    found = failures(MUTANTS[name].subject)
    assert any(MUTANTS[name].caught_by in equation for equation in found), found


def test_a_right_jump_is_held_to_its_determinant_beside_a_hole():
    report = check_move(AimedJump(), points=2000, dtypes=[np.float64])
    left_out = next(check for check in report.checks if "left out" in check.equation)
    assert left_out.error == 0
    assert report


def test_the_identity_on_a_target_is_told_to_be_checked_on_another():
    found = failures(TechniqueChange(), Multiplexed(Sinusoid(), Uniform()))
    (failure,) = found.values()
    assert "0 of 2000 random points" in failure.where
    assert "give `target`" in failure.where


def test_a_move_that_leaves_out_more_than_a_hundredth_fails():
    assert not failures(UnknownSlope(0.005))
    assert "at most 1 % of what may be accepted is left out" in next(iter(failures(UnknownSlope(0.05))))


def test_no_condition_number_excuses_more_than_a_thousandth():
    wrong = WrongDeterminant(LargeStep(), lambda log_det: log_det + 2e-3)
    assert any("autodiff" in equation for equation in failures(wrong))
    assert any("applied twice" in equation for equation in failures(Stretched()))


def test_the_worst_point_that_is_told_is_a_regular_one():
    """A determinant that is off where T_ij is positive, told with the state and the way back."""
    failure = failures(WrongDeterminant(TechniqueChange(LOPSIDED), jnp.zeros_like))[
        "float64: log_det = log|det d(u', w')/d(u, w)| by autodiff"
    ]
    assert "autodiff nan" not in failure.where
    assert "(index" in failure.where


class WithoutReturn(MultipleTry):
    """Multiple-try whose selector comes back at another place of its interval."""

    def propose(self, target, state, w):
        proposal = super().propose(target, state, w)
        return Proposal(proposal.state, proposal.w.at[-1].multiply(0.999), proposal.log_det)


def test_what_a_move_does_where_the_target_is_zero_is_no_mistake():
    """Half of this board is dark: from there multiple-try takes any lit candidate, and has no way back."""
    board = Multiplexed(Checkerboard([[1.0, 0.0], [0.0, 2.0]]), Rectangle())
    assert check_move(MultipleTry(SmallStep(0.3), 3), board, dtypes=(np.float64,))
    assert not check_move(WithoutReturn(SmallStep(0.3), 3), board, dtypes=(np.float64,))
