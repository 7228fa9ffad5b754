"""Checks of what a user gives, which say what is wrong with it: numbers, instances, boxes, tables of densities."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.numerics import is_concrete
from mcmc1d.types import Float, Real

T = TypeVar("T")


def require(condition: bool | np.bool_ | jax.Array, message: str) -> None:
    """Raise `ValueError(message)` unless the condition holds."""
    if not condition:
        raise ValueError(message)


def require_positive(owner: object, **values: Any) -> None:
    """Raise `ValueError` unless each named parameter is positive and finite (traced ones are let through)."""
    for name, value in values.items():
        if is_concrete(value):
            array = np.asarray(value)
            require(
                bool(np.all(np.isfinite(array) & (array > 0))),
                f"{type(owner).__name__}: {name} must be positive and finite, not {value}",
            )


_LONGEST = 100.0


def require_step(owner: object, **values: Any) -> None:
    """Raise `ValueError` unless each named size of a step around the unit interval is positive and at most 100.

    Of what is added float32 keeps so many digits after the point that the step is symmetric; around the ends one of 1
    leads everywhere already.
    """
    require_positive(owner, **values)
    for name, value in values.items():
        require(
            not is_concrete(value) or bool(np.all(np.asarray(value) <= _LONGEST)),
            f"{type(owner).__name__}: {name} is a share of the unit interval, {_LONGEST:g} at most, not {value}",
        )


def require_instance(value: Any, kind: type[T], who: str, fix: str = "") -> T:
    """`value`, or `ValueError` unless it is an instance of `kind`: a class in its place is a common slip."""
    if isinstance(value, type):
        raise ValueError(f"{who}: give an instance, {value.__name__}(...), not the class {value.__name__}")
    require(isinstance(value, kind), f"{who} must be {_a(kind)}, not {_a(type(value))}{fix}")
    return value


def _a(kind: type) -> str:
    return f"{'an' if kind.__name__[0] in 'AEIOUaeiou' else 'a'} {kind.__name__}"


def require_whole(value: Any, who: str, least: int = 1) -> int:
    """`value` as Python's, or `ValueError` unless it is a whole number, `least` at least; True is none."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    require(whole and bool(value >= least), f"{who} must be a whole number, {least} at least, not {value!r}")
    return int(value)


def several(values: Any, who: str) -> tuple[Any, ...]:
    """The values as a tuple, or `ValueError` for one alone."""
    try:
        each = iter(values)
    except TypeError:
        raise ValueError(f"{who} are several: give a list of them, [...], not {values!r}") from None
    return tuple(each)


def require_dtype(dtype: Any, who: str) -> Any:
    """The floats to work in, JAX's default for None; `ValueError` unless it is float32, or float64 with x64 on."""
    default = jnp.zeros(()).dtype
    dtype = default if dtype is None else jnp.dtype(dtype)
    require(
        dtype in (jnp.float32, default),
        f"{who}: dtype must be float32, or float64 with JAX's x64 on, not {dtype}",
    )
    return dtype


def require_key(key: Any, who: str) -> None:
    """Raise `ValueError` unless `key` is a random key of JAX: a seed in its place is a common slip."""
    dtype = getattr(key, "dtype", None)
    typed = dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key)
    one = np.shape(key) == () if typed else dtype == np.uint32 and np.shape(key) == (2,)
    seed = key if isinstance(key, int | np.integer) else 0
    require(one, f"{who}: the key must be one of JAX, such as jax.random.key({seed})")


def require_mass(mass: Any, who: str, name: str) -> float:
    """`mass`, of a whole density, or `ValueError` where the density's scale is beyond what floats hold."""
    mend = {0.0: "add a constant to log f", np.inf: "subtract a constant from log f"}.get(float(mass))
    require(mend is not None or mass > 0, f"{who}: the mass of {name} is {mass}")
    require(mend is None, f"{who}: the mass of {name} is {float(mass):g}: {mend}, no law depends on it")
    return float(mass)


