"""Temperature ladders: one chain over all rungs (serial tempering), or a replica on each (replica exchange).

Both are ordinary targets. A ladder is a `Multiplexed` whose index is the rung; replicas are a point of a product space.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require_instance, rising
from mcmc1d.numerics import is_concrete, parameter, require
from mcmc1d.state import Multiplexed
from mcmc1d.targets import Target
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
    """Log k_i = -log of the integral of f^beta_i, by quadrature (1D targets): every rung is then equally likely."""
    edges = np.asarray(target.domain, np.float64)
    require(edges.shape == (2,), "even_log_prior: the integrals are known of 1D targets; give log_prior=")
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
    """prod_t f(x_t)^beta_t on n copies of a 1D domain: a point is all replicas, x_t the one at beta_t."""

    target: Target
    betas: Float[Real, " n"] = eqx.field(converter=parameter)

    def __check_init__(self):
        require_instance(self.target, Target, "Replicas: the target")
        require(np.ndim(self.target.domain[0]) == 0, "Replicas: the target's x must be a scalar")
        if is_concrete(self.betas):
            rung_of_one(np.asarray(self.betas).tolist())

    @property
    def domain(self) -> Corners:
        n = self.betas.shape[0]
        lower, upper = self.target.domain
        return np.full(n, lower), np.full(n, upper)

    def log_f(self, x: Float[Array, " n"]) -> Scalar:
        rungs = [Tempered(self.target, self.betas[t]).log_f(x[t]) for t in range(self.betas.shape[0])]
        return jnp.stack(rungs).sum()

    def bin_masses(self, edges: np.ndarray | Sequence[np.ndarray]) -> np.ndarray:
        """The exact integral over each box: `edges` of every coordinate, or one array for all; shape (bins, ...)."""
        betas = np.asarray(self.betas)
        each = [edges] * len(betas) if isinstance(edges, np.ndarray) and edges.ndim == 1 else list(edges)
        require(len(each) == len(betas), f"Replicas: give the edges of {len(betas)} coordinates, not of {len(each)}")
        masses = np.ones(())
        for beta, own in zip(betas, each, strict=True):
            row = Tempered(self.target, beta).bin_masses(rising(np.asarray(own), "Replicas.bin_masses"))
            masses = masses[..., None] * row
        return masses


def replicas(target: Target, betas: Sequence[float], technique: Technique | None = None) -> Multiplexed:
    """Replica exchange: independent replicas at all temperatures at once, as one point of a product space.

    Steps of the coordinates (`moves.exchange.CoordinateStep`) leave their product invariant, and so does the swap of
    two (`moves.exchange.Exchange`); coordinate `rung_of_one(betas)` has the law f / b. `technique` makes one
    coordinate from one number; `Uniform` unless given.
    """
    technique = Uniform() if technique is None else technique
    require(
        technique.dim_u == 1 and sample_shape(technique) == (),
        f"replicas: the technique must make a scalar from one number; {type(technique).__name__} reads "
        f"{technique.dim_u}",
    )
    return Multiplexed(Replicas(target, betas), Product((technique,) * len(betas)))


def _examples() -> dict[str, Target]:
    from mcmc1d.targets.gaussian_mixture import walls_and_valley

    return {"replicas": Replicas(walls_and_valley(), [1.0, 0.3])}


EXAMPLES = _examples()
