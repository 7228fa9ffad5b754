"""The steps of `beyond_rjmlt` that are sized by the Jacobian, as long in x everywhere: a wrong one, and their times."""

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.moves import Move, Proposal
from mcmc1d.moves.scaled import ScaledStep
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import PiecewiseLinear, RaisedSinusoid
from mcmc1d.types import Array, Float


class UnaccountedStep(Move):
    """The scaled step, taken for symmetric."""

    right: ScaledStep

    def dim_w(self, target: Multiplexed) -> int:
        return self.right.dim_w(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        proposal = self.right.propose(target, state, w)
        return Proposal(proposal.state, proposal.w, 0 * proposal.log_det)


SMOOTH = Sinusoid(0.5, 1.0, 0.2, 1.0)
TECHNIQUES = {
    "poor match": PiecewiseLinear([0, 0.2, 0.5, 0.8, 1], [0.1, 2.0, 0.1, 2.0, 0.1]),
    "good match": RaisedSinusoid(0.5, 1, 0.2),
}
SIZES = np.array([0.05, 0.1, 0.15, 0.25, 0.4])
SCALED_AT = 0.15


def times(cells: int = 600) -> np.ndarray:
    """The integrated autocorrelation time of x: by (technique, kind of step, size), from the chain on cells of u.

    The midpoint rule; the narrowest step is three cells wide. The time by the fundamental matrix (I - P + 1 pi)^-1.
    """
    found = np.zeros((len(TECHNIQUES), 2, len(SIZES)))
    u = (np.arange(cells) + 0.5) / cells
    away = u - u[:, None] + np.arange(-6, 7)[:, None, None]
    for i, technique in enumerate(TECHNIQUES.values()):
        with jax.enable_x64(True):
            x = jax.vmap(technique.quantile)(jnp.asarray(u))
            p, f = (np.exp(np.asarray(jax.vmap(log)(x))) for log in (technique.log_prob, SMOOTH.log_f))
        pi, x = f / p / (f / p).sum(), np.asarray(x)
        for j, k in np.ndindex(2, len(SIZES)):
            size = (SIZES[k] * (p if j else np.ones(cells)))[:, None]
            q = (np.exp(-((away / size) ** 2) / 2).sum(0)) / (size * np.sqrt(2 * np.pi) * cells)
            flux = np.minimum(pi[:, None] * q, (pi[:, None] * q).T)
            matrix = flux / pi[:, None]
            matrix[np.diag_indices(cells)] += 1 - matrix.sum(1)
            g = x - pi @ x
            later = np.linalg.solve(np.eye(cells) - matrix + pi, g)
            found[i, j, k] = 2 * (pi * g) @ later / (pi @ g**2) - 1
    return found
