"""Mixtures of techniques, inverted through the posterior of the lobe."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance, several
from mcmc1d.examples import Examples
from mcmc1d.numerics import choose, cumulative, is_concrete, parameter, pick, unchoose
from mcmc1d.special import log_sum
from mcmc1d.techniques.base import Forward, Inverse, Technique, checked_shape, dim_v
from mcmc1d.types import Array, Corners, Float, Real, Scalar


class Mixture(Technique):
    """A lobe chosen with probability alpha_t by u[0], then sampled with u[1:] (Bitterli et al. 2017, eq. 15).

    A sample does not tell which lobe made it, so `v[0]` does: the lobe's interval in the *posterior*
    P_t(x) = alpha_t p_t(x) / p(x) (eq. 25), and in it the place that u[0] had inside the lobe's interval of the
    prior (eq. 22). Then the determinant is -log p(x) pointwise, as long as each lobe's is -log p_t(x); a lobe may
    itself be a mixture. `v` is (v[0], the lobe's v, the numbers that the lobe did not read).
    """

    lobes: tuple[Technique, ...]
    weights: Float[Real, " n"]

    def __init__(self, lobes: Sequence[Technique], weights: ArrayLike):
        """`lobes`: techniques with one shape of x; `weights`: their probabilities alpha, which sum to one."""
        self.lobes = several(lobes, "Mixture: the lobes")
        for lobe in self.lobes:
            require_instance(lobe, Technique, "Mixture: a lobe")
        self.weights = parameter(weights)
        require(len(self.lobes) > 0, "Mixture: give one lobe at least")
        require(
            self.weights.shape == (len(self.lobes),),
            f"Mixture: {len(self.lobes)} lobes need {len(self.lobes)} weights, not shape {self.weights.shape}",
        )
        if is_concrete(self.weights):
            alpha = np.asarray(self.weights)
            require(
                bool(np.all(alpha >= 0)) and abs(alpha.sum() - 1) < 1e-6,
                f"Mixture: the weights must not be negative, and sum to one; {alpha} sum to {alpha.sum()}",
            )
        shapes = {checked_shape(lobe) for lobe in self.lobes}
        require(len(shapes) == 1, f"Mixture: the lobes' samples must have one shape, not {sorted(shapes)}")

    @property
    def dim_u(self) -> int:
        """One number for the choice, and as many as the hungriest lobe reads."""
        return 1 + max(lobe.dim_u for lobe in self.lobes)

    @property
    def support(self) -> Corners:
        lowers, uppers = zip(*(lobe.support for lobe in self.lobes), strict=True)
        return np.min(np.asarray(lowers), axis=0), np.max(np.asarray(uppers), axis=0)

    @property
    def breaks(self) -> tuple[float, ...]:
        ends = [float(end) for lobe in self.lobes for end in lobe.support if np.ndim(end) == 0]
        inner = set(ends) - {float(end) for end in self.support if np.ndim(end) == 0}
        return tuple(sorted(inner.union(*(lobe.breaks for lobe in self.lobes))))

    def forward(self, u: Float[Array, " m"]) -> Forward:
        lobe, place = choose(self._prior(), u[0])
        options = []
        for technique in self.lobes:
            x, v, log_det = technique.forward(u[1 : 1 + technique.dim_u])
            # What the lobe's own determinant has beyond its density; nothing, where v says nothing about x. At an
            # edge where the density is 0 and the determinant infinite, the limit is that of a regular point.
            beyond = _finite_or(log_det + technique.log_prob(x), 0)
            options.append((x, jnp.concatenate([v, u[1 + technique.dim_u :]]), beyond))
        x, v, beyond = pick(options, lobe)
        log_p, posterior = self._posterior(x)
        place = unchoose(posterior, lobe, place)
        return x, jnp.concatenate([place[None], v]), beyond - log_p

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        log_p, posterior = self._posterior(x)
        lobe, place = choose(posterior, v[0])
        options = []
        for technique in self.lobes:
            k = dim_v(technique)
            u, log_det = technique.inverse(x, v[1 : 1 + k])
            beyond = _finite_or(log_det - technique.log_prob(x), 0)
            options.append((jnp.concatenate([u, v[1 + k :]]), beyond))
        u, beyond = pick(options, lobe)
        choice = unchoose(self._prior(), lobe, place)
        return jnp.concatenate([choice[None], u]), beyond + log_p

    def log_prob(self, x: Float[Array, "..."]) -> Scalar:
        return log_sum(self._log_joint(x))

    def prob(self, x: Float[Array, "..."]) -> Scalar | None:
        found = [lobe.prob(x) for lobe in self.lobes]
        if any(p is None for p in found):
            return None
        return sum(self.weights[t] * p for t, p in enumerate(found))

    def _prior(self) -> list[Scalar]:
        return cumulative([jnp.asarray(self.weights[t]) for t in range(len(self.lobes))])

    def _log_joint(self, x: Float[Array, "..."]) -> list[Scalar]:
        return [jnp.log(self.weights[t]) + lobe.log_prob(x) for t, lobe in enumerate(self.lobes)]

    def _posterior(self, x: Float[Array, "..."]) -> tuple[Scalar, list[Scalar]]:
        """Log p(x), and the ends of the lobes' intervals in the posterior; the prior's where the density is zero."""
        log_joint = self._log_joint(x)
        log_p = log_sum(log_joint)
        possible = jnp.isfinite(log_p)
        shares = [
            jnp.where(possible, jnp.exp(term - log_p), alpha)
            for term, alpha in zip(log_joint, self.weights, strict=True)
        ]
        return log_p, cumulative(shares)


def _finite_or(value: Scalar, otherwise: float) -> Scalar:
    return jnp.where(jnp.isfinite(value), value, otherwise)


def _examples() -> dict[str, Technique]:
    from mcmc1d.techniques.elementary import Ramp, Tent, Uniform
    from mcmc1d.techniques.piecewise import PiecewiseConstant
    from mcmc1d.techniques.sinusoid import RaisedSinusoid

    sinusoid_and_ramp = Mixture((RaisedSinusoid(0.9), Ramp(2.0)), (0.3, 0.7))
    return {
        "mixture": sinusoid_and_ramp,
        "mixture_nested": Mixture((Tent(0.3), sinusoid_and_ramp, Uniform()), (0.25, 0.5, 0.25)),
        "mixture_with_holes": Mixture((PiecewiseConstant([0, 0.4, 0.6, 1], [1, 0, 2]), Ramp(-2.0)), (0.9, 0.1)),
    }


EXAMPLES = Examples(_examples)
