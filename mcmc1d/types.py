"""Array types shared by every floor.

A module's parameters may be NumPy arrays (as constructed: float64, whatever the x64 flag says) or JAX arrays (inside
a transformation), so a field is annotated with `Real`; what a method returns is a JAX array.
"""

from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

if TYPE_CHECKING:
    Real: TypeAlias = Any  # a type checker can not know which of the two it is
else:
    Real: TypeAlias = jax.Array | np.ndarray
"""A parameter's array type: NumPy at rest, JAX under a transformation."""

Scalar: TypeAlias = Float[Real, ""]
"""A real number."""

Index: TypeAlias = Int[Real, ""] | int
"""The index of a technique, of a move or of a bin."""

Corners: TypeAlias = tuple[Any, Any]
"""The lower and upper corner of an interval or box: two numbers, or two arrays of shape (d,)."""

Key: TypeAlias = jax.Array
"""A JAX random key, as `jax.random.key(seed)` makes it."""

__all__ = ["Array", "Bool", "Corners", "Float", "Index", "Int", "Key", "Real", "Scalar", "UInt32"]
