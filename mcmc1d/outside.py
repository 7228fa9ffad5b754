"""What functions read from outside of their arguments: a program that was made of them is good while that stays.

JAX compiles a function once and knows it by its identity. In a session a function stays the same object while a global,
a closure's variable, a class's attribute or an array in one of these changes; what was compiled before would then stand
for what is asked now, and a right kernel's verdict be given to its mutant.
"""

import dis
import functools
import hashlib
import sys
import sysconfig
import types
from collections import ChainMap
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

_SETTLED = tuple(
    f"{folder}/"
    for folder in (*map(sysconfig.get_paths().get, ("stdlib", "purelib", "platlib")), Path(__file__).parent.as_posix())
)
"""Where code lies whose globals nobody changes."""
_VALUES = (bool, int, float, complex, str, bytes, type(None), np.generic, np.ndarray, jax.Array)
_MOST = 20_000
"""Objects that are looked at, of a graph without end."""


class Outside:
    """All that the functions and classes in a pytree read from outside, as it is now: a key for compiled programs."""

    def __init__(self, tree: Any):
        self._held = tuple(_Reader().read(tree, outside=False))
        self._hash = hash(self._held)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Outside) and self._held == other._held


class _Same:
    """An object as itself: equal to no other, and kept, so that no other gets its number."""

    def __init__(self, it: Any):
        self.it = it

    def __hash__(self) -> int:
        return id(self.it)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.it is other.it


class _Reader:
    """One look at a graph of objects, each of which is read once."""

    def __init__(self):
        self.seen: dict[tuple[int, bool], Any] = {}

    def read(self, it: Any, outside: bool) -> Iterator[Any]:
        """What `it` reads; and where it lies `outside` of the arguments itself, what it is."""
        if isinstance(it, _VALUES):
            if outside:
                yield _content(it)
        elif not isinstance(it, Tracer | types.ModuleType) and self._first(it, outside):
            yield from self._parts(it, outside)

    def _first(self, it: Any, outside: bool) -> bool:
        if (id(it), outside) in self.seen or len(self.seen) > _MOST:
            return False
        self.seen[id(it), outside] = it
        return True

    def _parts(self, it: Any, outside: bool) -> Iterator[Any]:
        match it:
            case list() | tuple() | set() | frozenset():
                parts = [*it, len(it)]
            case dict():
                parts = [*it.keys(), *it.values()]
            case types.MethodType():  # made anew whenever it is asked for
                parts = [it.__func__, it.__self__]
            case functools.partial():
                parts = [it.func, it.args, it.keywords]
            case eqx.Module():
                parts = [getattr(it, field.name, None) for field in fields(it)]
                yield from self.read(type(it), outside)
            case _:
                if outside:
                    yield _Same(it)
                parts, outside = list(_read_by(it)), True
        for part in parts:
            yield from self.read(part, outside)


def _content(it: Any) -> Any:
    """A number, a text or an array by its value; an array of JAX never changes."""
    if isinstance(it, jax.Array):
        return None if isinstance(it, Tracer) else _Same(it)
    if isinstance(it, np.ndarray):
        return it.shape, it.dtype.str, hashlib.blake2b(np.ascontiguousarray(it).data, digest_size=16).digest()
    return type(it), repr(it)


def _read_by(it: Any) -> Iterator[Any]:
    """What a function, a class or any other object refers to."""
    if isinstance(it, types.FunctionType):
        cells = {}
        for name, cell in zip(it.__code__.co_freevars, it.__closure__ or (), strict=True):
            with suppress(ValueError):  # empty yet
                cells[name] = cell.cell_contents
        yield from (it.__defaults__, it.__kwdefaults__, getattr(it, "__wrapped__", None), *cells.values())
        if not it.__code__.co_filename.startswith(_SETTLED):
            known = ChainMap(cells, it.__globals__)
            yield from (_resolved(chain, known) for chain in _chains(it.__code__))
    elif isinstance(it, type):
        for base in it.__mro__:
            if not _settled(base):
                yield from (
                    _bare(value) for name, value in vars(base).items() if name[:2] != "__" or name == "__call__"
                )
    else:
        yield from (type(it), getattr(it, "__wrapped__", None))
        yield from list(getattr(it, "__dict__", {}).values())


@functools.cache
def _settled(kind: type) -> bool:
    """Whether a class is Python's, or of an installed library."""
    module = sys.modules.get(kind.__module__)
    file = getattr(module, "__file__", None)
    return kind.__module__ == "builtins" or (file is not None and file.startswith(_SETTLED))


def _bare(attribute: Any) -> Any:
    """The function behind a method, a property, or what Equinox makes of them."""
    match attribute:
        case staticmethod() | classmethod():
            return attribute.__func__
        case property():
            return attribute.fget
        case functools.cached_property():
            return attribute.func
        case _:
            return attribute.method if type(attribute).__module__.startswith("equinox.") else attribute


@functools.cache
def _chains(code: types.CodeType) -> tuple[tuple[str, ...], ...]:
    """The names, with the attributes asked of them, that code reads from outside: ("jnp", "exp")."""
    found: list[list[str]] = []
    open_ = False
    for instruction in dis.get_instructions(code):
        if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF"):
            found.append([instruction.argval])
            open_ = True
        elif open_ and instruction.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            found[-1].append(instruction.argval)
        else:
            open_ = False
    inner = [_chains(part) for part in code.co_consts if isinstance(part, types.CodeType)]
    return tuple(dict.fromkeys([*map(tuple, found), *(chain for part in inner for chain in part)]))


def _resolved(chain: tuple[str, ...], known: Mapping[str, Any]) -> Any:
    """What a chain of names stands for: of attributes that are computed, the object that they are asked of."""
    it = known.get(chain[0])
    for name in chain[1:]:
        own = getattr(it, "__dict__", {})
        if name not in own:
            break
        it = own[name]
    return it


__all__ = ["Outside"]
