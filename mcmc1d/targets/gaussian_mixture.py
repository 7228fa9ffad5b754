"""A mixture of normal densities cut off by the walls of the unit interval."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from mcmc1d.checks import require, require_positive, rising
from mcmc1d.examples import Examples
from mcmc1d.numerics import is_concrete, parameter
from mcmc1d.special import log_sum
from mcmc1d.targets.base import Target
from mcmc1d.types import Float, Real, Scalar


class GaussianMixture(Target):
    """f(x) = sum_k weights_k N(x; means_k, sigmas_k^2) on [0, 1], zero outside: bounded, with mass at the walls.

    What the walls cut off is lost, so the integral is under the sum of the weights.
    """

    means: Float[Real, " n"] = eqx.field(converter=parameter)
    sigmas: Float[Real, " n"] = eqx.field(converter=parameter)
    weights: Float[Real, " n"] = eqx.field(converter=parameter)

    def __check_init__(self):
        shapes = {np.shape(v) for v in (self.means, self.sigmas, self.weights)}
        require(
            len(shapes) == 1 and len(shape := next(iter(shapes))) == 1 and shape[0] > 0,
            f"GaussianMixture: means, sigmas and weights must be lists of one length, not of shapes {sorted(shapes)}",
        )
        require_positive(self, sigmas=self.sigmas, weights=self.weights)
        if is_concrete(self.means):
            require(bool(np.all(np.isfinite(self.means))), f"GaussianMixture: the means must be finite: {self.means}")

    def log_f(self, x: Scalar) -> Scalar:
        log_scales = jnp.log(self.weights / (self.sigmas * math.sqrt(2 * math.pi)))
        terms = []
        for k in range(self.means.shape[0]):  # one by one: over many chains, a short axis of terms does not vectorise
            z = (x - self.means[k]) / self.sigmas[k]
            terms.append(log_scales[k] - z * z / 2)
        return jnp.where((x >= 0) & (x <= 1), log_sum(terms), -jnp.inf)

    def bin_masses(self, edges: np.ndarray) -> np.ndarray:
        edges = np.clip(rising(edges, "GaussianMixture.bin_masses"), 0, 1)[:, None]
        z = (edges - np.asarray(self.means)) / np.asarray(self.sigmas)
        # Each difference is taken in the tail where both probabilities are small.
        lower = np.where(z[:-1] > 0, ndtr(-z[:-1]) - ndtr(-z[1:]), ndtr(z[1:]) - ndtr(z[:-1]))
        return lower @ np.asarray(self.weights)


def walls_and_valley(weights: ArrayLike = (0.5, 0.2, 0.3)) -> GaussianMixture:
    """Asymmetric, three modes, mass pressed against both walls: hard on clamped proposals and lost reflections."""
    return GaussianMixture([-0.02, 0.45, 1.0], [0.08, 0.05, 0.12], weights)


EXAMPLES = Examples(lambda: {"gaussian_mixture": walls_and_valley()})