UNTRACEABLE = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.ConcretizationTypeError,
    jax.errors.NonConcreteBooleanIndexError,
)
"""What JAX raises where code that it traces is not JAX's."""


@contextmanager
def traced(what: str) -> Iterator[None]:
    """Where what a user wrote is traced: NumPy, or an `if`, in it is a `ValueError` that names it."""
    try:
        yield
    except UNTRACEABLE as error:
        raise ValueError(
            f"{what} can not be traced by JAX: write it with jax.numpy and jnp.where ({str(error).splitlines()[0]})"
        ) from error


def require_box(owner: eqx.Module, lower: Float[Real, "..."], upper: Float[Real, "..."]) -> None:
    """Raise `ValueError` unless the corners are those of a bounded box in the plane."""
    name = type(owner).__name__
    require(
        np.shape(lower) == np.shape(upper) == (2,),
        f"{name}: the corners must be points of the plane, not of shapes {np.shape(lower)} and {np.shape(upper)}",
    )
    if is_concrete(lower, upper):
        a, b = np.asarray(lower), np.asarray(upper)
        require(
            bool(np.all(np.isfinite(a) & np.isfinite(b) & (a < b))),
            f"{name}: the lower corner must lie under the upper one, both finite, not {a.tolist()} and {b.tolist()}",
        )


def density_table(name: str, edges: ArrayLike, values: ArrayLike, *, cells: bool) -> tuple[np.ndarray, np.ndarray]:
    """The edges and values of a tabulated density in float64, or `ValueError` unless they describe one.

    Two edges at least, which rise; a value for each, or for each of the `cells` between them, none of them negative
    or infinite, one positive at least.
    """
    require(is_concrete(edges, values), f"{name}: edges and values are tables of numbers and can not be traced")
    edges, values = rising(edges, name), np.asarray(values, np.float64)
    wanted = edges.size - 1 if cells else edges.size
    require(
        values.shape == (wanted,),
        f"{name}: {edges.size} edges need {wanted} values, not an array of shape {values.shape}",
    )
    bad = np.flatnonzero(~(np.isfinite(values) & (values >= 0)))
    require(bad.size == 0, f"{name}: a density is finite and not negative; value {bad[:1]} is {values[bad[:1]]}")
    require(bool(values.any()), f"{name}: the density is zero everywhere")
    return edges, values


def rising(edges: ArrayLike, who: str) -> np.ndarray:
    """The edges of bins in float64, or `ValueError` unless they are two at least and rise."""
    edges = np.asarray(edges, np.float64)
    require(
        edges.ndim == 1 and edges.size >= 2 and bool(np.all(np.diff(edges) > 0)),
        f"{who}: the edges must rise, two at least in one dimension, not {edges}",
    )
    return edges


def require_planar_cover(
    who: str, x_edges: np.ndarray, y_edges: np.ndarray, domain: tuple[Any, Any], name: str
) -> None:
    """Raise `ValueError` unless `domain` is a box in the plane, and the cells cover it."""
    lower, upper = (np.asarray(corner, np.float64) for corner in domain)
    require(lower.shape == (2,), f"{who}: x must be a point of the plane; {name} has x of shape {lower.shape}")
    for k, edges in enumerate((x_edges, y_edges)):
        require_cover(f"{who}, along x[{k}]", edges, (lower[k], upper[k]), name)


def require_cover(who: str, edges: np.ndarray, domain: tuple[Any, Any], name: str) -> None:
    """Raise `ValueError` unless bins cover the interval `domain` of what is called `name`."""
    first, last, (lower, upper) = float(edges[0]), float(edges[-1]), (float(end) for end in domain)
    # A domain, or an edge, that was given in float64 may round across the other in float32.
    slack = 1e-6 * (upper - lower)
    require(
        first <= lower + slack and upper - slack <= last,
        f"{who}: the bins [{first}, {last}] do not cover the domain [{lower}, {upper}] of {name}; extend the edges",
    )
