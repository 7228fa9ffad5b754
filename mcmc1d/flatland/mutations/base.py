"""Mutations of paths (Veach and Guibas 1997) as involutions that are built from the techniques' inverses.

A path x is taken to the numbers u of a technique t that makes it; some of the numbers are re-made, by fresh ones or by
a small step; the same technique or another makes the new path y of them; and y is taken to a technique by its weight.
What t walks by the numbers that stay is the part of the path that is kept, vertex by vertex: t's eye numbers stand at
the front of u and its lamp numbers at the back, in the order in which they are walked.
"""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require
from mcmc1d.flatland.any_length import AnyLength
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.paths import Paths
from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.mixture import shares
from mcmc1d.numerics import choose, cumulative, locate, pick, unchoose
from mcmc1d.special import log_sum
from mcmc1d.state import Eval, Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Real, Scalar


class Layout(NamedTuple):
    """Which techniques a target is seen through, by index."""

    paths: Paths
    """The longest."""
    edges: tuple[int, ...]
    lengths: tuple[int, ...]
    """t of each technique."""
    dim_u: int


class Seen(NamedTuple):
    """What a mutation may look at to plan: it must find the same on the path that it has made."""

    edges: Index
    mirror: tuple[Bool[Array, ""], ...]
    """Of the vertices 0 to the most that there are, whether it is a mirror's bounce."""


class Plan(NamedTuple):
    """Which numbers are re-made, and how often each technique is to make the new path; all shares zero: none may."""

    shares: tuple[Scalar, ...]
    again: Bool[Array, " m"]


Planned: TypeAlias = Callable[[Seen], Plan]
Change: TypeAlias = Callable[[Multiplexed, Array, Array], tuple[Array, Array]]
"""An involution (u, w) <-> (u', w') of as many numbers each, of log-determinant 0."""


def layout(target: Multiplexed) -> Layout:
    """That of a target of paths; `ValueError` where it is none, or leaves out a technique."""
    family = target.family
    if isinstance(family, AnyLength):
        return Layout(family.paths, family.edges, family.lengths, target.dim_u)
    require(
        isinstance(family, Bidirectional),
        f"mutations of paths need the techniques Bidirectional or AnyLength, not {type(family).__name__}",
    )
    assert isinstance(family, Bidirectional)
    k, every = family.paths.edges, family.paths.eye_lengths
    require(
        tuple(family.lengths) == tuple(every),
        f"mutations of paths need every technique, t = {every[0]} to {k + 1}, not {family.lengths}",
    )
    return Layout(family.paths, (k,) * len(family.lengths), family.lengths, target.dim_u)


def looked_at(here: Layout, x: Float[Array, " d"]) -> Seen:
    """A path's length, and which of its vertices are mirrors' bounces."""
    walls, places = here.paths.walls, here.paths.sensor.places
    slots = x[places:]
    edges = jnp.sum(slots >= 0, dtype=jnp.int32)
    bounces = (slots >= walls.total) & walls.mirrors
    return Seen(edges, (jnp.zeros((), bool), *(bounces[j] for j in range(here.paths.edges))))


