"""Every outcome of one step of a kernel from one point of a net, with its probability; and where its law has atoms."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.compiling import quickly
from mcmc1d.metropolis import Kernel, Metropolis, acceptance
from mcmc1d.moves import Mixture, Move, Proposal
from mcmc1d.moves.base import proposal_of
from mcmc1d.numerics import below_one, cast
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Index, Scalar, UInt32


class Outcomes(NamedTuple):
    """Where one point of the net went: every outcome of a step, with its probability."""

    start: State
    weight: Scalar
    """The density of the start."""
    ends: list[State]
    probabilities: list[Scalar]
    kinds: list[Index]


class KernelFlux(eqx.Module):
    """The outcomes of one step of a library kernel, as a function of uniform numbers: those of u, then those of w."""

    kernel: Kernel
    target: Multiplexed
    lead: int = eqx.field(static=True, default=0)
    """Steps made before the one that counts."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """The names of the kinds of moves that the outcomes tell apart."""
        return self.kernel.kinds if isinstance(self.kernel, Metropolis) else ("step",)

    @property
    def dim(self) -> int:
        """How many numbers a point has."""
        return self.target.dim_u + self.lead * self.kernel.dim_w(self.target) + max(self._dims())

    def _branches(self) -> list[tuple[Array, Move]]:
        """The moves that the kernel chooses among with fixed probabilities; every one is followed from each point."""
        if not isinstance(self.kernel, Metropolis):
            return []
        move = self.kernel.move
        if isinstance(move, Mixture):
            return [(jnp.asarray(move.probabilities[k]), each) for k, each in enumerate(move.moves)]
        return [(jnp.ones(()), move)]

    def _dims(self) -> list[int]:
        return [move.dim_w(self.target) for _, move in self._branches()] or [self.kernel.dim_w(self.target)]

    def __call__(self, index: Index, numbers: Float[Array, " dim"], counter: UInt32[Array, " 2"]) -> Outcomes:
        """Both outcomes of every accept-reject decision of a `Metropolis` kernel; of any other its one outcome."""
        target, m = self.target, self.target.dim_u
        state = target.evaluate(State(index, numbers[:m]))
        weight, w = jnp.exp(state.seen.log_c), numbers[m:]
        for _ in range(self.lead):
            r = self.kernel.dim_w(target)
            state = self.kernel.step(target, state, w[:r]).state
            # What a chain would carry in `eval` is dropped: the operator's state is (index, u), and nothing else.
            state, w = target.evaluate(State(state.index, state.u)), w[r:]
        if not self._branches():
            after = self.kernel.step(target, state, w).state
            return Outcomes(state, weight, [after], [jnp.ones_like(weight)], [0])
        ends, probabilities, kinds, stay = [], [], [], jnp.zeros_like(weight)
        for k, (chance, move) in enumerate(self._branches()):
            proposal = proposal_of(move, target, state, w[: move.dim_w(target)])
            proposed = target.evaluate(proposal.state)
            a = acceptance(state, Proposal(proposed, proposal.w, proposal.log_det))
            # An impossible proposal may hold NaN; its weight is zero, and so it need not be replaced.
            ends.append(proposed)
            probabilities.append(chance * a)
            kinds.append(k if len(self._branches()) > 1 else proposal.kind)
            stay = stay + chance * (1 - a)
        return Outcomes(state, weight, [*ends, state], [*probabilities, stay], [*kinds, 0])

    def coordinates(self, state: State) -> Float[Array, " k"]:
        """(x, u), x a scalar and scaled to the unit interval; else u alone."""
        lower, upper = self.target.target.domain
        if np.ndim(lower) > 0:
            return state.u
        # Not `eval.x`: what a cell holds must follow from (index, u), whatever a wrong move has put into `eval`.
        x = self.target.forward(state.index, state.u)[0]
        return jnp.concatenate([((x - lower) / (upper - lower))[None], state.u])

    def sample(self, state: State) -> Float[Array, "..."]:
        """X, of which laws are asked for."""
        return self.target.forward(state.index, state.u)[0]


class StepFlux(eqx.Module):
    """The outcome of one step of a plain function (key, position) -> position on a box, a fresh key a point."""

    step: Callable[[Any, Array], Array]
    log_density: Callable[[Array], Scalar]
    lower: Float[np.ndarray, " d"]
    upper: Float[np.ndarray, " d"]
    top: float = 0.0
    """The largest logarithm of the density: no law depends on a constant, and an exponential does not overflow."""
    kinds: tuple[str, ...] = eqx.field(static=True, default=("step",))
    lead: int = eqx.field(static=True, default=0)

    @property
    def dim(self) -> int:
        """The numbers of the position; those of the step come from its key."""
        return self.lower.size

    def __call__(self, index: Index, numbers: Float[Array, " d"], counter: UInt32[Array, " 2"]) -> Outcomes:
        """The outcome of one step from the place `numbers` of the box."""
        position = jnp.asarray(self.lower + (self.upper - self.lower) * numbers)
        key = jax.random.wrap_key_data(counter, impl="threefry2x32")
        after = jnp.reshape(self.step(key, position), position.shape)
        weight = jnp.exp(self.log_density(position) - self.top)
        return Outcomes(State(index, position), weight, [State(index, after)], [jnp.ones_like(weight)], [0])

    def coordinates(self, state: State) -> Float[Array, " d"]:
        """The place in the box."""
        return (state.u - self.lower) / (self.upper - self.lower)

    def sample(self, state: State) -> Float[Array, "..."]:
        """The position itself; a number in one dimension."""
        return state.u[0] if self.lower.size == 1 else state.u


def find_atoms(flux: KernelFlux, seed: int, steps: int = 3, chains: int = 2**13) -> tuple[np.ndarray, ...]:
    """For each coordinate, the numbers that more than one state in 500 came to within a few steps: a law of atoms.

    An inverse that returns one fixed point of an interval makes them; a cell's width is then the wrong measure.
    """
    target, dtype = cast(flux.target, jnp.zeros(()).dtype), jnp.zeros(()).dtype
    kernel = cast(flux.kernel, dtype)
    r, m = kernel.dim_w(target), target.dim_u
    rng = np.random.default_rng([seed, 99])
    found: list[list[float]] = [[] for _ in range(m)]

    @quickly
    def ends(index: Array, numbers: Array) -> Array:
        def one(index: Index, numbers: Array) -> Array:
            def step(state: State, w: Array) -> tuple[State, None]:
                return kernel.step(target, state, w).state, None

            state = target.evaluate(State(index, numbers[:m]))
            return jax.lax.scan(step, state, numbers[m:].reshape(steps, r))[0].u

        return jax.vmap(one)(index, numbers)

    index = jnp.asarray(rng.integers(0, target.n_techniques, chains), jnp.int32)
    u = np.asarray(ends(index, below_one(jnp.asarray(rng.random((chains, m + steps * r)), dtype))))
    for j in range(m):
        # Neighbours to a few roundings are one atom.
        values, counts = np.unique(np.round(u[:, j].astype(np.float64), 6), return_counts=True)
        for value in values[counts > chains / 500]:
            found[j].append(float(np.median(u[np.abs(u[:, j] - value) < 1e-6, j])))
    scalar = np.ndim(flux.target.target.domain[0]) == 0
    return (*([np.zeros(0)] if scalar else []), *(np.array(values, np.float64) for values in found))
