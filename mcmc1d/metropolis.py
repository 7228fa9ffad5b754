"""Where a proposal is accepted or rejected, and kernels made of it."""

import abc
import itertools
from collections.abc import Sequence
from functools import partial
from typing import Generic, Literal, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from mcmc1d.checks import require, require_instance, several
from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.base import proposal_of
from mcmc1d.numerics import select
from mcmc1d.random import SOURCES, Source
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Int, Key, Scalar

T = TypeVar("T")
M = TypeVar("M", bound=Move)


class Deposits(eqx.Module):
    """Weighted points whose expectation over a step is that of the target: the weights of one step sum to one.

    Unless the kernel says otherwise: see `Kernel.deposited`. An `index` is that of one of the target's techniques. Of a
    batch of chains, as a run hands them to estimators, the chains are the last axis of each: x is of shape
    (n, ..., chains).
    """

    x: Float[Array, "n ..."]
    index: Int[Array, " n"]
    weight: Float[Array, " n"]


class Deposited(NamedTuple):
    """What a kernel's deposits are samples of, in expectation over a stationary chain."""

    target: Multiplexed | None
    """The deposits' x have the law of its x; None where no law is known of them."""
    total: float = 1.0
    """The expected total weight of a step."""
    most: float = 1.0
    """The largest."""


class Info(eqx.Module):
    """What happened in each of a kernel's n accept-reject decisions."""

    kind: Int[Array, " n"]
    """Which kind of move it was, counted through `Kernel.kinds`."""
    acceptance: Float[Array, " n"]
    """The probability with which the proposal was accepted."""
    accepted: Bool[Array, " n"]


class Step(eqx.Module):
    """The outcome of one step of a kernel."""

    state: State
    deposits: Deposits
    info: Info


class Kernel(eqx.Module):
    """A Markov kernel as a function of the state and of uniform numbers w in [0, 1)^r; written for one chain."""

    @property
    @abc.abstractmethod
    def kinds(self) -> tuple[str, ...]:
        """The names of its kinds of moves, for acceptance rates."""

    @abc.abstractmethod
    def dim_w(self, target: Multiplexed) -> int:
        """r, how many uniform numbers a step consumes."""

    @abc.abstractmethod
    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        """One step from an evaluated state."""

    @abc.abstractmethod
    def check(self, target: Multiplexed) -> None:
        """Raise `ValueError` where the kernel does not fit the target."""

    def sampled(self, target: Multiplexed) -> Multiplexed:
        """The target that its deposits are samples of: the chain's own, unless the kernel makes others from it."""
        return target

    def deposited(self, target: Multiplexed) -> Deposited | None:
        """What it deposits, where that is not the chain's own target at a total weight of one; on the host."""
        return None


def step_batch(
    key: Key,
    step: Int[Array, ""],
    kernel: Kernel,
    target: Multiplexed,
    states: State,
    numbers: Source = SOURCES["threefry"],
) -> Step:
    """Step number `step` of a batch of chains, evaluated states, the last axis of each leaf counting them.

    One key per step, not one per chain, for numbers that are drawn all at once.
    """
    w = numbers.uniforms(key, step, (kernel.dim_w(target), states.u.shape[-1]), states.u.dtype)
    return jax.vmap(partial(kernel.step, target), in_axes=-1, out_axes=-1)(states, w)


class OfMove(Kernel, Generic[M]):
    """A kernel that accepts or rejects what one move proposes: a further uniform number, and the move's kinds."""

    move: eqx.AbstractVar[M]

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.move.kinds

    def dim_w(self, target: Multiplexed) -> int:
        return self.move.dim_w(target) + 1


class Metropolis(OfMove[Move]):
    """Propose with a move, accept with the Metropolis-Hastings-Green probability, deposit.

    `deposit="expected"` puts 1 - a on the current state and a on the proposed one (Veach and Guibas 1997), `"plain"`
    puts 1 on the state after the step; both have the target's expectation.
    """

    move: Move
    deposit: Literal["expected", "plain"] = eqx.field(static=True, default="expected")

    def __check_init__(self):
        require_instance(self.move, Move, "Metropolis: the move")
        require(
            self.deposit in ("expected", "plain"),
            f'Metropolis: deposit must be "expected" or "plain", not {self.deposit!r}',
        )

    def check(self, target: Multiplexed) -> None:
        self.move.check(target)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        return accept(target, state, proposal_of(self.move, target, state, w[:-1]), w[-1], self.deposit)


def as_kernel(kernel: Kernel | Move, who: str) -> Kernel:
    """A kernel as it is; a move as `Metropolis` accepts it."""
    if isinstance(kernel, Move):
        return Metropolis(kernel)
    require_instance(kernel, Kernel, who, "; give a Kernel or a Move")
    return kernel


