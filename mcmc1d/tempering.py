"""Temperature ladders: one chain over all rungs (serial tempering), or a replica on each (replica exchange).

Both are ordinary targets. A ladder is a `Multiplexed` whose index is the rung; replicas are a point of a product space.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, parameter
from mcmc1d.state import Multiplexed
from mcmc1d.targets import Target
from mcmc1d.targets.base import edges_of_each
from mcmc1d.targets.tempered import Sum, Tempered
from mcmc1d.techniques import Technique, Uniform, sample_shape
from mcmc1d.techniques.product import Product
from mcmc1d.types import Array, Corners, Float, Real, Scalar
from mcmc1d.weights import Parts


def over_parts(targets: Sequence[Target], techniques: Sequence[Technique]) -> Multiplexed:
    """One chain over several targets f_i, each with a technique of its own: C_i(u) = f_i(x) / p_i(x).

    Its law is f_i(x) / sum_j b_j, jointly in (i, x): the index has b_i / sum_j b_j, and given i the x has f_i / b_i.
    One chain over paths of every length is such a one (Hachisuka et al. 2014, section 4).
    """
    require(
        len(targets) == len(techniques),
        f"over_parts: {len(targets)} targets need {len(targets)} techniques, not {len(techniques)}",
    )
    return Multiplexed(Sum(targets), techniques, Parts(targets))


def ladder(
    target: Target, betas: Sequence[float], technique: Technique | None = None, log_prior: ArrayLike | None = None
) -> Multiplexed:
    """Serial tempering: states (rung, u) with density k_i f(x)^beta_i / p(x) (Marinari and Parisi 1992).

    Whatever the pseudo-prior k, x given the rung of beta = 1 has the law f / b; the prior moves time between rungs
    only (Geyer and Thompson 1995). `rung_of_one(betas)` is that rung, the row of a joint histogram to look at.

    Arguments: `betas`, inverse temperatures with 1 among them, none negative; `technique`, the same on every rung,
    `Uniform` unless given; `log_prior`, log k, one for each rung, unless given `even_log_prior`, which makes all rungs
    equally likely. Raises `ValueError` where the ladder has no rung of the target itself.
    """
    rung_of_one(betas)
    log_k = even_log_prior(target, betas) if log_prior is None else np.asarray(log_prior, np.float64)
    require(
        log_k.shape == (len(betas),),
        f"ladder: a log-prior for {len(betas)} rungs must be {len(betas)} numbers, not of shape {log_k.shape}",
    )
    rungs = [Tempered(target, beta, k) for beta, k in zip(betas, log_k, strict=True)]
    return over_parts(rungs, [Uniform() if technique is None else technique] * len(rungs))


def even_log_prior(target: Target, betas: Sequence[float]) -> np.ndarray:
    """Log k_i = -log of the integral of f^beta_i, by quadrature: every rung is then equally likely."""
    ends = np.asarray(target.domain, np.float64)
    known = ends.shape in ((2,), (2, 2))
    require(known, "even_log_prior: the integrals are known on the line and in the plane; give log_prior=")
    edges = ends if ends.ndim == 1 else tuple(ends.T)
    return -np.log([float(Tempered(target, beta).bin_masses(edges).sum()) for beta in betas])


def rung_of_one(betas: Sequence[float]) -> int:
    """The rung on which the target itself is sampled; `ValueError` where there is none."""
    values = np.asarray(betas, np.float64)
    require(values.ndim == 1 and values.size > 0, f"a ladder is a list of inverse temperatures, not {betas}")
    bad = values[~(np.isfinite(values) & (values >= 0))]
    require(bad.size == 0, f"a ladder's inverse temperatures must be finite and not negative, not {bad[:1]}")
    require(
        bool((values == 1).any()),
        f"the ladder {values.tolist()} does not contain the temperature 1: no rung samples the target; add beta = 1",
    )
    return int(np.argmax(values == 1))


class Replicas(Target):
    """prod_t f(x_t)^beta_t on n copies of a domain: a point is all replicas end to end, x_t the one at beta_t."""

    target: Target
    betas: Float[Real, " n"] = eqx.field(converter=parameter)

    def __check_init__(self):
        require_instance(self.target, Target, "Replicas: the target")
        if is_concrete(self.betas):
            rung_of_one(np.asarray(self.betas).tolist())

    @property
    def domain(self) -> Corners:
        lower, upper = (np.tile(np.atleast_1d(corner), self.betas.shape[0]) for corner in self.target.domain)
        return lower, upper

    def log_f(self, x: Float[Array, " nd"]) -> Scalar:
        shape = np.shape(self.target.domain[0])
        each = jnp.split(x, self.betas.shape[0])
        rungs = [Tempered(self.target, self.betas[t]).log_f(own.reshape(shape)) for t, own in enumerate(each)]
        return jnp.stack(rungs).sum()

    def bin_masses(self, edges: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        """The exact integral over each box: `edges` of every coordinate, or one array for all; shape (bins, ...)."""
        betas, d = np.asarray(self.betas), np.size(self.target.domain[0])
        n = d * len(betas)
        each = edges_of_each(edges, n, "Replicas.bin_masses")
        masses = np.ones(())
        for t, beta in enumerate(betas):
            own = each[d * t : d * (t + 1)]
            masses = np.multiply.outer(masses, Tempered(self.target, beta).bin_masses(own[0] if d == 1 else own))
        return masses


def replicas(target: Target, betas: Sequence[float], technique: Technique | None = None) -> Multiplexed:
    """Replica exchange: independent replicas at all temperatures at once, as one point of a product space.

    Steps of one replica (`moves.exchange.ReplicaStep(step, technique.dim_u)`, or `CoordinateStep`) leave their product
    invariant, and so does the swap of two, `moves.exchange.Exchange(technique.dim_u)`. Replica `rung_of_one(betas)` has
    the law f / b. `technique` makes one replica's x; `Uniform` unless given.
    """
    technique = Uniform() if technique is None else technique
    require_instance(target, Target, "replicas: the target")
    require_instance(technique, Technique, "replicas: the technique")
    made, wanted = sample_shape(technique), np.shape(target.domain[0])
    require(
        made == wanted,
        f"replicas: the technique must make one replica's x, of shape {wanted}; {type(technique).__name__}'s is of "
        f"shape {made}; name another: replicas(target, betas, technique)",
    )
    return Multiplexed(Replicas(target, betas), Product((technique,) * len(betas)))


def _examples() -> dict[str, Target]:
    from mcmc1d.targets.gaussian_mixture import walls_and_valley

    return {"replicas": Replicas(walls_and_valley(), [1.0, 0.3])}


EXAMPLES = Examples(_examples)
