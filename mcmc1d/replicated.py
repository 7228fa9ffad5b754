"""Replica exchange over techniques: one replica for each, on a product of primary sample spaces, which swap numbers."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_instance
from mcmc1d.examples import Examples
from mcmc1d.metropolis import Deposited, Deposits, OfMove, Step, accept
from mcmc1d.moves import Move
from mcmc1d.moves.base import proposal_of
from mcmc1d.moves.exchange import Exchange
from mcmc1d.numerics import is_concrete, parameter
from mcmc1d.pooled import Floored
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import Target
from mcmc1d.targets.base import edges_of_each, unit_cube
from mcmc1d.techniques.product import cube
from mcmc1d.types import Array, Corners, Float, Real, Scalar

_ALIKE = 1e-6
"""How far shares may be from the exact ones: far less than `verify` sees, more than float32 rounds."""


class Replicated(Target):
    """prod_i C_i(u_i), C_i = w_i f / p_i: independent chains, one for each technique, as one point of a larger cube.

    With respect to du on the cube of all their numbers, which is its domain. Replica i has the law C_i / c_i, c_i the
    integral of w_i f; the sum of c_i times what it samples is f.
    """

    multiplexed: Multiplexed
    techniques: tuple[int, ...] = eqx.field(static=True)
    """Those that have a replica: a technique whose contribution is zero everywhere can have none."""

    def __check_init__(self):
        require_instance(self.multiplexed, Multiplexed, "Replicated: what is replicated")
        n, chosen = self.multiplexed.n_techniques, self.techniques
        require(
            len(chosen) > 0 and len(set(chosen)) == len(chosen) and all(0 <= i < n for i in chosen),
            f"Replicated: techniques are different ones of 0 to {n - 1}, not {chosen}",
        )

    @property
    def domain(self) -> Corners:
        return unit_cube(len(self.techniques) * self.multiplexed.dim_u)

    def contributions(self, u: Float[Array, " m"]) -> tuple[Float[Array, "n ..."], Float[Array, " n"]]:
        """(x_i, log C_i) of every replica."""
        each = jnp.reshape(u, (len(self.techniques), self.multiplexed.dim_u))
        states = State(jnp.asarray(self.techniques, jnp.int32), each)
        found = jax.vmap(lambda i, u: self.multiplexed.evaluate(State(i, u)).seen)(states.index, states.u)
        return found.x, found.log_c

    def log_f(self, x: Float[Array, "..."]) -> Scalar:
        """Sum of log C_i at u = x; -inf outside of the cube."""
        u = jnp.atleast_1d(x)
        return jnp.where(jnp.all((u >= 0) & (u <= 1)), self.contributions(u)[1].sum(), -jnp.inf)

    def bin_masses(self, edges: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        """The exact integral over each box, for techniques of one number: `edges` of every u, or one array for all."""
        require(self.multiplexed.dim_u == 1, "Replicated: the masses of boxes are known for techniques of one number")
        each = edges_of_each(edges, len(self.techniques), "Replicated.bin_masses")
        n, masses = self.multiplexed.n_techniques, np.ones(())
        for i, own in zip(self.techniques, each, strict=True):
            # In the floored index's law technique i has one n-th of its integral.
            row = n * Floored(self.multiplexed).bin_masses((np.array([i, i + 1]) / n, np.asarray(own)))[0]
            masses = masses[..., None] * row
        return masses


def replicated(multiplexed: Multiplexed, techniques: tuple[int, ...] | None = None) -> Multiplexed:
    """The target of replica exchange over techniques, all of them unless given: `Replicated` on its cube, x = u.

    `moves.exchange.ReplicaStep` steps one replica, `Exchange` swaps two; their width is `multiplexed.dim_u`.
    """
    chosen = tuple(range(multiplexed.n_techniques)) if techniques is None else tuple(techniques)
    return Multiplexed(Replicated(multiplexed, chosen), cube(len(chosen) * multiplexed.dim_u), probes=0)


class ReplicaDeposit(OfMove[Move]):
    """Step, and deposit the sample of every replica, with weight `shares`; a deposit's index is its technique.

    With c_i / sum_j c_j as shares, the deposits have the law f / b. No law is known of them where the shares are not
    these to 1e-6 of the whole, where a technique that has no replica contributes, and where the c_i are not known
    exactly: of a target in more than two dimensions.
    """

    move: Move
    shares: Float[Real, " n"] = eqx.field(converter=parameter)

    def __check_init__(self):
        require_instance(self.move, Move, "ReplicaDeposit: the move")

    def check(self, target: Multiplexed) -> None:
        own = _replicated(target)
        self.move.check(target)
        shape = np.shape(self.shares)
        require(
            shape == (len(own.techniques),)
            and (not is_concrete(self.shares) or bool(np.all(np.asarray(self.shares) >= 0))),
            f"ReplicaDeposit: {len(own.techniques)} replicas have as many shares, none negative, not {self.shares}",
        )

    def sampled(self, target: Multiplexed) -> Multiplexed:
        """What the replicas are of."""
        return _replicated(target).multiplexed

    def deposited(self, target: Multiplexed) -> Deposited:
        own, total = _replicated(target), float(np.sum(self.shares))
        known = total > 0 and self._in_proportion(own, np.asarray(self.shares, np.float64) / total)
        return Deposited(own.multiplexed if known else None, total, total)

    def _in_proportion(self, own: Replicated, shares: Float[np.ndarray, " n"]) -> bool:
        """Whether they are known to be those of the techniques in f."""
        ends = np.stack([np.asarray(end, np.float64) for end in own.multiplexed.target.domain])
        if ends.shape not in ((2,), (2, 2)):
            return False
        try:
            masses = own.multiplexed.joint_masses(ends if ends.ndim == 1 else (ends[:, 0], ends[:, 1]))
        except ValueError:  # f, or a weight, has a jump that nothing names
            return False
        given = np.zeros(own.multiplexed.n_techniques)
        given[list(own.techniques)] = shares
        return bool(np.abs(given - masses.reshape(len(given), -1).sum(1)).max() <= _ALIKE)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        own = _replicated(target)
        step = accept(target, state, proposal_of(self.move, target, state, w[:-1]), w[-1], "plain")
        x, _ = own.contributions(step.state.u)
        weight = jnp.asarray(self.shares, w.dtype)
        return Step(step.state, Deposits(x, jnp.asarray(own.techniques, jnp.int32), weight), step.info)


def _replicated(target: Multiplexed) -> Replicated:
    return require_instance(target.target, Replicated, "ReplicaDeposit: the chain's target", "; see replicated()")


def _examples() -> dict[str, Target | ReplicaDeposit]:
    from mcmc1d.targets import Sinusoid
    from mcmc1d.techniques import Ramp, Tent

    multiplexed = Multiplexed(Sinusoid(0.9, 1.5, 0.1), (Tent(0.3), Ramp(1.2)))
    return {
        "replicated": Replicated(multiplexed, (0, 1)),
        "replica_deposit": ReplicaDeposit(Exchange(), np.array([0.5, 0.5])),
    }


EXAMPLES = Examples(_examples)

__all__ = ["ReplicaDeposit", "Replicated", "replicated"]
