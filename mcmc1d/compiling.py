"""Functions under jit, with compiler options of their own: never global ones."""

import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
from jax.extend.core import Jaxpr, jaxpr_as_fun, jaxprs_in_params

from mcmc1d.constants import keep_precisions_apart

F = TypeVar("F", bound=Callable)

_NARROW = ("atan",)
"""What XLA's CPU compiler gets wrong for vectors of 512 bits (jaxlib 0.10.2): it hands sixteen floats to its own
arctangent in a register, which looks for them in memory. The results are random. All of `jax.lax` was tried."""


keep_precisions_apart()  # before anything is traced


def jit_with(**options: Any) -> Callable[[F], F]:
    """`equinox.filter_jit` with compiler options: arrays are traced, all else is static."""

    def decorate(function: F) -> F:
        jit: Any = eqx.filter_jit
        return jit(function, compiler_options=options)

    return decorate


quickly = jit_with(
    xla_backend_optimization_level=1, xla_llvm_disable_expensive_passes=True, xla_cpu_use_fusion_emitters=False
)
"""For code that is compiled to run a few times: compiling is nearly all of its time, and takes 0.65 of that.

What it makes is up to three times slower (a histogram seven), so that nothing of a chain's loop is compiled like this.
Level 0 compiles no faster, and wrongly: jaxlib 0.10.2 then returned another number for the place inside an interval.
"""


def wide_jit(function: F) -> F:
    """`equinox.filter_jit` for a CPU's widest vectors, which makes a chain's step up to 1.7 times as fast with AVX-512.

    XLA's default is half that width; without AVX-512, and on a GPU, it makes no difference. A program with an
    operation that XLA gets wrong at that width is compiled with the default.
    """
    wide: Any = jit_with(xla_cpu_prefer_vector_width=512)(functools.wraps(function)(_unless_narrow(function)))
    return _Wide(wide, eqx.filter_jit(function))  # pyright: ignore[reportReturnType]


def inlined(function: F) -> F:
    """`jax.jit` that leaves no call behind: traced once for arguments of one kind, and its operations put in the place.

    For elementary functions of many operations, which a program calls often: to trace them anew each time is a good
    part of what making it takes.
    """
    jit: Any = jax.jit
    return jit(function, inline=True)


def traced_once(function: Callable, *args: Any) -> tuple[Callable, Any]:
    """The function of arrays, traced here for arguments like these, and the shapes of what it returns.

    For a loop whose carry has to be made before its body runs: tracing is half of what a long program takes to compile.
    """
    program, shapes = jax.make_jaxpr(function, return_shape=True)(*args)

    def again(*args: Any) -> Any:
        return jax.tree.unflatten(jax.tree.structure(shapes), jaxpr_as_fun(program)(*jax.tree.leaves(args)))

    return again, shapes


class _Wide:
    """The two compiled functions, and what has turned out to need the narrow one."""

    def __init__(self, wide: Any, narrow: Any):
        self._wide, self._narrow = wide, narrow
        self._known: set[Any] = set()

    def __call__(self, *args: Any) -> Any:
        return self._either(lambda compiled: compiled(*args), args)

    def lower(self, *args: Any) -> Any:
        """Traced and lowered, as JAX has it; what was called before is not traced again."""
        return self._either(lambda compiled: compiled.lower(*args), args)

    def _either(self, use: Callable[[Any], Any], args: tuple[Any, ...]) -> Any:
        leaves, tree = jax.tree.flatten(eqx.filter(args, eqx.is_array, inverse=True))
        key = tuple(leaves), tree
        if key not in self._known:
            try:
                return use(self._wide)
            except _WidthError:
                self._known.add(key)
        return use(self._narrow)


class _WidthError(Exception):
    """Raised while a program is traced that may not be compiled for wide vectors."""


def _unless_narrow(function: Callable) -> Callable:
    """The function; where it does what only narrow vectors can, `_WidthError` is raised as it is traced."""

    def traced(*args: Any) -> Any:
        program, result, static = eqx.filter_make_jaxpr(function)(*args)
        if any(name in _NARROW for name in _operations(program.jaxpr)):
            raise _WidthError
        arrays = jax.tree.leaves(eqx.filter(args, eqx.is_array))
        dynamic = jax.tree.unflatten(jax.tree.structure(result), jaxpr_as_fun(program)(*arrays))
        return eqx.combine(dynamic, static)

    return traced


def _operations(program: Jaxpr) -> Iterator[str]:
    """The names of all primitives of a program, those of loops and branches included."""
    for equation in program.eqns:
        yield equation.primitive.name
        for inner in jaxprs_in_params(equation.params):
            yield from _operations(inner)
