"""The techniques of `rjmlt_inverses`: a lobe chosen in any way, and an inverse that fails here and there."""

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.numerics import choose, cumulative, parameter, pick, unchoose
from mcmc1d.techniques import Mixture, Technique, dim_v
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.types import Array, Float, Index, Real, Scalar
from mcmc1d.verify.mutants.base import WrongTechnique


class ChosenLobe(WrongTechnique):
    """A mixture whose inverse chooses the lobe with probabilities T, whatever x is (Bitterli et al. 2017, eq. 24).

    v[0] is the place in T_t's interval, so the determinant is T_t / (alpha_t p_t(x)). `wrong` is 1 for the determinant
    1 / p(x), that of the choice by the posterior, and 0 for its own: numbers, so that all variants compile once.
    """

    right: Mixture
    chances: Float[Real, " n"] = eqx.field(converter=parameter)
    wrong: Scalar = eqx.field(converter=parameter, default=0.0)

    def forward(self, u: Float[Array, " m"]) -> Forward:
        x, v, _ = self.right.forward(u)
        lobe, place = choose(self._ends(self.right.weights), u[0])
        return x, v.at[0].set(unchoose(self._ends(self.chances), lobe, place)), self._log_det(x, lobe)

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        lobe, place = choose(self._ends(self.chances), v[0])
        options = []
        for technique in self.right.lobes:
            k = dim_v(technique)
            options.append(jnp.concatenate([technique.inverse(x, v[1 : 1 + k])[0], v[1 + k :]]))
        first = unchoose(self._ends(self.right.weights), lobe, place)
        return jnp.concatenate([first[None], pick(options, lobe)]), -self._log_det(x, lobe)

    def _log_det(self, x: Float[Array, "..."], lobe: Index) -> Scalar:
        parts = zip(self.right.lobes, self.right.weights, self.chances, strict=True)
        own = pick([jnp.log(t) - jnp.log(alpha) - technique.log_prob(x) for technique, alpha, t in parts], lobe)
        return jnp.where(self.wrong > 0, -self.right.log_prob(x), own)

    def _ends(self, chances: Float[Array, " n"]) -> list[Scalar]:
        return cumulative([jnp.asarray(chances[t]) for t in range(len(self.right.lobes))])


class Brittle(WrongTechnique):
    """A technique that makes x in a window and can not invert it: the inverse finds nothing there (-inf)."""

    right: Technique
    window: Float[Real, " 2"] = eqx.field(converter=parameter)

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        u, log_det = self.right.inverse(x, v)
        return u, jnp.where((x > self.window[0]) & (x < self.window[1]), -jnp.inf, log_det)
