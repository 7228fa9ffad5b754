"""Moves of some of the numbers of u: block-wise steps, steps of one replica, and the exchange of two."""

import equinox as eqx
import jax
import jax.numpy as jnp

from mcmc1d.checks import require, require_instance, require_step, require_whole
from mcmc1d.examples import Examples
from mcmc1d.moves.base import EachAlone, Move, Proposal, zero
from mcmc1d.moves.primary import LargeStep
from mcmc1d.numerics import parameter, stratum, wrap
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar


class CoordinateStep(Move):
    """A Gaussian step of one coordinate of u, around the ends; the others keep their numbers (block-wise update).

    (w_0, w_1): w_0 chooses the coordinate and is kept, w_1 steps it and becomes 1 - w_1. With a fixed `coordinate`
    there is w_1 alone; such a step is no chain by itself, but one of a `Cycle` over the coordinates.
    """

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)
    coordinate: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        require_step(self, sigma=self.sigma)
        if self.coordinate is not None:
            require_whole(self.coordinate, "CoordinateStep: coordinate", 0)

    def dim_w(self, target: Multiplexed) -> int:
        return 2 if self.coordinate is None else 1

    def check(self, target: Multiplexed) -> None:
        k, m = self.coordinate, target.dim_u
        require(k is None or k < m, f"CoordinateStep: u has coordinates 0 to {m - 1}; there is no {k}")

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        m = target.dim_u
        chosen = stratum(w[0], m) if self.coordinate is None else jnp.asarray(self.coordinate)
        stepped = wrap(state.u + self.sigma * normal_quantile(w[-1]))
        u = jnp.where(jnp.arange(m) == chosen, stepped, state.u)
        return Proposal(State(state.index, u), w.at[-1].set(1 - w[-1]), zero(u))


class ReplicaStep(Move):
    """A step of one replica, `width` neighbouring numbers of u; the others keep theirs.

    (w_0, ...): w_0 chooses the replica and is kept, the others are those of the step.
    """

    step: EachAlone
    width: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        require_instance(self.step, EachAlone, "ReplicaStep: the step", "; give a SmallStep or a LargeStep")
        require_whole(self.width, "ReplicaStep: width")

    def dim_w(self, target: Multiplexed) -> int:
        return 1 + self.width

    def check(self, target: Multiplexed) -> None:
        _require_replicas("ReplicaStep", target, self.width, 1)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        first = self.width * stratum(w[0], target.dim_u // self.width)
        own = jax.lax.dynamic_slice(state.u, (first,), (self.width,))
        stepped = self.step.propose(target, State(state.index, own), w[1:])
        u = jax.lax.dynamic_update_slice(state.u, stepped.state.u, (first,))
        return Proposal(State(state.index, u), w.at[1:].set(stepped.w), stepped.log_det)


class Exchange(Move):
    """Two neighbouring replicas swap their numbers: replica exchange (Swendsen and Wang 1986; Geyer 1991).

    A replica is `width` neighbouring numbers of u. With one technique for every replica the samples are swapped, and
    the acceptance ratio is that of the product target, f(x)^(b - b') f(x')^(b' - b). w_0 chooses the pair and is kept.
    """

    width: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        require_whole(self.width, "Exchange: width")

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def check(self, target: Multiplexed) -> None:
        _require_replicas("Exchange", target, self.width, 2)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        k, at = stratum(w[0], target.dim_u // self.width - 1), jnp.arange(target.dim_u) // self.width
        up, down = jnp.roll(state.u, -self.width), jnp.roll(state.u, self.width)
        u = jnp.where(at == k, up, jnp.where(at == k + 1, down, state.u))
        return Proposal(State(state.index, u), w, zero(u))


def _require_replicas(who: str, target: Multiplexed, width: int, least: int) -> None:
    m = target.dim_u
    require(
        m % width == 0 and m // width >= least,
        f"{who}: u must hold {least} replicas of {width} numbers or more, and nothing else; it has {m} numbers",
    )


EXAMPLES = Examples(
    lambda: {
        "coordinate_step": CoordinateStep(0.1),
        "coordinate_step_first": CoordinateStep(0.3, 0),
        "exchange": Exchange(),
        "replica_step": ReplicaStep(LargeStep()),
    }
)
