"""Sub-chains and split samples, exactly on a ring; on the line by replicas; each beside a twin that must fail."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d.metropolis import Deposits, Kernel, Metropolis, acceptance
from mcmc1d.moves import LargeStep, Mixture, MultipleTry, SmallStep, StepAndChange
from mcmc1d.moves.multiple_try import around, row
from mcmc1d.moves.perturbations import LinearStep, TruncatedStep, UniformStep
from mcmc1d.subchain import SplitSample, SubChain
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Tent, Uniform
from mcmc1d.verify import RingStep, enumerate_kernel, ring, verify
from mcmc1d.verify.mutants.jumps import WrongDeterminant

pytestmark = pytest.mark.slow

TARGET, STATES = ring([1, 3, 0.5, 2, 4.0])
STEP = RingStep(5, {1: 0.75, -1: 0.25})
FAR = RingStep(5, {1: 0.25, 2: 0.5, -2: 0.25})
BOTH = Mixture({"large": (0.3, StepAndChange(LargeStep())), "small": (0.7, StepAndChange(SmallStep(0.1)))})
HARD = mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), (Tent(), Uniform()))


class Twin(Kernel):
    """A kernel that is `right` in everything but its step."""

    right: eqx.AbstractVar[Kernel]

    @property
    def kinds(self):
        return self.right.kinds

    def dim_w(self, target):
        return self.right.dim_w(target)

    def check(self, target):
        self.right.check(target)


class AtTheProposal(Twin):
    """A sub-chain that starts where the main chain has proposed to go, accepted or not."""

    right: SubChain

    def step(self, target, state, w):
        move = self.right.outer.move
        proposal = row(around(move, target, state, w[None, : move.dim_w(target)]), 0)
        possible = acceptance(state, proposal) > 0
        there = jax.tree.map(lambda a, b: jnp.where(possible, a, b), proposal.state, state)
        main, inner = self.right.step(target, state, w), self.right.step(target, there, w)
        return eqx.tree_at(lambda s: s.deposits, main, inner.deposits)


class AllOfIt(Twin):
    """A split sample that gives everything to the proposals, in proportion to their R_i, and keeps nothing."""

    right: SplitSample

    def step(self, target, state, w):
        step = self.right.step(target, state, w)
        given = step.deposits.weight[1:].sum()
        weight = jnp.where(given > 0, step.deposits.weight.at[0].set(0) / given, step.deposits.weight)
        return eqx.tree_at(lambda s: s.deposits, step, Deposits(step.deposits.x, step.deposits.index, weight))


def enumerated(kernel, plan, probes=17):
    found = enumerate_kernel(kernel, TARGET, STATES, plan, probes=probes, inner=8)
    assert np.abs(found.matrix.sum(1) - 1).max() < 1e-12
    return found


def test_a_sub_chain_and_its_deposits_are_exact():
    length = 2
    right = SubChain(FAR, STEP, length)
    plan = [4, None] * (length + 1)
    found, main, inner = enumerated(right, plan), enumerated(Metropolis(FAR), [4, None]), enumerated(STEP, [4, None])
    assert np.abs(found.matrix - main.matrix).max() < 1e-12  # the sub-chain leaves no trace
    # The mean over the sub-chain of P^k D.
    expected = sum(np.linalg.matrix_power(inner.matrix, k) @ inner.deposits for k in range(length)) / length
    assert np.abs(found.deposits - expected).max() < 1e-12
    assert found.deposit_residual < 1e-12
    assert enumerated(AtTheProposal(right), plan).deposit_residual > 1e-2


def test_a_sub_chain_of_multiple_tries_is_exact():
    right = SubChain(FAR, MultipleTry(STEP, 2))
    found = enumerated(right, [4, None, 4, 4, 4, None, None], probes=33)
    assert found.residual < 1e-12
    assert found.deposit_residual < 1e-12


def test_a_split_sample_is_exact_and_one_that_keeps_nothing_is_not():
    m = 3
    plain = enumerated(Metropolis(STEP), [4, None])
    found = enumerated(SplitSample(STEP, m), [4] * m + [None])
    assert np.abs(found.matrix - plain.matrix).max() < 1e-12
    assert np.abs(found.deposits - plain.deposits).max() < 1e-12  # the same expectation, with less variance
    assert enumerated(AllOfIt(SplitSample(STEP, m)), [4] * m + [None]).deposit_residual > 1e-2


def test_on_the_line_a_sub_chains_deposits_are_right_and_its_twin_is_caught():
    """At level 1e-5; 2^14 replicas show a CDF gap of 0.035 with probability 0.99."""
    kernel = SubChain(BOTH, MultipleTry(StepAndChange(SmallStep(0.1)), 2), 3)
    assert verify(kernel, HARD, replicas=2**14).passed
    report = verify(AtTheProposal(kernel), HARD, replicas=2**14)
    assert {failure.layer for failure in report.failures} == {"deposits"}


def test_a_clamped_gaussian_without_its_normaliser_is_caught():
    step = TruncatedStep(0.4)
    line = mcmc1d.Multiplexed(Sinusoid(0.9, 1.5, 0.1), Uniform())
    assert verify(step, line, replicas=2**14).passed
    assert not verify(WrongDeterminant(step, jnp.zeros_like), line, replicas=2**14).passed


def test_a_trace_and_an_acceptance_rate_know_the_inner_moves():
    run = mcmc1d.run(
        jax.random.key(0), SubChain(BOTH, SmallStep(0.1), 5), HARD, steps=4, chains=64,
        estimators={"acceptance": mcmc1d.Acceptance(), "x": mcmc1d.Histogram(4)},
    )  # fmt: skip
    assert set(run.acceptance()) == {"large", "small", "inner SmallStep"}
    assert abs(run.mean("x").sum() - 1) < 1e-6


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SubChain(BOTH, STEP, 0), "SubChain: length must be a whole number, 1 at least, not 0"),
        (lambda: SplitSample(STEP, 0), "tries must be a whole number, 1 at least"),
        (lambda: TruncatedStep(0.0), "TruncatedStep: sigma must be positive"),
        (lambda: UniformStep(-1.0), "UniformStep: width must be positive"),
        (lambda: LinearStep(np.inf), "LinearStep: width must be positive"),
    ],
)
def test_what_can_not_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
