"""How many operations a program is made of, and how many a core can do: the roof under which a loop runs."""

import math
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, jaxprs_in_params

from mcmc1d.compiling import wide_jit
from mcmc1d.types import Array

_MOVED = {
    *("broadcast_in_dim", "concatenate", "copy", "dynamic_slice", "dynamic_update_slice", "gather", "iota", "pad"),
    *("reshape", "rev", "scatter", "slice", "split", "squeeze", "stop_gradient", "transpose"),
    *("convert_element_type", "bitcast_convert_type"),
}
"""What only moves numbers or renames them."""

_FUNCTIONS = {
    *("atan", "atan2", "cos", "cbrt", "erf", "erf_inv", "erfc", "exp", "exp2", "expm1", "log", "log1p", "logistic"),
    *("pow", "sin", "tan", "tanh"),
}

_OF_A_FUNCTION = 16
"""Operations of an elementary function, about: a polynomial of degree 5 to 8, and what reduces its argument."""


def operations(function: Callable, *args: Any) -> float:
    """Arithmetic, comparisons and selections of one call, each number of an array for itself.

    An elementary function counts as 16, what only moves numbers as none; a loop whose length is not known as one turn.
    """
    return _count(eqx.filter_make_jaxpr(function)(*args)[0].jaxpr)


def _count(program: Jaxpr) -> float:
    total = 0.0
    for equation in program.eqns:
        name, inner = equation.primitive.name, [_count(part) for part in jaxprs_in_params(equation.params)]
        shapes = [getattr(number.aval, "shape", ()) for number in (*equation.invars, *equation.outvars)]
        if name == "scan":
            total += equation.params["length"] * sum(inner)
        elif name == "cond":
            total += max(inner)
        elif name == "scatter-add":  # as many additions as there are numbers to add
            total += math.prod(shapes[-2])
        elif inner:
            total += sum(inner)
        elif name not in _MOVED:
            total += max(map(math.prod, shapes), default=0) * (_OF_A_FUNCTION if name in _FUNCTIONS else 1)
    return total


def roof(rounds: int = 5) -> float:
    """Operations per second of processor time: multiply-adds on one core, of float32 that stay in its first cache."""
    x = jnp.linspace(0.1, 0.9, 2048, dtype=jnp.float32)
    spent = []
    for _ in range(rounds + 1):  # the first compiles
        begin = time.process_time()
        jax.block_until_ready(_multiply_adds(x))
        spent.append(time.process_time() - begin)
    return _TURNS * operations(_turn, x) / median(spent[1:])


_TURNS = 2**14


def _turn(x: Array) -> Array:
    """Chains of multiply-adds beside each other: one alone would wait for each of its results."""
    chains = [x * jnp.float32(1 - 0.01 * k) for k in range(1, 9)]
    for k in range(1, 9):
        chains = [chain * jnp.float32(0.9) + jnp.float32(0.01 * k) for chain in chains]
    return sum(chains[1:], chains[0]) * jnp.float32(1 / 8)


@wide_jit
def _multiply_adds(x: Array) -> Array:
    return jax.lax.fori_loop(0, _TURNS, lambda _, x: _turn(x), x)


__all__ = ["operations", "roof"]
