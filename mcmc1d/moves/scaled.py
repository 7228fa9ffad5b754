"""A small step whose size in u comes from the technique's Jacobian, so that its size in x is the one that is given."""

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtr

from mcmc1d.checks import require_positive
from mcmc1d.examples import Examples
from mcmc1d.moves.base import EachNumber, Proposal
from mcmc1d.numerics import parameter, wrap
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar


class ScaledStep(EachNumber):
    """u' = wrap(u + s(u) z), z = Phi^-1(w), with s(u) = sigma |du/d(x, v)|^(1/m): about sigma z in x, wherever it is.

    Bitterli et al. 2017, section 8.2. For one number s(u) = sigma p(x). The way back has the size at u', so z' = -z
    s(u) / s(u') and w' = Phi(z'); the determinant is (s / s')^m phi(z') / phi(z), the Hastings ratio of the two normal
    densities. That the size depends on the state is what makes the step not symmetric: a chain that leaves the
    determinant out has a wrong law. (In float32 w' keeps few digits where the size grows much; only a check reads it.)
    """

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)
    """Of the step in x."""

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        z, here = normal_quantile(w), self._log_size(target, state)
        proposed = target.evaluate(State(state.index, wrap(state.u + jnp.exp(here) * z)))
        log_ratio = here - self._log_size(target, proposed)
        # The same way round the ends as forth: what u' + s' z' wraps to is u, however often the step went around.
        back = -z * jnp.exp(log_ratio)
        log_det = target.dim_u * log_ratio + jnp.sum(z * z - back * back) / 2
        # Where a number of the way back rounds to 0 or 1 there is none; such a step is all but never accepted.
        numbers = ndtr(back)
        return Proposal(proposed, numbers, jnp.where(jnp.all(numbers > 0), log_det, -jnp.inf))

    def _log_size(self, target: Multiplexed, state: State) -> Scalar:
        return jnp.log(self.sigma) - state.seen.log_det / target.dim_u


EXAMPLES = Examples(lambda: {"scaled_step": ScaledStep(), "scaled_step_fine": ScaledStep(0.01)})
