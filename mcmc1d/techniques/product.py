"""Techniques side by side: independent samples, each from numbers of its own."""

import itertools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.examples import Examples
from mcmc1d.techniques.base import Forward, Inverse, Technique, checked_shape, dim_v, sample_shape
from mcmc1d.techniques.elementary import Uniform
from mcmc1d.types import Array, Corners, Float, Scalar


class Product(Technique):
    """x = (x_1, ..., x_n), each x_t made by a technique of its own from its own part of u; p(x) = prod_t p_t(x_t).

    Scalar samples and arrays of shape (d,) are joined into one array; so are the v, in the same order.
    """

    techniques: tuple[Technique, ...]

    def __init__(self, techniques: Sequence[Technique]):
        """`techniques`: in the order of the coordinates, one at least."""
        self.techniques = tuple(techniques)
        require(len(self.techniques) > 0, "Product: give one technique at least")
        for technique in self.techniques:
            shape = checked_shape(require_instance(technique, Technique, "Product: a technique"))
            require(
                len(shape) <= 1,
                f"Product: a sample is a scalar or of shape (d,); {type(technique).__name__}'s is of shape {shape}",
            )

    @property
    def dim_u(self) -> int:
        """As many numbers as all of them read."""
        return sum(technique.dim_u for technique in self.techniques)

    @property
    def support(self) -> Corners:
        lowers, uppers = zip(*(technique.support for technique in self.techniques), strict=True)
        return _corner(lowers), _corner(uppers)

    def forward(self, u: Float[Array, " m"]) -> Forward:
        parts = [t.forward(own) for t, own in zip(self.techniques, _cut(u, self._reads()), strict=True)]
        x, v, log_det = zip(*parts, strict=True)
        return jnp.concatenate([jnp.atleast_1d(one) for one in x]), jnp.concatenate(v), _total(log_det)

    def inverse(self, x: Float[Array, " d"], v: Float[Array, " k"]) -> Inverse:
        forgotten = _cut(v, [dim_v(technique) for technique in self.techniques])
        parts = [
            t.inverse(own, rest) for t, own, rest in zip(self.techniques, self._samples(x), forgotten, strict=True)
        ]
        u, log_det = zip(*parts, strict=True)
        return jnp.concatenate(u), _total(log_det)

    def log_prob(self, x: Float[Array, " d"]) -> Scalar:
        return _total([t.log_prob(own) for t, own in zip(self.techniques, self._samples(x), strict=True)])

    def _reads(self) -> list[int]:
        return [technique.dim_u for technique in self.techniques]

    def _samples(self, x: Float[Array, " d"]) -> list[Array]:
        """Each technique's own sample, in its own shape."""
        shapes = [sample_shape(technique) for technique in self.techniques]
        return [own.reshape(shape) for own, shape in zip(_cut(x, [sum(s) or 1 for s in shapes]), shapes, strict=True)]


def cube(m: int) -> Technique:
    """The technique x = u in m dimensions: a scalar for m = 1, else an array of shape (m,)."""
    require_whole(m, "cube: m")
    return Uniform() if m == 1 else Product((Uniform(),) * m)


def _corner(ends: Sequence[ArrayLike]) -> np.ndarray:
    """The parts of a corner, each a number or a point, end to end."""
    return np.concatenate([np.atleast_1d(np.asarray(end)) for end in ends])


def _cut(numbers: Float[Array, " n"], sizes: Sequence[int]) -> list[Array]:
    ends = np.cumsum([0, *sizes])
    return [numbers[a:b] for a, b in itertools.pairwise(ends)]


def _total(terms: Sequence[Scalar]) -> Scalar:
    """The sum of log-determinants or log-densities; -inf where any is (and none is +inf there)."""
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def _examples() -> dict[str, Technique]:
    from mcmc1d.techniques.elementary import Ramp
    from mcmc1d.techniques.mixture import EXAMPLES as MIXTURES
    from mcmc1d.techniques.truncated_normal import TruncatedNormal

    return {
        "product": Product((Ramp(1.2), TruncatedNormal(0.3, 0.2))),
        "product_with_mixture": Product((MIXTURES["mixture"], Ramp(-0.7))),
    }


EXAMPLES = Examples(_examples)
