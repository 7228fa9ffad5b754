"""What a sampling technique is: a bijection between primary samples and (the sample, what the sample forgets)."""

import abc
import functools
import math
from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, traced
from mcmc1d.numerics import below_one, limit
from mcmc1d.types import Array, Corners, Float, Scalar

Forward: TypeAlias = tuple[Float[Array, "..."], Float[Array, " k"], Scalar]
Inverse: TypeAlias = tuple[Float[Array, " m"], Scalar]


class Technique(eqx.Module):
    """A bijection u <-> (x, v) that makes a sample x out of uniform numbers u and keeps the rest as v.

    `u` in [0, 1)^m is the primary sample, `x` the sample (a scalar, or an array of shape (d,)), `v` in [0, 1)^k all
    of `u` that `x` forgets, k = m - d: an unused dimension, the place inside an ambiguous interval, which lobe of a
    mixture was used. With `v` kept nothing is lost; the "probabilistic inverse" of Bitterli et al. 2017, section 5,
    is this inverse at a fresh uniform `v`.

    Everything is written for one sample; callers `vmap`. A subclass is final: it defines `dim_u` (m, a plain class
    attribute or a property), `forward`, `inverse` and `log_prob`, and is held to them by `verify.check_technique`.
    """

    @property
    @abc.abstractmethod
    def dim_u(self) -> int:
        """m, how many uniform numbers the technique reads."""

    @property
    def support(self) -> Corners:
        """The lower and upper corner of an interval or box that holds every x; the unit interval unless redefined."""
        return 0.0, 1.0

    @property
    def breaks(self) -> tuple[float, ...]:
        """Where in x the density of a 1D technique jumps or bends; quadrature is split there."""
        return ()

    @abc.abstractmethod
    def forward(self, u: Float[Array, " m"]) -> Forward:
        """(x, v, log|d(x, v)/du|) at `u`: the technique's own log-determinant, also where it is not -log p(x)."""

    @abc.abstractmethod
    def inverse(self, x: Float[Array, "..."], v: Float[Array, " k"]) -> Inverse:
        """(u, log|du/d(x, v)|), the inverse of `forward`; outside the support the log-determinant is -inf."""

    @abc.abstractmethod
    def log_prob(self, x: Float[Array, "..."]) -> Scalar:
        """The log-density of x with respect to Lebesgue measure dx, v integrated out; -inf outside the support."""

    def prob(self, x: Float[Array, "..."]) -> Scalar | None:
        """The density itself, 0 outside the support; None unless redefined, and all is done with `log_prob`.

        To be redefined where it can not underflow, and agree with `log_prob`: sums of densities, as those of the
        balance heuristic, then need neither logarithms nor exponentials, which are most of an evaluation's cost.
        """
        return None


class Inversion(Technique):
    """A 1D technique by the inversion method: x = P^-1(u), for the cumulative distribution function P.

    A subclass defines `quantile`, `cdf` and `log_prob`; then |dx/du| = 1/p(x) and nothing is forgotten (Bitterli et
    al. 2017, section 6).
    """

    @property
    def dim_u(self) -> int:
        return 1

    @abc.abstractmethod
    def quantile(self, u: Scalar) -> Scalar:
        """The x below which lies a share u of the density."""

    @abc.abstractmethod
    def cdf(self, x: Scalar) -> Scalar:
        """The share of the density below x."""

    def forward(self, u: Float[Array, " 1"]) -> Forward:
        """(P^-1(u), nothing, -log p)."""
        x = _snap(self.quantile(u[0]), *self.support)
        return x, u[1:], -self.log_prob(x)

    def inverse(self, x: Scalar, v: Float[Array, " 0"]) -> Inverse:
        """(P(x), log p)."""
        x = jnp.asarray(x)
        return below_one(self.cdf(x))[None], self.log_prob(x)


def _snap(x: Scalar, lower: Any, upper: Any) -> Scalar:
    """`x`, or the end of the support where it lies a few roundings beyond: a cube root of 1 - 1e-16 may be over 1."""
    x = jnp.asarray(x)
    few = 8 * jnp.finfo(x.dtype).eps.astype(x.dtype)
    below, above = lower - few * jnp.maximum(1, jnp.abs(lower)), upper + few * jnp.maximum(1, jnp.abs(upper))
    return limit(x, jnp.where(x < below, x, lower), jnp.where(x > above, x, upper))


_MOST_SHAPES = 256  # that are kept: with each goes what the technique holds beside its arrays


