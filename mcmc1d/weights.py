"""Multiple importance sampling weights: partitions of unity over the techniques (Veach and Guibas 1995)."""

import abc
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.numerics import log_sum, parameter, require, require_positive
from mcmc1d.types import Array, Float, Scalar


class Weights(eqx.Module):
    """w_i(x), one for each technique: they sum to one, and each is zero where its technique's density is.

    Without the second condition mass is lost: a technique that never makes x can not stand in for its share of f(x).
    """

    @property
    def breaks(self) -> tuple[float, ...]:
        """Where in x the weights jump or bend beyond what the densities do; quadrature is split there."""
        return ()

    @abc.abstractmethod
    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        """Log w_i(x) for each technique, given the log-densities log p_i(x) of all."""


class Balance(Weights):
    """The balance heuristic, w_i = p_i / sum_j p_j."""

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        total = log_sum(log_p)
        return [p - total for p in log_p]


class Power(Weights):
    """The power heuristic, w_i = p_i^beta / sum_j p_j^beta."""

    beta: Scalar = eqx.field(converter=parameter, default=2.0)

    def __check_init__(self):
        require_positive(self, beta=self.beta)

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        powers = [self.beta * p for p in log_p]
        total = log_sum(powers)
        return [p - total for p in powers]


class Maximum(Weights):
    """The maximum heuristic: all of x goes to the technique with the largest density there, the first of equals."""

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        best = jnp.argmax(jnp.stack(log_p))
        return [jnp.where(best == i, jnp.zeros_like(p), -jnp.inf) for i, p in enumerate(log_p)]


class FromFunction(Weights):
    """Any weights: a JAX function of x and of the densities p (shape (n,)) that returns w, of shape (n,)."""

    function: Callable[[Float[Array, "..."], Float[Array, " n"]], Float[Array, " n"]]
    kinks: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, function: Callable[[Array, Array], Array], breaks: Sequence[float] = ()):
        """`function`: (x, p) -> w; `breaks`: the points x where the weights jump or bend, if they do."""
        self.function, self.kinks = function, tuple(map(float, breaks))

    @property
    def breaks(self) -> tuple[float, ...]:
        return self.kinks

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        w = jnp.asarray(self.function(x, jnp.exp(jnp.stack(log_p))))
        require(
            w.shape == (len(log_p),),
            f"the weights' function must return one weight for each technique, shape ({len(log_p)},), not {w.shape}",
        )
        return [jnp.log(w[i]) for i in range(len(log_p))]


EXAMPLES = {
    "balance": Balance(),
    "power": Power(),
    "maximum": Maximum(),
    "cutoff": FromFunction(lambda x, p: jnp.where(p < 0.2 * p.max(), 0, p) / jnp.where(p < 0.2 * p.max(), 0, p).sum()),
}