_NOT_ONE = "Cycle: its kernels deposit samples of different things, whose mean has no law to be held to"


class Cycle(Kernel):
    """Several kernels one after the other in each step: invariant where each is, but not reversible."""

    kernels: tuple[Kernel, ...]

    def __init__(self, kernels: Sequence[Kernel | Move]):
        """`kernels`: in their order within a step; a move is accepted by `Metropolis`."""
        self.kernels = tuple(as_kernel(kernel, "Cycle: a kernel") for kernel in several(kernels, "Cycle: its kernels"))
        require(len(self.kernels) > 0, "Cycle: give one kernel at least")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Their kinds; a name that comes again is numbered: "SmallStep", "SmallStep 2"."""
        kinds: list[str] = []
        for name in (name for kernel in self.kernels for name in kernel.kinds):
            numbered = (f"{name} {k}" if k > 1 else name for k in itertools.count(1))
            kinds.append(next(kind for kind in numbered if kind not in kinds))
        return tuple(kinds)

    def dim_w(self, target: Multiplexed) -> int:
        return sum(kernel.dim_w(target) for kernel in self.kernels)

    def check(self, target: Multiplexed) -> None:
        for kernel in self.kernels:
            kernel.check(target)

    def sampled(self, target: Multiplexed) -> Multiplexed:
        """What the deposits of each are samples of; raises `ValueError` where that is not one thing."""
        first, *others = (kernel.sampled(target) for kernel in self.kernels)
        require(all(one is first or bool(eqx.tree_equal(one, first)) for one in others), _NOT_ONE)
        return first

    def deposited(self, target: Multiplexed) -> Deposited | None:
        """What they all deposit; raises `ValueError` where that is not one thing."""
        each = [kernel.deposited(target) for kernel in self.kernels]
        known = [one for one in each if one is not None]
        if not known:
            return None
        first = known[0]
        require(
            len(known) == len(each) and all(eqx.tree_equal(one[:2], first[:2]) for one in known),
            _NOT_ONE,
        )
        return first._replace(most=max(one.most for one in known))

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        deposits, infos, kinds = [], [], 0
        for kernel in self.kernels:
            r = kernel.dim_w(target)
            step = kernel.step(target, state, w[:r])
            state, w = step.state, w[r:]
            weight = step.deposits.weight / len(self.kernels)
            deposits.append(eqx.tree_at(lambda d: d.weight, step.deposits, weight))
            infos.append(eqx.tree_at(lambda i: i.kind, step.info, step.info.kind + kinds))
            kinds += len(kernel.kinds)
        return Step(state, _join(deposits), _join(infos))


def _join(parts: list[T]) -> T:
    """Trees of one structure as one, end to end."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def acceptance(state: State, proposal: Proposal) -> Scalar:
    """min(1, pi(s') / pi(s) |d(s', w') / d(s, w)|) for an evaluated proposal (Green 1995; Tierney 1998).

    Zero where s' or w' lies outside the unit cube, where there is no technique of that index, and where the ratio is
    not a number; a dark state accepts any lit one.
    """
    log_ratio = proposal.state.seen.log_c - state.seen.log_c + proposal.log_det
    possible = proposal.inside & ~jnp.isnan(log_ratio)
    return jnp.exp(jnp.where(possible, jnp.where(log_ratio < 0, log_ratio, 0), -jnp.inf))


def accept(
    target: Multiplexed, state: State, proposal: Proposal, uniform: Scalar, deposit: Literal["expected", "plain"]
) -> Step:
    """Go to the proposal if `uniform` is under its acceptance probability, or stay.

    In float32 `uniform` is a multiple of 2^-23, so that the probability is rounded up to one: the law of a region that
    is dim may be off by up to 2^-23 max C / mean C, C the density of the state. In float64 it is 2^-52, which no run
    sees.

    Every kernel on a `Multiplexed` accepts here, but for `packets.AuxiliaryCentre`, which never rejects.
    """
    proposed = target.evaluate(proposal.state)
    a = acceptance(state, Proposal(proposed, proposal.w, proposal.log_det, proposal.kind))
    # An impossible proposal may hold NaN, and 0 times NaN is NaN: from here on it is the current state.
    proposed = select(a > 0, proposed, state)
    accepted = uniform < a
    after = select(accepted, proposed, state)
    if deposit == "expected":
        points, weight = (state, proposed), jnp.stack([1 - a, a])
    else:
        points, weight = (after,), jnp.ones((1,), a.dtype)
    deposits = Deposits(
        jnp.stack([point.seen.x for point in points]), jnp.stack([jnp.asarray(point.index) for point in points]), weight
    )
    info = Info(jnp.atleast_1d(jnp.asarray(proposal.kind)), a[None], accepted[None])
    return Step(after, deposits, info)
