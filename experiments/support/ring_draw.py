"""An independent proposal on a ring of a few states."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.technique import log_ratio
from mcmc1d.numerics import choose, entry, stratum, unchoose, width
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Real, Scalar


class RingDraw(Move):
    """The middle of cell i with probability g_i, wherever the chain is; the number keeps its place in the interval."""

    ends: Float[Real, " n+1"]
    n: int = eqx.field(static=True)

    def __init__(self, shares: tuple[float, ...]):
        """`shares`: g, which sum to one."""
        self.ends, self.n = np.concatenate([[0.0], np.cumsum(shares)]), len(shares)

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def log_g(self, state: State) -> Scalar:
        """The log-probability of a state's cell."""
        return jnp.log(width(self.ends, self._cell(state)))

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        here = self._cell(state)
        there, place = choose(self.ends, w[0])
        u = entry([jnp.asarray((k + 0.5) / self.n, w.dtype) for k in range(self.n)], there)
        log_det = log_ratio(width(self.ends, here), width(self.ends, there))
        back = unchoose(self.ends, here, place)
        return Proposal(State(state.index, state.u.at[0].set(u)), back[None], log_det.astype(w.dtype))

    def _cell(self, state: State) -> Array:
        return stratum(state.u[0], self.n)
