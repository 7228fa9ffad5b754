"""Elementary functions that vectorise, or whose slopes need care: sums of exponentials, sines, the normal quantile."""

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.special import ndtri

from mcmc1d.compiling import inlined
from mcmc1d.types import Scalar


@jax.custom_jvp
def still(log_x: Scalar) -> Scalar:
    """`log_x`, whose derivative is zero where it is -inf: what is zero around a point contributes nothing there.

    In a hole of a density the derivative of its logarithm is 0/0, and 0 times NaN is NaN.
    """
    return log_x


@still.defjvp
def _still_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return primals[0], jnp.where(jnp.isneginf(primals[0]), jnp.zeros_like(tangents[0]), tangents[0])


def log_sum(terms: Sequence[Scalar]) -> Scalar:
    """The log of the sum of the terms' exponentials, without overflow; -inf where every term is."""
    terms = [still(term) for term in terms]
    if len(terms) == 2:
        return _log_sum_of_two(*terms)
    largest = functools.reduce(jnp.maximum, terms)
    base = jnp.where(jnp.isfinite(largest), largest, 0)
    return jnp.log(functools.reduce(jnp.add, [jnp.exp(term - base) for term in terms])) + base


@jax.custom_jvp
def _log_sum_of_two(a: Scalar, b: Scalar) -> Scalar:
    """With one exponential, the other being 1."""
    gap = a - b
    # It is NaN where both are infinite alike, or one is NaN.
    return jnp.where(jnp.isnan(gap), a + b, jnp.maximum(a, b) + jnp.log(1 + jnp.exp(-jnp.abs(gap))))


@_log_sum_of_two.defjvp
def _log_sum_of_two_jvp(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Any, Any]:
    total = _log_sum_of_two(*primals)
    base = jnp.where(jnp.isneginf(total), 0, total)
    return total, sum(jnp.exp(term - base) * slope for term, slope in zip(primals, tangents, strict=True))


# sin(2 pi r) = r (1/4 - r^2) P(r^2) on |r| <= 1/2, zeros exact: a least-maximum fit by Lawson's iteration in
# Chebyshev polynomials, largest error 1.3e-9 before rounding to float32 and 2.3e-7 after.
_SIN_TURNS = (25.13274108, -64.8358225751, 67.0767586882, -38.4984187922, 14.0655040287, -3.1933717855)


def sin_turns(turns: Scalar) -> Scalar:
    """sin(2 pi turns): the argument is reduced exactly, and in float32 a polynomial is used.

    XLA's own sine does not vectorise on a CPU; this one costs a sixth of it.
    """
    turns = jnp.asarray(turns)
    r = turns - jnp.round(turns)
    if turns.dtype == jnp.float32:
        return _sin_turns_float32(r)
    # Folded to a quarter turn, where the product with the rounded 2 pi is small enough not to matter.
    folded = jnp.where(jnp.abs(r) > 0.25, jnp.copysign(0.5, r) - r, r)
    return jnp.sin(2 * jnp.pi * folded)


def cos_turns(turns: Scalar) -> Scalar:
    """cos(2 pi turns), as `sin_turns`."""
    turns = jnp.asarray(turns)
    r = jnp.abs(turns - jnp.round(turns))
    return _sin_turns_float32(0.25 - r) if turns.dtype == jnp.float32 else sin_turns(0.25 - r)


@inlined
def _sin_turns_float32(r: Scalar) -> Scalar:
    z = r * r
    return r * (jnp.float32(0.25) - z) * _horner(_SIN_TURNS, z)


def _horner(coefficients: Sequence[float], x: Scalar) -> Scalar:
    """A polynomial in float32, of coefficients from the constant term on: the fewest operations, the smallest error."""
    p = jnp.float32(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        p = p * x + jnp.float32(coefficient)
    return p


# (log(1 + m) - m + m^2 / 2) / m^3 for sqrt(1/2) <= 1 + m <= sqrt(2), fitted likewise: 6.4e-8 off in log(1 + m).
_LOG = (0.33334691, -0.2498057401, 0.1991023843, -0.1716690638, 0.161411767, -0.102242027)
_ROOT_HALF = 0x3F3504F3  # the bits of sqrt(1/2) in float32


def _log_float32(x: Scalar) -> Scalar:
    """The logarithm of a positive float32 number that is not denormal, in half of the time of XLA's.

    Off by 6.4e-8 beside the rounding of the result; 0 at 1 exactly. Bits have no derivative: whoever uses it gives one.
    """
    bits = jax.lax.bitcast_convert_type(x, jnp.int32)
    exponent = (bits - _ROOT_HALF) >> 23
    m = jax.lax.bitcast_convert_type(bits - (exponent << 23), jnp.float32) - 1
    square = m * m
    return exponent * jnp.float32(math.log(2)) + (m * square * _horner(_LOG, m) - square * jnp.float32(0.5) + m)


# Phi^-1(w) / (2 w - 1) as a function of t = -log(4 w (1 - w)), a ratio of polynomials with positive coefficients: a
# least-maximum fit by Lawson's iteration on 0 <= t <= 17.5, largest relative error 2.8e-8 before rounding to float32,
# 3e-7 after. (Giles 2010, "Approximating the erfinv function", takes t in two pieces, which costs selections.)
_NORMAL_QUANTILE = (
    (1.2533141375, 0.4373306930, 0.08530587703, 0.01113109849, 9.222671506e-4, 3.279545844e-5),
    (1.0, 0.08714076132, 0.03221569583, 1.951428596e-3, 1.754980480e-4, 1.205744411e-6),
)


@jax.custom_jvp
def normal_quantile(w: Scalar) -> Scalar:
    """The standard normal quantile of `w`; infinite at 0 and 1, NaN outside, and odd about 1/2 to the last bit.

    In float32 by a ratio of polynomials in log(4 w (1 - w)), good to 3e-7 from the smallest number that a generator
    makes on, and to 2 % at 1e-37. The division comes last: its result XLA keeps for all that read it, where it works
    out anything cheaper again for each.
    """
    w = jnp.asarray(w)
    if w.dtype != jnp.float32:
        return ndtri(w)
    return _normal_quantile_float32(w)


@inlined
def _normal_quantile_float32(w: Scalar) -> Scalar:
    area = 4 * w * (1 - w)
    t = -_log_float32(area)
    above, below = (_horner(coefficients, t) for coefficients in _NORMAL_QUANTILE)
    return (2 * w - 1) * above / jnp.where(area > 0, below, jnp.where(area < 0, jnp.nan, 0))


@normal_quantile.defjvp
def _normal_quantile_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    z = normal_quantile(*primals)
    return z, tangents[0] * (math.sqrt(2 * math.pi) * jnp.exp(z * z / 2))
