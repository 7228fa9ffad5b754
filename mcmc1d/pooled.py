"""Primary-sample-space MLT with all techniques at once: one u makes a sample by each of them.

The chain is a chain on the unit cube, whose target is a function of u; a `Multiplexed` of it, with x = u, can be run,
started exactly and verified like any other.
"""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance, rising
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Deposited, Deposits, Kernel, OfMove, Step, accept
from mcmc1d.moves import Move, SmallStep
from mcmc1d.moves.base import proposal_of
from mcmc1d.numerics import cast, select, stratum
from mcmc1d.quadrature import integrate
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import DensityOf, Target
from mcmc1d.targets.base import unit_cube
from mcmc1d.techniques.product import cube
from mcmc1d.types import Array, Corners, Float, Scalar


class Pooled(Target):
    """C(u) = sum_i or max_i of w_i f / p_i at x_i = S_i(u): the density of PSSMLT (Hachisuka et al. 2014, Alg. 1).

    With respect to du on the unit cube, which is also its domain. The integral of the sum is that of f, by eqs. 9 and
    10; that of the maximum is less, and is what the deposits of a chain must be multiplied by.
    """

    multiplexed: Multiplexed
    combine: Literal["sum", "maximum"] = eqx.field(static=True, default="sum")

    def __check_init__(self):
        require_instance(self.multiplexed, Multiplexed, "Pooled: what is pooled")
        require(self.combine in ("sum", "maximum"), f'Pooled: combine must be "sum" or "maximum", not {self.combine!r}')

    @property
    def domain(self) -> Corners:
        return unit_cube(self.multiplexed.dim_u)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Where in u, of one dimension, a technique comes upon a break of the target, the densities or the weights."""
        points: set[float] = set()
        if self.multiplexed.dim_u == 1:
            with jax.enable_x64(True):
                for technique in cast(self.multiplexed.techniques, jnp.float64):
                    images = [technique.inverse(jnp.asarray(x), jnp.zeros(0))[0][0] for x in self.multiplexed.breaks]
                    points.update(float(u) for u in images if 0 < u < 1)
        return tuple(sorted(points))

    def contributions(self, u: Float[Array, " m"]) -> tuple[Float[Array, "n ..."], Float[Array, " n"]]:
        """(x_i, log C_i) of every technique."""
        # One program for all of them: written out one by one, they take many times as long to compile.
        index = jnp.arange(self.multiplexed.n_techniques)
        found = jax.vmap(lambda i: self.multiplexed.evaluate(State(i, u)).seen)(index)
        return found.x, found.log_c

    def combined(self, log_c: Float[Array, " n"]) -> Scalar:
        """Log C of the techniques' log C_i."""
        # By reductions: taken apart into numbers, each would have all techniques' work done for itself.
        return jax.nn.logsumexp(log_c) if self.combine == "sum" else jnp.max(log_c)

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        """Log C at u = x; -inf outside of the cube."""
        return self.look(x)[0]

    def look(self, x: Float[Array, "..."]) -> tuple[Scalar, tuple[Float[Array, "n ..."], Float[Array, " n"]]]:
        """Log C at u = x, and the contributions: all techniques' work, which is most of a step's, and is done once."""
        u = jnp.atleast_1d(x)
        made = self.contributions(u)
        return jnp.where(jnp.all((u >= 0) & (u <= 1)), self.combined(made[1]), -jnp.inf), made

    def bin_masses(self, edges: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        require(self.multiplexed.dim_u == 1, "Pooled: the masses of bins of u are known for one u only")
        return self.quadrature(np.asarray(edges))


class Floored(Target):
    """C_i(u) with i = floor(n u_0), at the rest of u: the index as one more uniform number (section 4).

    With respect to du on the unit cube of one dimension more than the techniques'. Its integral is b / n: hence the
    factor n (k + 2 in the paper) on every contribution.
    """

    multiplexed: Multiplexed

    def __check_init__(self):
        require_instance(self.multiplexed, Multiplexed, "Floored: the target")

    @property
    def domain(self) -> Corners:
        return unit_cube(1 + self.multiplexed.dim_u)

    def state(self, u: Float[Array, " m"]) -> State:
        """The evaluated (index, u) that a point of the larger cube stands for."""
        return self.multiplexed.evaluate(State(stratum(u[0], self.multiplexed.n_techniques), u[1:]))

    def log_f(self, x: Float[Array, " m"]) -> Scalar:
        return jnp.where(jnp.all((x >= 0) & (x <= 1)), self.state(x).seen.log_c, -jnp.inf)

    def bin_masses(self, edges: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        """The exact integral over boxes between (edges of u_0, edges of u_1), for techniques of one number."""
        require(self.multiplexed.dim_u == 1, "Floored: the masses of boxes are known for techniques of one number only")
        n = self.multiplexed.n_techniques
        first, second = (rising(np.asarray(part), "Floored.bin_masses") for part in edges)
        inside = np.clip(first[:, None] * n - np.arange(n), 0, 1)  # how much of each index lies below an edge
        breaks = Pooled(self.multiplexed).breaks
        masses = integrate(_Each(self.multiplexed), np.clip(second, 0, 1), breaks)[0]
        return np.diff(inside, axis=0) / n @ masses.T


class _Each(eqx.Module):
    """C_i(u) of every technique."""

    multiplexed: Multiplexed

    def __call__(self, u: Scalar) -> Float[Array, " n"]:
        return jnp.exp(Pooled(self.multiplexed).contributions(jnp.atleast_1d(u))[1])


def pooled(multiplexed: Multiplexed, combine: Literal["sum", "maximum"] = "sum") -> Multiplexed:
    """The target of PSSMLT: `Pooled` on its cube, x = u. `PooledDeposit` makes samples of the original f of it."""
    return Multiplexed(Pooled(multiplexed, combine), cube(multiplexed.dim_u))


def floored(multiplexed: Multiplexed) -> Multiplexed:
    """The same law as `multiplexed`'s, with the index as the floor of a number that moves like the others."""
    return Multiplexed(Floored(multiplexed), cube(1 + multiplexed.dim_u))


def samples(target: Floored, u: ArrayLike) -> np.ndarray:
    """The x that each of n points u of the larger cube, (n, m + 1), stands for; in float64 on the host."""
    with jax.enable_x64(True):
        return np.asarray(_states(cast(target, jnp.float64), jnp.asarray(u, jnp.float64)).seen.x)


@eqx.filter_jit
def _states(target: Floored, u: Float[Array, "n m"]) -> State:
    return jax.vmap(target.state)(u)


def integral(target: Target) -> float:
    """The exact integral of a 1D target over its domain: for `Pooled`, what its chain's deposits are multiplied by.

    Raises `ValueError` for a target of more dimensions.
    """
    require(np.ndim(target.domain[0]) == 0, f"integral: {type(target).__name__} is no target on the line")
    return float(integrate(DensityOf(target), np.asarray(target.domain, np.float64), target.breaks)[0].sum())


class PooledDeposit(OfMove[Move]):
    """Step u, and deposit the samples of all techniques, of the current and the proposed u (expected values).

    Sample i of u gets C_i(u) / C(u), times 1 - a for the current and a for the proposed u. Their expectation over the
    chain is the integral of f over a bin, divided by that of C; the total of a step is one for the sum, and up to n
    for the maximum. Deposit k is of technique k mod n, its `index`.
    """

    move: Move

    def __check_init__(self):
        require_instance(self.move, Move, "PooledDeposit: the move")

    def check(self, target: Multiplexed) -> None:
        _pooled(target)
        self.move.check(target)

    def sampled(self, target: Multiplexed) -> Multiplexed:
        """What is pooled."""
        return _pooled(target).multiplexed

    def deposited(self, target: Multiplexed) -> Deposited:
        """Samples of the f that is pooled; with the maximum, so many a step as its integral has fallen short of b.

        Raises `ValueError` for the maximum over techniques of several numbers, whose integral is not known.
        """
        own = _pooled(target)
        if own.combine == "sum":
            return Deposited(own.multiplexed)
        total = integral(own.multiplexed.target) / integral(own)
        return Deposited(own.multiplexed, total, own.multiplexed.n_techniques)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        own = _pooled(target)
        proposal = proposal_of(self.move, target, state, w[:-1])
        proposed = target.evaluate(proposal.state)
        require(
            len(proposed.seen.kept) > 0,
            f"PooledDeposit: {type(self.move).__name__} returns a state that it has evaluated itself, without what all "
            "techniques make of its u: let it return the state without its eval",
        )
        step = accept(target, state, eqx.tree_at(lambda p: p.state, proposal, proposed), w[-1], "plain")
        a, here = step.info.acceptance[0], state.seen.kept
        there = select(a > 0, proposed.seen.kept, here)  # an impossible proposal may be no point at all
        weight = jnp.concatenate([_shares(own, here[1], 1 - a), _shares(own, there[1], a)])
        x, index = jnp.concatenate([here[0], there[0]]), jnp.arange(len(weight), dtype=jnp.int32) % (len(weight) // 2)
        return Step(step.state, Deposits(x, index, weight), step.info)


def _pooled(target: Multiplexed) -> Pooled:
    return require_instance(target.target, Pooled, "PooledDeposit: the chain's target", "; see pooled()")


def _shares(own: Pooled, log_c: Float[Array, " n"], share: Scalar) -> Float[Array, " n"]:
    """The share dealt out to the samples of one u; a dark u, from which every chain leaves, gives nothing."""
    log_total = own.combined(log_c)
    lit = jnp.isfinite(log_total) & (log_c > -jnp.inf)
    return jnp.where(lit, share * jnp.exp(jnp.where(lit, log_c - log_total, 0)), 0)


def _examples() -> dict[str, Target | Kernel]:
    from mcmc1d.targets import Sinusoid
    from mcmc1d.techniques import Ramp, Tent

    multiplexed = Multiplexed(Sinusoid(0.9, 1.5, 0.1), (Tent(0.3), Ramp(1.2)))
    return {
        "pooled": Pooled(multiplexed),
        "floored": Floored(multiplexed),
        "pooled_deposit": PooledDeposit(SmallStep(0.1)),
    }


EXAMPLES = Examples(_examples)

__all__ = ["Floored", "Pooled", "PooledDeposit", "floored", "integral", "pooled", "samples"]
