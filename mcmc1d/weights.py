"""Multiple importance sampling weights: partitions of unity over the techniques (Veach and Guibas 1995)."""

import abc
import functools
import operator
from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require, require_instance, require_positive
from mcmc1d.examples import Examples
from mcmc1d.numerics import parameter, pick
from mcmc1d.special import log_sum
from mcmc1d.targets import Target
from mcmc1d.techniques import Technique
from mcmc1d.types import Array, Float, Index, Scalar


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

    def log_ratio(
        self, x: Float[Array, "..."], log_p: Sequence[Scalar], index: Index, p: Sequence[Scalar] | None = None
    ) -> Scalar:
        """Log w_i(x) / p_i(x) of technique i = `index`, -inf where p_i(x) is zero; `p`: the densities, if at hand.

        NaN where a density or a weight is.
        """
        own = pick(log_p, index)
        ratio = pick(self.log_weights(x, log_p), index) - own
        # A sample where its own technique's density is zero to the last bit stands for nothing, whatever its weight;
        # and so does one at a pole, where quotients of infinities have no value.
        return jnp.where(jnp.isinf(own), -jnp.inf, ratio)


class Balance(Weights):
    """The balance heuristic, w_i = p_i / sum_j p_j."""

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        total = log_sum(log_p)
        return [p - total for p in log_p]

    def log_ratio(
        self, x: Float[Array, "..."], log_p: Sequence[Scalar], index: Index, p: Sequence[Scalar] | None = None
    ) -> Scalar:
        """-log sum_j p_j; NaN where a density is."""
        if len(log_p) == 1:
            total, possible = log_p[0], log_p[0] > -jnp.inf
        elif p is None:
            total, possible = log_sum(log_p), pick(log_p, index) > -jnp.inf
        else:
            total, possible = jnp.log(functools.reduce(operator.add, p)), pick(p, index) > 0
        return jnp.where(possible | jnp.isnan(total), -total, -jnp.inf)


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
        # One by one: over many chains an argmax of so short an axis does not vectorise, and nothing fuses across it.
        best, largest = jnp.zeros((), jnp.int32), log_p[0]
        for i, p in enumerate(log_p[1:], 1):
            best, largest = jnp.where(p > largest, i, best), jnp.maximum(p, largest)
        # A comparison does not see a NaN: whichever density it is of, it is no technique's to stand for x.
        return [
            jnp.where(jnp.isnan(largest), jnp.nan, jnp.where(best == i, 0, -jnp.inf)).astype(p.dtype)
            for i, p in enumerate(log_p)
        ]


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


class Parts(Weights):
    """w_i = f_i / sum_j f_j: technique i samples a target f_i of its own, and all together their sum.

    So the rungs of a temperature ladder and the lengths of a path are indices like those of techniques, for a
    `Multiplexed` of `targets.Sum` of the same parts; see `tempering`.
    """

    targets: tuple[Target, ...]

    def __init__(self, targets: Sequence[Target]):
        """`targets`: f_i, one for each technique."""
        self.targets = tuple(targets)
        for target in self.targets:
            require_instance(target, Target, "Parts: a target")

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted(set().union(*(target.breaks for target in self.targets))))

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        require(
            len(log_p) == len(self.targets),
            f"Parts: there must be one target for each technique, {len(log_p)}, not {len(self.targets)}",
        )
        parts = [target.log_f(x) for target in self.targets]
        total = log_sum(parts)
        return [jnp.where(jnp.isneginf(part), -jnp.inf, part - total) for part in parts]


class PathSpace(Weights):
    """The weights of other techniques than those of the state: serial tempering in path space, without their maps.

    In a `Multiplexed` of `techniques.Uniform` alone, once for each, u is x, and a change of technique keeps x: the
    direct application to paths of Hachisuka et al. 2014, eq. 15, where the densities p_i enter by the weights only.
    """

    weights: Weights
    techniques: tuple[Technique, ...]

    def __init__(self, weights: Weights, techniques: Sequence[Technique]):
        """`weights`: such as `Balance()`; `techniques`: those whose densities they are made of."""
        self.weights, self.techniques = weights, tuple(techniques)
        require_instance(weights, Weights, "PathSpace: the weights")
        for technique in self.techniques:
            require_instance(technique, Technique, "PathSpace: a technique")

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted(set(self.weights.breaks).union(*(t.breaks for t in self.techniques))))

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> Sequence[Scalar]:
        require(
            len(log_p) == len(self.techniques),
            f"PathSpace: there must be as many Uniform() as techniques, {len(self.techniques)}, not {len(log_p)}",
        )
        return self.weights.log_weights(x, [technique.log_prob(x) for technique in self.techniques])


def _examples() -> dict[str, Weights]:
    from mcmc1d.targets import Sinusoid
    from mcmc1d.targets.tempered import Tempered
    from mcmc1d.techniques import Ramp, Tent

    return {
        "parts": Parts((Sinusoid(), Tempered(Sinusoid(), 0.3))),
        "path_space": PathSpace(Balance(), (Tent(), Ramp())),
    }


EXAMPLES = Examples(
    lambda: {
        "balance": Balance(),
        "power": Power(),
        "maximum": Maximum(),
        "cutoff": FromFunction(
            lambda x, p: jnp.where(p < 0.2 * p.max(), 0, p) / jnp.where(p < 0.2 * p.max(), 0, p).sum()
        ),
        **_examples(),
    }
)
