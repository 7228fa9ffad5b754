"""Wrong inverses of a right mixture technique."""

import jax.numpy as jnp

from mcmc1d.numerics import choose, cumulative, locate, unchoose
from mcmc1d.techniques import Mixture, RaisedSinusoid, Ramp, Technique, Tent, dim_v
from mcmc1d.techniques.base import Forward, Inverse
from mcmc1d.types import Array, Float, Scalar
from mcmc1d.verify.mutants import Mutant
from mcmc1d.verify.mutants.base import WrongTechnique


class FixedPointInverse(WrongTechnique):
    """Bitterli et al. 2017, figure 3c: the lobe is chosen rightly, but the inverse returns the middle of its interval.

    Without the place inside the interval (eq. 21) the jump reaches a set of measure zero.
    """

    right: Mixture

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        u, log_det = self.right.inverse(x, v)
        ends = _prior(self.right)
        return u.at[0].set(unchoose(ends, locate(ends, u[0]), jnp.full_like(u[0], 0.5))), log_det


class PriorLobe(WrongTechnique):
    """The lobe chosen by the prior, which is right, with the posterior's determinant -log p(x), which is not its own.

    DESIGN's trap: with the determinant -log p_lobe(x) this would be a right technique.
    """

    right: Mixture

    def forward(self, u: Float[Array, " m"]) -> Forward:
        x, v, _ = self.right.forward(u)
        return x, v.at[0].set(u[0]), -self.right.log_prob(x)

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        lobe, _ = choose(_prior(self.right), v[0])
        options = []
        for technique in self.right.lobes:
            k = dim_v(technique)
            options.append(jnp.concatenate([technique.inverse(x, v[1 : 1 + k])[0], v[1 + k :]]))
        u = jnp.stack(options)[lobe]
        return jnp.concatenate([v[:1], u]), self.right.log_prob(x)


class WrongSign(WrongTechnique):
    """The inverse's log-determinant with the sign of the forward's."""

    right: Technique

    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        u, log_det = self.right.inverse(x, v)
        return u, -log_det


class Proportional(WrongTechnique):
    """A density known up to a factor, used as the density."""

    right: Technique

    def log_prob(self, x: Float[Array, "..."]) -> Scalar:
        return self.right.log_prob(x) + jnp.log(2.0)


def _prior(mixture: Mixture) -> list[Scalar]:
    return cumulative([jnp.asarray(weight) for weight in mixture.weights])


_MIXTURE = Mixture((RaisedSinusoid(0.9), Ramp(1.5)), (0.3, 0.7))

MUTANTS = {
    "fixed_point_inverse": Mutant(
        FixedPointInverse(_MIXTURE),
        "fixed-point inverse",
        "Bitterli et al. 2017, figure 3c",
        "inverse(forward(u)) = u",
    ),
    "prior_lobe": Mutant(
        PriorLobe(_MIXTURE),
        "prior choice of lobe with the posterior's determinant",
        "Bitterli et al. 2017, eq. 24 without its factor",
        "forward's log_det = log|det d(x, v)/du| by autodiff",
    ),
    "wrong_sign": Mutant(
        WrongSign(Tent(0.3)),
        "log-Jacobian of the inverse with the wrong sign",
        "danielward27/flowjax #208",
        "inverse's log_det = -forward's",
    ),
    "proportional_density": Mutant(
        Proportional(Tent(0.3)),
        "proportional density taken for the density",
        "mmp/pbrt-v4 f739c887",
        "the integral of p is 1",
    ),
}
