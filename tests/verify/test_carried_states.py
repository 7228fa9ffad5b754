"""What a kernel hands on beside the index and u of a state, and where it may not go."""

import equinox as eqx
import jax.numpy as jnp
import pytest

from mcmc1d import Multiplexed
from mcmc1d.metropolis import Deposits, Info, Kernel, Step
from mcmc1d.moves import Proposal, SmallStep
from mcmc1d.state import State
from mcmc1d.targets import Tabulated
from mcmc1d.techniques import Uniform
from mcmc1d.verify import Verdict, verify


class Stale(SmallStep):
    """Hands on the sample of the state before."""

    def propose(self, target, state, w):
        proposal = super().propose(target, state, w)
        fresh = target.evaluate(proposal.state)
        kept = eqx.tree_at(lambda s: s.x, fresh.seen, state.seen.x)
        return Proposal(State(fresh.index, fresh.u, kept), proposal.w, proposal.log_det, proposal.kind)


class Frozen(Kernel):
    """Draws u from its law, and keeps what was known of the last."""

    kinds = ("draw",)

    def dim_w(self, target):
        return target.dim_u

    def check(self, target):
        pass

    def step(self, target, state, w):
        after = State(state.index, w, state.seen)
        deposits = Deposits(state.seen.x[None], jnp.asarray(state.index)[None], jnp.ones(1, w.dtype))
        info = Info(jnp.zeros(1, jnp.int32), jnp.ones(1, w.dtype), jnp.ones(1, bool))
        return Step(after, deposits, info)


@pytest.mark.parametrize("kernel", [Stale(0.2), Frozen()])
def test_what_a_state_carries_must_be_its_own(kernel):
    """`run` goes on with what a state carries; `verify` evaluated it anew at each look, and passed."""
    report = verify(kernel, Multiplexed(Tabulated([1, 1]), Uniform()), replicas=2**15)
    assert report.verdict is Verdict.FAIL
    assert "`eval` is not that of its index and u" in report.reasons[0]


class OffTheEnd(Kernel):
    """The next technique, and after the last one none."""

    kinds = ("next",)

    def dim_w(self, target):
        return 1

    def check(self, target):
        pass

    def step(self, target, state, w):
        after = target.evaluate(State(state.index - 1, state.u))
        deposits = Deposits(after.seen.x[None], jnp.asarray(after.index)[None], jnp.ones(1, w.dtype))
        info = Info(jnp.zeros(1, jnp.int32), jnp.ones(1, w.dtype), jnp.ones(1, bool))
        return Step(after, deposits, info)


def test_a_technique_that_there_is_not_is_told():
    target = Multiplexed(Tabulated([1, 1]), (Uniform(), Uniform()))
    report = verify(OffTheEnd(), target, replicas=2**15)
    assert report.verdict is Verdict.FAIL
    assert "it goes to technique -1, and there are 0 to 1" in report.reasons[0]