class Mutation(Move):
    """Re-makes a part of a path. A subclass is final: it says what it re-makes, and how.

    The numbers w: what the mutation is to plan with, which is kept; the place inside the weight of the state's
    technique, which is so redrawn by the weights and drops out of the ratio; which technique takes the path apart, by
    the posterior, and which one makes the new path, by the prior; then one for each of u. The log-determinant leaves
    the acceptance ratio f(y) Q(x) / (f(x) Q(y)), Q the sum of the techniques' shares times their densities: Veach's
    ratio, in which the density of what is kept cancels.
    """

    @abc.abstractmethod
    def plan(self, here: Layout, seen: Seen, number: Scalar) -> Plan:
        """What to re-make of a path of which this was seen."""

    @abc.abstractmethod
    def change(
        self, target: Multiplexed, u: Float[Array, " m"], w: Float[Array, " m"]
    ) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """(u', w') of all numbers; those that are not to be re-made are put back."""

    def dim_w(self, target: Multiplexed) -> int:
        return _CHOICES + target.dim_u

    def check(self, target: Multiplexed) -> None:
        layout(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        here = layout(target)
        return remade(target, here, state, w, lambda seen: self.plan(here, seen, w[0]), self.change)


class Mutations(Move):
    """One of several mutations, each with a fixed probability; a path is taken apart and made once for all of them."""

    mutations: tuple[Mutation, ...]
    probabilities: Float[Real, " n"]
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, mutations: Mapping[str, tuple[float, Mutation]]):
        """`mutations`: name -> (probability, mutation); the probabilities sum to one."""
        self.names, self.mutations, self.probabilities = shares(mutations, Mutation, "Mutations: mutation")

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.names

    def dim_w(self, target: Multiplexed) -> int:
        return 1 + _CHOICES + target.dim_u

    def check(self, target: Multiplexed) -> None:
        for mutation in self.mutations:
            mutation.check(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        here = layout(target)
        chosen = locate(cumulative([jnp.asarray(p) for p in self.probabilities]), w[0])

        def plan(seen: Seen) -> Plan:
            return pick([mutation.plan(here, seen, w[1]) for mutation in self.mutations], chosen)

        def change(target: Multiplexed, u: Array, numbers: Array) -> tuple[Array, Array]:
            return pick([mutation.change(target, u, numbers) for mutation in self.mutations], chosen)

        proposal = remade(target, here, state, w[1:], plan, change)
        return Proposal(proposal.state, jnp.concatenate([w[:1], proposal.w]), proposal.log_det, chosen)


_CHOICES = 4


def remade(
    target: Multiplexed, here: Layout, state: State, w: Float[Array, " r"], plan: Planned, change: Change
) -> Proposal:
    """The involution of all mutations, with the numbers w of a `Mutation`."""
    known, planned = state.seen, plan(looked_at(here, state.seen.x))
    allowed, prior = _ends(planned.shares)
    log_q, posterior = _posterior(planned.shares, known.log_p)
    apart, place = choose(posterior, w[2])
    u, _ = target.inverse(apart, known.x, known.v)
    made_by, place_there = choose(prior, w[3])
    fresh, left = change(target, u, w[_CHOICES:])
    u_there = jnp.where(planned.again, fresh, u)
    rest = jnp.where(planned.again, left, w[_CHOICES:])

    x, v, _, log_f, log_p, *_ = target.family.look(target.target, made_by, u_there)
    found = plan(looked_at(here, x))
    same = jnp.all(planned.again == found.again)
    for one, other in zip(planned.shares, found.shares, strict=True):
        same = same & (one == other)
    log_q_there, posterior_there = _posterior(planned.shares, log_p)
    index, index_place, log_weights = reweighed(target, known, state.index, w[1], x, log_p)
    back = [w[0], index_place, unchoose(posterior_there, made_by, place_there), unchoose(prior, apart, place)]
    # In log p(x) - log p(y) of the techniques' determinants the shares and posteriors leave Q(x) / Q(y).
    log_det = jnp.where(allowed & same, log_q - log_q_there, -jnp.inf)
    return settled(
        target, index, (x, v, log_f, log_p), jnp.concatenate([jnp.stack(back), rest]), known, log_det + log_weights
    )


def reweighed(
    target: Multiplexed, known: Eval, index: Index, place: Scalar, x: Array, log_p: Sequence[Scalar]
) -> tuple[Index, Scalar, Scalar]:
    """A technique for the new path by its weights: (index, the place inside its interval, log of w_i(x) / w_j(y))."""
    before, after = target.log_weights(known.x, known.log_p), target.log_weights(x, log_p)
    number = unchoose(cumulative([jnp.exp(log_w) for log_w in before]), index, place)
    j, place_there = choose(cumulative([jnp.exp(log_w) for log_w in after]), number)
    return j, place_there, pick(before, index) - pick(after, j)


def settled(
    target: Multiplexed,
    index: Index,
    path: tuple[Array, Array, Scalar, Sequence[Scalar]],
    w: Float[Array, " r"],
    known: Eval,
    log_det: Scalar,
) -> Proposal:
    """The proposal of a path (x, v, log f, log p) in technique `index`; `log_det`: from (x, v) and w to the new ones.

    Nothing is evaluated again: the state knows its f and p, and of a technique of paths p is the determinant.
    """
    x, v, log_f, log_p = path
    u, log_there = target.inverse(index, x, v)[0], pick(log_p, index)
    there = Eval(x, v, -log_there, log_f, tuple(log_p), target.log_c(index, x, log_f, log_p))
    # A path that no technique can take apart again is none to go to.
    log_det = log_det + known.log_det + log_there
    return Proposal(State(index, u, there), w, jnp.where(jnp.isnan(log_det), -jnp.inf, log_det))


def _ends(shares: Sequence[Scalar]) -> tuple[Bool[Array, ""], list[Scalar]]:
    """Whether any technique is allowed, and the ends of their intervals."""
    total = jnp.asarray(sum(shares[1:], shares[0]))
    return total > 0, cumulative([jnp.where(total > 0, shares[0], 1), *shares[1:]])


def _posterior(shares: Sequence[Scalar], log_p: Sequence[Scalar]) -> tuple[Scalar, list[Scalar]]:
    """Log of the sum of shares times densities, and the ends of the intervals that these have of it."""
    terms = [
        jnp.where(share > 0, jnp.log(jnp.where(share > 0, share, 1)) + p, -jnp.inf)
        for share, p in zip(shares, log_p, strict=True)
    ]
    total = log_sum(terms)
    possible = total > -jnp.inf
    parts = [jnp.where(possible, jnp.exp(term - jnp.where(possible, total, 0)), 0) for term in terms]
    return total, cumulative([jnp.where(possible, parts[0], 1), *parts[1:]])


__all__ = ["Change", "Layout", "Mutation", "Mutations", "Plan", "Seen", "layout", "looked_at", "reweighed", "settled"]
