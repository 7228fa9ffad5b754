"""Moves of the technique's index at fixed u: the multiplexed technique change, alone or with a step of u."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance
from mcmc1d.compiling import quickly
from mcmc1d.examples import Examples
from mcmc1d.moves.base import EachAlone, Move, Proposal
from mcmc1d.moves.primary import LargeStep, SmallStep
from mcmc1d.numerics import choose, cumulative, entry, is_concrete, unchoose, width
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Index, Real, Scalar


class Proposals(eqx.Module):
    """The matrix T_ij of the probabilities that technique j is proposed from technique i; uniform where not given.

    `draw` takes the index's uniform number to (j, the number that would lead back, log T_ji / T_ij): the place inside
    the chosen interval is kept, so the choice is a bijection and its determinant the ratio of the two intervals.
    """

    ends: Float[Real, "n n+1"] | None = None
    symmetric: bool = eqx.field(static=True, default=True)

    def __init__(self, matrix: ArrayLike | None = None):
        """`matrix`: n x n, rows that sum to one; None proposes every technique alike."""
        if matrix is None:
            return
        require(is_concrete(matrix), "the proposal matrix T is a table of numbers and can not be traced")
        t = np.asarray(matrix, np.float64)
        require(
            t.ndim == 2 and t.shape[0] == t.shape[1], f"the proposal matrix T must be square, not of shape {t.shape}"
        )
        bad = np.flatnonzero((np.abs(t.sum(1) - 1) > 1e-6) | (t < 0).any(1) | ~np.isfinite(t).all(1))
        require(
            bad.size == 0,
            f"each row of the proposal matrix T holds probabilities that sum to one; row {bad[:1]} is {t[bad[:1]]}",
        )
        sums = np.cumsum(np.pad(t, ((0, 0), (1, 0))), axis=1)
        self.ends = sums / sums[:, -1:]
        self.symmetric = bool(np.array_equal(t, t.T))

    def check(self, target: Multiplexed) -> None:
        """Raise `ValueError` unless the matrix has a row for each of the target's techniques."""
        n = target.n_techniques
        require(
            self._size() in (None, n),
            f"the proposal matrix T must be {n} x {n} for {n} techniques, not {self._size()} x {self._size()}",
        )

    def _size(self) -> int | None:
        return None if self.ends is None else len(self.ends)

    def draw(self, target: Multiplexed, index: Index, number: Scalar) -> tuple[Index, Scalar, Scalar]:
        """(j, the number that leads back from j to `index`, log T_ji / T_ij)."""
        forth = self._row(target, index, number)
        j, place = choose(forth, number)
        back = self._row(target, j, number)
        log_t = jnp.zeros_like(number) if self.symmetric else log_ratio(width(back, index), width(forth, j))
        return j, unchoose(back, index, place), log_t

    def _row(self, target: Multiplexed, index: Index, number: Scalar) -> list[Scalar]:
        """The ends of the intervals of row `index`."""
        if self.ends is None:
            return cumulative([jnp.ones_like(number)] * target.n_techniques)
        inner = [entry(self.ends[:, j], index) for j in range(1, target.n_techniques)]
        return [jnp.zeros_like(number), *inner, jnp.ones_like(number)]


class TechniqueChange(Move):
    """(i, u) -> (j, u) with j from T_i: the naive jump of multiplexed MLT, the same numbers given to another technique.

    Bitterli et al. 2017, eqs. 5-7; the log-determinant is log T_ji / T_ij.
    """

    proposals: Proposals

    def __init__(self, matrix: ArrayLike | None = None):
        """`matrix`: T, n x n, rows that sum to one; None proposes every technique alike, the current one too."""
        self.proposals = Proposals(matrix)

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def check(self, target: Multiplexed) -> None:
        self.proposals.check(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        j, back, log_t = self.proposals.draw(target, state.index, w[0])
        return Proposal(State(j, state.u), back[None], log_t)


class StepAndChange(Move):
    """A step of u and a technique change in one proposal, as multiplexed MLT does (Hachisuka et al. 2014, section 4).

    The two act on different coordinates and so are one involution. `StepAndChange(LargeStep())` forgets everything.
    The step is any that moves u alike whatever the technique; `check` raises `ValueError` for one that does not.
    """

    step: Move
    change: TechniqueChange

    def __init__(self, step: Move, change: TechniqueChange | None = None):
        """`step`: of u alone; `change`: every technique alike, unless given."""
        require_instance(step, Move, "StepAndChange: the step")
        self.step, self.change = step, TechniqueChange() if change is None else change
        require_instance(self.change, TechniqueChange, "StepAndChange: the change")

    def dim_w(self, target: Multiplexed) -> int:
        return self.step.dim_w(target) + self.change.dim_w(target)

    def check(self, target: Multiplexed) -> None:
        self.step.check(target)
        self.change.check(target)
        if not isinstance(self.step, EachAlone) and is_concrete(self.step, target):
            _require_of_u(self.step, target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        r = self.step.dim_w(target)
        stepped = self.step.propose(target, state, w[:r])
        changed = self.change.propose(target, state, w[r:])
        return Proposal(
            State(changed.state.index, stepped.state.u),
            jnp.concatenate([stepped.w, changed.w]),
            stepped.log_det + changed.log_det,
        )


def _require_of_u(step: Move, target: Multiplexed, probes: int = 64) -> None:
    """Raise `ValueError` where what a step does to u depends on the technique: the way back is by another."""
    rng = np.random.default_rng(0)
    u, w = jnp.asarray(rng.random((probes, target.dim_u))), jnp.asarray(rng.random((probes, step.dim_w(target))))

    def at(index: Index, u: Array, w: Array) -> Any:
        proposal = step.propose(target, target.evaluate(State(index, u)), w)
        return proposal.state.u, proposal.w, proposal.log_det, proposal.state.index - index

    every = quickly(jax.vmap(jax.vmap(at, in_axes=(None, 0, 0)), in_axes=(0, None, None)))
    found = every(jnp.arange(target.n_techniques), u, w)
    alike = all(np.allclose(part, part[:1], atol=1e-6, equal_nan=True) for part in map(np.asarray, found[:3]))
    require(
        alike and not np.asarray(found[3]).any(),
        f"StepAndChange: what {type(step).__name__} does to u depends on the technique, or changes it, and the way "
        "back is by another one: no involution. Have it in a Mixture beside a TechniqueChange",
    )


def log_ratio(numerator: Scalar, denominator: Scalar) -> Scalar:
    """log(numerator / denominator); -inf where the numerator is zero, whatever the denominator."""
    return jnp.where(numerator > 0, jnp.log(numerator / denominator), -jnp.inf)


LOPSIDED = [[0.2, 0.5, 0.3], [0.1, 0.1, 0.8], [0.6, 0.4, 0.0]]
"""An example of T that is not symmetric; technique 2 never proposes itself."""

EXAMPLES = Examples(
    lambda: {
        "technique_change": TechniqueChange(),
        "technique_change_lopsided": TechniqueChange(LOPSIDED),
        "step_and_change": StepAndChange(SmallStep(), TechniqueChange(LOPSIDED)),
        "large_step_and_change": StepAndChange(LargeStep()),
    }
)
