"""Small numerical functions that stay exact at the edges of the unit interval, in float32 too."""

import functools
from collections.abc import Sequence
from typing import Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from numpy.typing import ArrayLike

from mcmc1d.types import Array, Float, Index, Int, Real, Scalar

T = TypeVar("T")


# --- parameters -----------------------------------------------------------------------------------------------------


def parameter(value: ArrayLike) -> Real:
    """A module's real parameter as a float64 NumPy array; a JAX array is kept, so that it can be traced.

    NumPy keeps all 53 bits whether or not x64 is on at construction: a technique made in a float32 program can
    still be verified in float64.
    """
    if isinstance(value, jax.Array):
        return value
    try:
        return np.asarray(value, np.float64)
    except jax.errors.JAXTypeError:  # has a better name for a list of traced numbers
        raise
    except (TypeError, ValueError):
        raise ValueError(f"a parameter is a number, or an array of them, not {value!r}") from None


def number(value: ArrayLike) -> Scalar:
    """A parameter that is one number."""
    found = parameter(value)
    if np.ndim(found) != 0:
        raise ValueError(f"a parameter is one number here, not {value!r}")
    return found


def is_concrete(*values: Any) -> bool:
    """Whether none of the values is traced, so that its numbers can be looked at."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def cast(tree: T, dtype: Any) -> T:
    """The same pytree with every floating array leaf in `dtype` (Python floats adapt by themselves)."""

    def convert(leaf):
        if isinstance(leaf, np.ndarray | jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating):
            return leaf.astype(dtype)
        return leaf

    return jax.tree.map(convert, tree)


# --- the unit interval ----------------------------------------------------------------------------------------------


@jax.custom_jvp
def limit(x: Float[Array, "..."], lower: Any, upper: Any) -> Float[Array, "..."]:
    """`x` limited to [lower, upper], with the derivative of x: a guard against rounding, which is not mathematics."""
    return jnp.where(x < lower, lower, jnp.where(x > upper, upper, x))


@limit.defjvp
def _limit_jvp(primals: tuple[Any, Any, Any], tangents: tuple[Any, Any, Any]) -> tuple[Any, Any]:
    return limit(*primals), tangents[0]


def below_one(u: Float[Array, "..."]) -> Float[Array, "..."]:
    """`u` limited to [0, 1): where rounding has reached 1 it becomes the largest float under 1."""
    return limit(u, 0, 1 - jnp.finfo(u.dtype).epsneg.astype(u.dtype))


def wrap(u: Float[Array, "..."]) -> Float[Array, "..."]:
    """`u` modulo 1, in [0, 1).

    The floor of a tiny negative number is -1 and the sum rounds to 1; there the result is 0, which is as near.
    """
    wrapped = u - jnp.floor(u)
    return jnp.where(wrapped >= 1, 0, wrapped)


def in_unit_cube(u: Float[Array, "..."]) -> Array:
    """Whether every coordinate lies in [0, 1); NaN does not."""
    if u.ndim != 1 or not 0 < u.shape[0] <= _FEW:
        return jnp.all((u >= 0) & (u < 1))
    # A few are joined one by one: over many chains a reduction of so short an axis does not vectorise, and what it
    # reads must be laid out in memory first.
    return functools.reduce(jnp.logical_and, [(u[k] >= 0) & (u[k] < 1) for k in range(u.shape[0])])


# --- choosing an interval and the place inside it -------------------------------------------------------------------

Ends: TypeAlias = Sequence[Scalar] | Float[Real, " n+1"]
"""The rising ends of n intervals: a table, or a few traced scalars."""

# Up to so many intervals are told apart by comparing with every end, in code that fuses and vectorises over chains; a
# larger table is searched and gathered from.
_FEW = 16


def pick(options: Sequence[T], index: Index) -> T:
    """`options[index]` for a traced index, as a chain of selections: pytrees of one structure, few of them.

    Under `vmap` a switch evaluates every branch anyway, and selecting scalars fuses where a gather does not.
    """
    chosen = options[0]
    for k, option in enumerate(options[1:], start=1):
        chosen = select(index == k, option, chosen)
    return chosen


def select(condition: Any, a: T, b: T) -> T:
    """`a` where the condition, of one event, holds, and `b` elsewhere: two pytrees of one structure.

    Short vectors go coordinate by coordinate: over many chains a vector that was joined from parts is joined in memory,
    or by a branch for each element; coordinates that are put together and taken apart again cost nothing.
    """

    def one(x: Any, y: Any) -> Array:
        if jnp.ndim(x) != 1 or jnp.ndim(condition) != 0 or not 0 < jnp.shape(x)[0] <= _FEW:
            return jnp.where(condition, x, y)
        return jnp.stack([jnp.where(condition, x[k], y[k]) for k in range(jnp.shape(x)[0])])

    return jax.tree.map(one, a, b)


def entry(table: Sequence[Scalar] | Float[Real, " n"], index: Index) -> Scalar:
    """`table[index]` for a traced index: by selection from a few numbers, by a gather from many."""
    if len(table) > _FEW + 1:
        return jnp.asarray(table)[index]
    return pick([table[k] for k in range(len(table))], index)


def locate(ends: Ends, value: Scalar) -> Index:
    """The interval [ends[k], ends[k+1]) that holds `value`; never one of zero width, never outside 0..n-1."""
    n = len(ends) - 1
    if n > _FEW:
        method = "compare_all" if n <= 64 else "scan"
        return jnp.searchsorted(jnp.asarray(ends)[1:n], value, side="right", method=method)
    k = jnp.zeros(jnp.shape(value), jnp.int32)
    for end in [ends[j] for j in range(1, n)]:
        k = k + (value >= end)
    return k


def stratum(number: Float[Array, "..."], n: int | Index) -> Int[Array, "..."]:
    """Which of n equal intervals of [0, 1) holds each number; what lies beyond an end is held by the last there."""
    return jnp.clip((number * jnp.asarray(n, number.dtype)).astype(jnp.int32), 0, n - 1)


def choose(ends: Ends, value: Scalar) -> tuple[Index, Scalar]:
    """The interval of a partition of [0, 1) that holds `value`, and the place in [0, 1) inside it.

    Choosing with probabilities p is `choose(cumulative(p), value)`: a discrete choice made by an interval keeps,
    as the place, all that it does not use of its uniform number, and so it can be undone (`unchoose`).
    """
    n = len(ends) - 1
    if n > _FEW:
        k = locate(ends, value)
        lower, upper = entry(ends[:-1], k), entry(ends[1:], k)
    else:
        # The comparisons that count the interval choose its ends as well.
        k, lower, upper = jnp.zeros(jnp.shape(value), jnp.int32), ends[0], ends[1]
        for j in range(1, n):
            beyond = value >= ends[j]
            k, lower, upper = k + beyond, jnp.where(beyond, ends[j], lower), jnp.where(beyond, ends[j + 1], upper)
    return k, below_one((value - lower) / (upper - lower))


def unchoose(ends: Ends, k: Index, place: Scalar) -> Scalar:
    """The inverse of `choose`: the number that lies at `place` inside interval `k`."""
    return below_one(between(ends, k, place))


def between(ends: Ends, k: Index, place: Scalar) -> Scalar:
    """The point at `place` inside interval `k` of any rising ends, not only of those of [0, 1)."""
    lower = entry(ends[:-1], k)
    return lower + place * (entry(ends[1:], k) - lower)


def cumulative(shares: Sequence[Scalar]) -> list[Scalar]:
    """The ends 0, p_0, p_0 + p_1, ..., 1 of the intervals of lengths in proportion to the given shares."""
    total = [jnp.zeros_like(shares[0])]
    for share in shares:
        total.append(total[-1] + share)
    return [end / total[-1] for end in total[:-1]] + [jnp.ones_like(total[-1])]


def ends_of(shares: Float[Array, " n"]) -> Float[Array, " n+1"]:
    """The same of an array of shares: what the last of them leaves to rounding is no interval of its own."""
    sums = jnp.cumsum(shares)
    return jnp.concatenate([jnp.zeros(1, sums.dtype), sums[:-1] / sums[-1], jnp.ones(1, sums.dtype)])


def width(ends: Ends, k: Index) -> Scalar:
    """The length of interval `k`."""
    return entry(ends[1:], k) - entry(ends[:-1], k)


# --- one cell of a piecewise linear density -------------------------------------------------------------------------


def linear_quantile(left: Scalar, right: Scalar, place: Scalar) -> Scalar:
    """The quantile t in [0, 1) of the density on [0, 1] proportional to left (1 - t) + right t.

    The root is written so that nothing cancels, whichever end is zero.
    """
    root = jnp.sqrt(left * left * (1 - place) + right * right * place)
    denominator = left + root
    t = place * (left + right) / jnp.where(denominator > 0, denominator, 1)
    # Where the density is zero at 0 the last places under 1 round to 1.
    return below_one(jnp.where(denominator > 0, t, 0))


def linear_cdf(left: Scalar, right: Scalar, t: Scalar) -> Scalar:
    """The inverse of `linear_quantile`."""
    return t * (left * (2 - t) + right * t) / (left + right)