def _once(function: Callable[[Technique, Any], Any]) -> Callable[[Technique, Any], Any]:
    """The function of a technique's structure and a dtype, traced once for all that are alike but for their numbers.

    A technique in a mixture in a product would else be traced by each of them, in every method that asks for a shape.
    What can not be compared is traced anew.
    """
    known: dict[Any, Any] = {}

    @functools.wraps(function)
    def shapes(technique: Technique, dtype: Any) -> Any:
        leaves, tree = jax.tree.flatten(technique)
        alike = tuple((leaf.shape, leaf.dtype) if _is_traced(leaf) else leaf for leaf in leaves)
        key = tree, alike, technique.dim_u, dtype, jax.dtypes.canonicalize_dtype(float)
        try:
            found = known.get(key)
        except (TypeError, ValueError):
            return function(technique, dtype)
        if found is None:
            found = function(technique, dtype)
            if len(known) >= _MOST_SHAPES:
                known.pop(next(iter(known)), None)
            known[key] = found
        return found

    return shapes


def _is_traced(leaf: Any) -> bool:
    """Whether `filter_eval_shape` looks at its shape alone."""
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


@_once
def _shapes(technique: Technique, dtype: Any) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Those of x and v."""
    x, v, _ = eqx.filter_eval_shape(technique.forward, _floats(technique.dim_u, dtype=dtype))
    return np.shape(x), np.shape(v)


def sample_shape(technique: Technique) -> tuple[int, ...]:
    """The shape of the technique's x: () for a scalar."""
    return _shapes(technique, None)[0]


def checked_shape(technique: Technique, dtype: Any = None) -> tuple[int, ...]:
    """`sample_shape`; `ValueError` unless all that the technique returns has the shape that it should have.

    Nothing is computed; `dtype` is that of u and x, JAX's default unless given. Without this a (1,) in place of a ()
    would broadcast, and be wrong silently.
    """
    return _checked(technique, dtype)


@_once
def _checked(technique: Technique, dtype: Any) -> tuple[int, ...]:
    m = technique.dim_u
    x, v = _returned(technique, "forward", (_floats(m, dtype=dtype),), x=None, v=None, log_det=())[:2]
    d = math.prod(np.shape(x))
    who = f"{type(technique).__name__}.forward"
    require(
        np.shape(v) == (m - d,),
        f"{who}: u has {m} numbers and x {d}; what x forgets of u must be returned as v, of shape ({m - d},), not "
        f"{np.shape(v)}",
    )
    x, v = (_floats(*np.shape(part), dtype=dtype) for part in (x, v))
    _returned(technique, "inverse", (x, v), u=(m,), log_det=())
    _returned(technique, "log_prob", (x,), log_density=())
    if type(technique).prob is not Technique.prob and eqx.filter_eval_shape(technique.prob, x) is not None:
        _returned(technique, "prob", (x,), density=())
    return x.shape


def _floats(*shape: int, dtype: Any = None) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, jnp.zeros(()).dtype if dtype is None else dtype)


def _returned(technique: Technique, method: str, given: tuple[Any, ...], **promised: tuple[int, ...] | None) -> Any:
    """The shapes of what a method returns, or `ValueError` unless it is what was promised; None may have any shape."""
    who = f"{type(technique).__name__}.{method}"
    with traced(who):
        found = eqx.filter_eval_shape(getattr(technique, method), *given)
    parts = found if isinstance(found, tuple) else (found,)
    arrays = [isinstance(part, jax.ShapeDtypeStruct | float | int | np.ndarray) for part in parts]
    kinds = ["an array" if array else type(part).__name__ for array, part in zip(arrays, parts, strict=True)]
    require(
        len(parts) == len(promised) and all(arrays),
        f"{who} must return {', '.join(promised)}, each an array; it returned {', '.join(kinds)}",
    )
    for (name, shape), part in zip(promised.items(), parts, strict=True):
        require(
            shape is None or np.shape(part) == shape,
            f"{who}: {name} must have the shape {shape}, not {np.shape(part)}",
        )
    return parts


def dim_v(technique: Technique) -> int:
    """k, how many uniform numbers the technique's sample forgets."""
    return _shapes(technique, None)[1][0]


def within(x: Scalar, log_prob: Scalar, lower: Any = 0.0, upper: Any = 1.0) -> Scalar:
    """`log_prob` for x in [lower, upper], -inf outside."""
    return jnp.where((x >= lower) & (x <= upper), log_prob, -jnp.inf)


def density_within(x: Scalar, prob: Scalar, lower: Any = 0.0, upper: Any = 1.0) -> Scalar:
    """`prob` for x in [lower, upper], 0 outside."""
    return jnp.where((x >= lower) & (x <= upper), prob, 0)
