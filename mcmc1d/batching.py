"""Work that few of a batch ask for, done for those few."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.numerics import select
from mcmc1d.types import Array, Bool

T = TypeVar("T")

_SHARE = 16
"""A group that is computed at once is so many times smaller than the batch."""


def only_where(needed: Bool[Array, ""], function: Callable[..., T], *args: Any) -> T:
    """`function(*args)` where `needed`, zeros elsewhere; under `vmap` it is computed for those that need it alone.

    They are gathered, a fixed number at once until all are done, and what they make is scattered: worth it where they
    are few and the function costs far more than it reads and returns. The numbers are those that all would get, and
    so are the derivatives (forward mode).
    """
    arrays, static = eqx.partition(args, eqx.is_array)
    floats, others = eqx.partition(arrays, eqx.is_inexact_array)

    def made(floats: Any, others: Any) -> T:
        return function(*eqx.combine(floats, others, static))

    @jax.custom_jvp
    def one(needed: Array, floats: Any, others: Any) -> T:
        return _only_where(needed, made, floats, others)

    @one.defjvp
    def derivative(primals: Any, tangents: Any) -> tuple[T, Any]:
        needed, floats, others = primals

        def slope(floats: Any, turned: Any, others: Any) -> Any:
            turns = jax.jvp(lambda floats: made(floats, others), (floats,), (turned,))[1]
            return eqx.filter(turns, eqx.is_inexact_array)

        # Apart from its derivatives: a value belongs to all of their directions, and may not become one to each.
        value = one(needed, floats, others)
        none = jax.tree.map(lambda a: np.zeros(a.shape, jax.dtypes.float0), value)
        return value, eqx.combine(only_where(needed, slope, floats, tangents[1], others), none)

    return one(needed, floats, others)


def _only_where(needed: Bool[Array, ""], made: Callable[..., T], *args: Any) -> T:
    """The same of a function of arrays alone, without derivatives."""
    nothing = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(made, *args))

    @jax.custom_batching.custom_vmap
    def one(needed: Array, *args: Any) -> T:
        return select(needed, made(*args), nothing)

    @one.def_vmap
    def several(size: int, batched: Any, needed: Array, *args: Any) -> tuple[T, Any]:
        axes = tuple(jax.tree.map(lambda b: 0 if b else None, of) for of in batched[1:])
        every = jax.tree.map(lambda _: True, nothing)
        if not batched[0]:  # a batch that is one with respect to who asks
            return _only_where(needed, jax.vmap(made, in_axes=axes, axis_size=size), *args), every
        at_once = -(-size // _SHARE)
        # After those that ask come indices that are out of bounds: read as the last, written nowhere.
        places = jnp.nonzero(needed, size=size + at_once, fill_value=size)[0]
        count = jnp.sum(needed)

        def body(carry: tuple[Array, T]) -> tuple[Array, T]:
            first, results = carry
            here = jax.lax.dynamic_slice(places, (first,), (at_once,))
            read = jax.tree.map(lambda a, b: a.at[here].get(mode="clip") if b else a, args, tuple(batched[1:]))
            new = jax.vmap(made, in_axes=axes, axis_size=at_once)(*read)
            return first + at_once, jax.tree.map(lambda r, n: r.at[here].set(n, mode="drop"), results, new)

        results = jax.tree.map(lambda a: jnp.zeros((size, *a.shape), a.dtype), nothing)
        first = jnp.zeros((), places.dtype)
        return jax.lax.while_loop(lambda carry: carry[0] < count, body, (first, results))[1], every

    return one(needed, *args)


__all__ = ["only_where"]
