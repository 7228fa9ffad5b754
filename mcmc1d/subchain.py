"""Deposits beside a main chain: sub-chains that are thrown away, and a sample split among several proposals."""

import equinox as eqx
import jax
import jax.numpy as jnp

from mcmc1d.checks import require_instance, require_whole
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Deposited, Deposits, Info, Kernel, Step, accept, acceptance, as_kernel
from mcmc1d.moves import LargeStep, Move, MultipleTry, SmallStep
from mcmc1d.moves.multiple_try import around, row
from mcmc1d.numerics import select
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float


class SubChain(Kernel):
    """A step of a main chain that deposits along `length` steps of another kernel, whose states are then thrown away.

    Coherent MLT (Segovia et al. 2007, algorithm 1) and energy redistribution (Cline et al. 2005). The sub-chain
    starts at the main chain's state before its step, whether or not its last proposal was accepted: that state has
    the target's law, the inner kernel keeps it, and so each of the `length` deposits has the target's expectation;
    their mean is deposited. The main chain never sees where the sub-chain went, and its own deposits are left out.

    Work: one step of `outer` and `length` steps of `inner`. Kinds: those of `outer`, then "inner ..." for the others.
    """

    outer: Kernel
    inner: Kernel
    length: int = eqx.field(static=True)

    def __init__(self, outer: Kernel | Move, inner: Kernel | Move, length: int = 1):
        """`outer`: the main chain's kernel; `inner`: the sub-chain's; `length`: its steps, one at least."""
        self.outer, self.inner = as_kernel(outer, "SubChain: the outer"), as_kernel(inner, "SubChain: the inner")
        self.length = require_whole(length, "SubChain: length")

    @property
    def kinds(self) -> tuple[str, ...]:
        return (*self.outer.kinds, *(f"inner {kind}" for kind in self.inner.kinds))

    def dim_w(self, target: Multiplexed) -> int:
        return self.outer.dim_w(target) + self.length * self.inner.dim_w(target)

    def check(self, target: Multiplexed) -> None:
        self.outer.check(target)
        self.inner.check(target)

    def sampled(self, target: Multiplexed) -> Multiplexed:
        return self.inner.sampled(target)

    def deposited(self, target: Multiplexed) -> Deposited | None:
        return self.inner.deposited(target)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        main = self.outer.dim_w(target)
        after = self.outer.step(target, state, w[:main])

        def one(inside: State, numbers: Float[Array, " s"]) -> tuple[State, tuple[Deposits, Info]]:
            step = self.inner.step(target, inside, numbers)
            return step.state, (step.deposits, step.info)

        last, (deposits, info) = jax.lax.scan(one, state, w[main:].reshape(self.length, -1))
        # A sub-chain that came where the target is NaN is not thrown away, but found.
        home = select(jnp.isposinf(last.seen.log_c), last, after.state)
        deposits, info = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), (deposits, info))
        mean = Deposits(deposits.x, deposits.index, deposits.weight / self.length)
        kind = jnp.concatenate([after.info.kind, info.kind + len(self.outer.kinds)])
        both = Info(
            kind,
            jnp.concatenate([after.info.acceptance, info.acceptance]),
            jnp.concatenate([after.info.accepted, info.accepted]),
        )
        return Step(home, mean, both)


class SplitSample(Kernel):
    """Metropolis whose sample is split among m proposals: R_i / m on each, and what none of them takes on itself.

    Segovia et al. 2007, section 5.2, after Cline et al. 2005: each proposal and its refusal share the sample as in
    the deposit on two states, and the mean over several such pairs has the target's expectation still. The first
    proposal is the one that the chain may accept; evaluated: m states a step.
    """

    step_by: Move
    tries: int = eqx.field(static=True)

    def __init__(self, step: Move, tries: int = 4):
        """`step`: a move that leads to each proposal; `tries`: m, one at least."""
        require_instance(step, Move, "SplitSample: the step")
        self.step_by, self.tries = step, require_whole(tries, "SplitSample: tries")

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.step_by.kinds

    def dim_w(self, target: Multiplexed) -> int:
        return self.tries * self.step_by.dim_w(target) + 1

    def check(self, target: Multiplexed) -> None:
        self.step_by.check(target)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        proposals = around(self.step_by, target, state, w[:-1].reshape(self.tries, -1))
        chances = jax.vmap(lambda proposal: acceptance(state, proposal))(proposals)
        # The first, but for one at which the target is NaN: there the chain goes, and is found.
        nan = jnp.isposinf(proposals.state.seen.log_c)
        step = accept(target, state, row(proposals, jnp.argmax(nan)), w[-1], "plain")
        # An impossible proposal may hold NaN: its share, which is zero, stands at home.
        lit, there, home = chances > 0, proposals.state, state.seen
        x = jnp.where(lit.reshape(-1, *[1] * home.x.ndim), there.seen.x, home.x)
        index = jnp.where(lit, there.index, state.index)
        deposits = Deposits(
            jnp.concatenate([home.x[None], x]),
            jnp.concatenate([jnp.asarray(state.index)[None], index]),
            jnp.concatenate([1 - jnp.mean(chances)[None], chances / self.tries]),
        )
        return Step(step.state, deposits, step.info)


EXAMPLES = Examples(
    lambda: {
        "sub_chain": SubChain(LargeStep(), MultipleTry(SmallStep(0.1), 3), 4),
        "split_sample": SplitSample(SmallStep(0.2), 3),
    }
)
