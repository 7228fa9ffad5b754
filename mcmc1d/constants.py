"""NumPy arrays that traced functions close over: in the precision of whoever traces them.

JAX 0.10.2 keeps what it made of such an array for as long as some program holds it, and hands it to programs of the
other precision too: a target that closes over an array and was probed in float64 could not be run in float32, nor a law
that was verified in float32 be given to emcee.
"""

import weakref
from contextlib import suppress
from typing import Any

import jax
import numpy as np

_made: "weakref.WeakValueDictionary[tuple[int, Any], Any]" = weakref.WeakValueDictionary()
"""The constants that some program holds, by the array's number and their dtype."""
_watched: dict[int, set[Any]] = {}
"""Of each array that is alive, by its number, the dtypes that were made of it."""


def keep_precisions_apart() -> None:
    """Have JAX make one constant of an array for each precision, where it does not."""
    with suppress(ImportError, AttributeError):  # a later JAX need not have the names
        from jax._src import dtypes, literals

        def constant(array: np.ndarray) -> Any:
            dtypes.check_valid_dtype(array.dtype)
            number, dtype = id(array), dtypes.canonicalize_dtype(array.dtype)
            made, now = _made.get((number, dtype)), np.asarray(array, dtype)
            if made is None or np.asarray(made).tobytes() != now.tobytes():  # the array has been changed since
                made = _made[number, dtype] = literals.TypedNdArray(np.array(now))
                if number not in _watched:
                    weakref.finalize(array, _forget, number).atexit = False
                _watched.setdefault(number, set()).add(dtype)
            return made

        array = np.zeros(1)
        alive = dtypes.canonicalize_value(array)
        with jax.enable_x64(alive.dtype == np.float32):
            mixed = dtypes.canonicalize_value(array).dtype == alive.dtype
        if mixed:
            dtypes.register_canonicalize_value_handler(np.ndarray, constant)


def _forget(number: int) -> None:
    """The array is gone, and another may have its number next."""
    for dtype in _watched.pop(number, ()):
        _made.pop((number, dtype), None)
