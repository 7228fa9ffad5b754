"""Moves of single coordinates of u: block-wise steps, and the exchange of two replicas."""

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.moves.base import Move, Proposal, zero
from mcmc1d.numerics import normal_quantile, parameter, require, require_positive, wrap
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Index, Scalar


class CoordinateStep(Move):
    """A Gaussian step of one coordinate of u, around the ends; the others keep their numbers (block-wise update).

    (w_0, w_1): w_0 chooses the coordinate and is kept, w_1 steps it and becomes 1 - w_1. With a fixed `coordinate`
    there is w_1 alone; such a step is no chain by itself, but one of a `Cycle` over the coordinates.
    """

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)
    coordinate: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)

    def dim_w(self, target: Multiplexed) -> int:
        return 2 if self.coordinate is None else 1

    def check(self, target: Multiplexed) -> None:
        k, m = self.coordinate, target.dim_u
        require(k is None or 0 <= k < m, f"CoordinateStep: u has coordinates 0 to {m - 1}; there is no {k}")

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        m = target.dim_u
        chosen = nth(w[0], m) if self.coordinate is None else jnp.asarray(self.coordinate)
        stepped = wrap(state.u + self.sigma * normal_quantile(w[-1]))
        u = jnp.where(jnp.arange(m) == chosen, stepped, state.u)
        return Proposal(State(state.index, u), w.at[-1].set(1 - w[-1]), zero(u))


class Exchange(Move):
    """Two neighbouring coordinates of u swap their numbers: replica exchange (Swendsen and Wang 1986; Geyer 1991).

    With one technique for every coordinate the samples are swapped, and the acceptance ratio is that of the product
    target, f(x)^(b - b') f(x')^(b' - b). w_0 chooses the pair and is kept.
    """

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def check(self, target: Multiplexed) -> None:
        require(target.dim_u >= 2, f"Exchange: there must be two coordinates of u to swap, not {target.dim_u}")

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        m = target.dim_u
        k, at = nth(w[0], m - 1), jnp.arange(m)
        u = jnp.where(at == k, jnp.roll(state.u, -1), jnp.where(at == k + 1, jnp.roll(state.u, 1), state.u))
        return Proposal(State(state.index, u), w, zero(u))


def nth(number: Scalar, n: int) -> Index:
    """Which of n equal intervals of [0, 1) holds the number."""
    return jnp.minimum((number * n).astype(jnp.int32), n - 1)


EXAMPLES = {
    "coordinate_step": CoordinateStep(0.1),
    "coordinate_step_first": CoordinateStep(0.3, 0),
    "exchange": Exchange(),
}
