"""What functions read from outside of their arguments, and whether it has changed since they were compiled.

JAX compiles a function once and knows it by its identity. In a session a function stays the same object while a global,
a closure's variable, an attribute, an array in one of these or its own code changes; what was compiled before would
then stand for what is asked now, and a right kernel's verdict be given to its mutant.
"""

import dis
import functools
import os
import site
import sys
import sysconfig
import types
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

_SETTLED = tuple(
    str(Path(folder).resolve()) + os.sep
    for folder in (
        *map(sysconfig.get_path, ("stdlib", "purelib", "platlib")),
        *site.getsitepackages(),
        site.getusersitepackages(),
        Path(__file__).parent,
    )
)
"""Where code lies whose globals nobody changes."""
_PLAIN = (bool, int, float, complex, str, bytes, type(None), np.generic)
_FUNCTIONS = (types.FunctionType, types.MethodType, functools.partial)
_MOST, _LARGE = 5_000, 10**6  # objects of one look; numbers of an array, of which as many are looked at
_before: dict[int, tuple[weakref.ref[Any], dict[str, tuple[Any, ...]]]] = {}
"""Of each object that was looked at, while it lives, and each method of it: what it read then."""


def forget_what_has_changed(*given: Any) -> None:
    """Have JAX forget all that it has compiled, where a function or class in `given` reads something else than before.

    That is numbers, texts, arrays, lists and dictionaries of them, functions, methods, attributes of objects and of
    modules. What can not be looked at may have changed.
    """
    changed = False
    try:
        for root in _roots(given):
            owner, name = (root.__self__, root.__name__) if isinstance(root, types.MethodType) else (root, "")
            memory, now = _memory(owner), tuple(_held(root))
            changed |= memory.get(name, now) != now
            memory[name] = now
    except Exception:  # a user's objects may do as they like when they are looked at: to forget is safe, and slow
        changed = True
    if changed:
        jax.clear_caches()


def _memory(it: Any) -> dict[str, tuple[Any, ...]]:
    """By identity: an object's own equality and hash are its own business."""
    number = id(it)
    if number not in _before:
        _before[number] = weakref.ref(it, lambda _: _before.pop(number, None)), {}
    return _before[number][1]


def _roots(tree: Any) -> Iterator[Any]:
    """The functions and other objects among the leaves of a pytree, and the classes of its modules."""
    todo = [tree]
    while todo:
        it = todo.pop()
        if is_dataclass(it) and not isinstance(it, type):
            todo += [getattr(it, field.name, None) for field in fields(it)]
            if not _settled_class(type(it)):
                yield type(it)
        elif isinstance(it, list | tuple):
            todo += it
        elif isinstance(it, dict):
            todo += it.values()
        elif not isinstance(it, (*_PLAIN, np.ndarray, jax.Array)) and (
            # What a library has made without weak references reads nothing: a dtype, the structure of a tree.
            type(it).__weakrefoffset__ or not _settled_class(type(it))
        ):
            yield it


def _held(root: Any) -> Iterator[Any]:
    """All that it reads, one after the other, as values that can be compared; each object once, and then its number."""
    seen: dict[int, tuple[int, Any]] = {}
    todo = [root]
    while todo and len(seen) < _MOST:
        it = todo.pop()
        if isinstance(it, _PLAIN):
            yield type(it), repr(it)
        elif id(it) in seen:
            yield seen[id(it)][0]
        else:
            seen[id(it)] = len(seen), it
            value, parts = _read(it)
            yield value
            todo += parts


def _read(it: Any) -> tuple[Any, list[Any]]:
    """What an object is, and what it refers to, as far as that is looked at."""
    value, parts = _itself(it), []
    if isinstance(it, Tracer | types.ModuleType):
        pass
    elif isinstance(it, np.ndarray | jax.Array):
        value = _numbers(it)
    elif isinstance(it, list | tuple | set | frozenset | dict):
        value, parts = (type(it), len(it)), [*it.keys(), *it.values()] if isinstance(it, dict) else list(it)
    elif isinstance(it, types.FunctionType):
        value, parts = it.__code__, list(_read_by(it))
    elif isinstance(it, types.MethodType):
        value, parts = type(it), [it.__func__, *_attributes(it.__self__, _names(it.__func__))]
    elif isinstance(it, functools.partial):
        value, parts = type(it), [it.func, it.args, it.keywords]
    elif isinstance(it, type):
        parts = [] if _settled_class(it) else list(_members(it))
    elif isinstance(it, eqx.Module):
        value, parts = type(it).__qualname__, [type(it), *(getattr(it, field.name, None) for field in fields(it))]
    else:
        # A function that JAX or functools has wrapped, or an object that is called, or only handed on.
        own, call = getattr(it, "__dict__", {}), vars(type(it)).get("__call__")
        parts = [part for name, part in own.items() if name == "__wrapped__" or isinstance(part, _FUNCTIONS)]
        if isinstance(call, types.FunctionType):
            parts += [call, *_attributes(it, _names(call))]
    return value, parts


def _itself(it: Any) -> Any:
    """What is equal for this object alone; another may have its number once it is gone."""
    return weakref.ref(it) if type(it).__weakrefoffset__ else id(it)


def _numbers(array: Any) -> Any:
    """The kind of an array, and what stands for its numbers."""
    if isinstance(array, jax.Array) and jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    found = np.asarray(array)
    some = np.ascontiguousarray(found.ravel()[:: max(1, found.size // _LARGE)])
    return found.shape, found.dtype.str, hash(some.tobytes())


def _read_by(function: types.FunctionType) -> Iterator[Any]:
    """What a function takes from its closure, its defaults and, where its module is a user's, from its globals."""
    yield from (function.__defaults__, function.__kwdefaults__, vars(function).get("__wrapped__"))
    cells = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            cells[name] = cell.cell_contents
        except ValueError:  # empty yet
            continue
    if function.__code__.co_filename.startswith(_SETTLED):
        yield from cells.values()
    else:
        for scope, chain in _chains(function.__code__):
            yield _resolved(chain, cells if scope == "cell" else function.__globals__)


def _members(kind: type) -> Iterator[Any]:
    """The functions and values of a class and of those that it is made of."""
    for base in kind.__mro__:
        if not _settled_class(base):
            for name, value in vars(base).items():
                if not name.startswith("__") or name == "__call__":
                    yield _bare(value)


def _bare(attribute: Any) -> Any:
    """The function behind a method or a property."""
    if isinstance(attribute, staticmethod | classmethod):
        return attribute.__func__
    if isinstance(attribute, property):
        return attribute.fget
    if isinstance(attribute, functools.cached_property):
        return attribute.func
    return attribute.method if type(attribute).__name__ == "_wrap_method" else attribute  # Equinox's


def _attributes(it: Any, names: set[str]) -> Iterator[Any]:
    """Of an object the attributes of these names, its own and its class's; a method's with those that it asks for.

    But what a method changes itself.
    """
    done, todo = set[str](), list(names)
    own = getattr(it, "__dict__", {})
    if isinstance(it, types.ModuleType | eqx.Module | type):
        return
    while todo:
        name = todo.pop()
        if name in done:
            continue
        done.add(name)
        if name in own:
            yield own[name]
        elif not _settled_class(type(it)):
            for base in type(it).__mro__:
                if name in vars(base):
                    found = _bare(vars(base)[name])
                    yield found
                    if isinstance(found, types.FunctionType):
                        todo += _names(found)
                    break


def _names(function: types.FunctionType) -> set[str]:
    """Those that it reads, and does not change."""
    return set(function.__code__.co_names) - _stored(function.__code__)


def _settled_class(kind: type) -> bool:
    """Whether a class is Python's, or of an installed library."""
    name = kind.__module__
    modules = map(sys.modules.get, (name, name.partition(".")[0]))  # one made by C has no file, and its package has
    file = next(filter(None, (getattr(module, "__file__", None) for module in modules)), None)
    return name == "builtins" or (file is not None and file.startswith(_SETTLED))


_SCOPES = {"LOAD_GLOBAL": "global", "LOAD_NAME": "global", "LOAD_DEREF": "cell"}


@functools.lru_cache(1024)
def _chains(code: types.CodeType) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """The names, with the attributes asked of them, that code reads from outside: ("global", ("jnp", "exp"))."""
    found: list[tuple[str, list[str]]] = []
    follows = False
    for instruction in dis.get_instructions(code):
        if instruction.opname in _SCOPES:
            found.append((_SCOPES[instruction.opname], [instruction.argval]))
            follows = True
        elif follows and instruction.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            found[-1][1].append(instruction.argval)
        elif instruction.opname not in ("EXTENDED_ARG", "CACHE"):
            follows = False
    each = [(scope, tuple(names)) for scope, names in found]
    each += [chain for part in code.co_consts if isinstance(part, types.CodeType) for chain in _chains(part)]
    # A variable of the function's own, of a function inside, is none of its closure; and what it changes itself, as one
    # that counts how often it is traced, makes it no other.
    return tuple(
        dict.fromkeys(
            (scope, names)
            for scope, names in each
            if (scope == "global" or names[0] in code.co_freevars)
            and names[0] not in _stored(code)
            and names[-1] not in _MUTATORS
        )
    )


_MUTATORS = ("append", "extend", "add", "update", "insert", "pop", "clear")


@functools.lru_cache(1024)
def _stored(code: types.CodeType) -> frozenset[str]:
    """The globals, variables of the closure and attributes that code changes."""
    stores = ("STORE_GLOBAL", "STORE_DEREF", "STORE_ATTR")
    return frozenset(i.argval for i in dis.get_instructions(code) if i.opname in stores)


def _resolved(chain: tuple[str, ...], known: Mapping[str, Any]) -> Any:
    """What a chain of names stands for: a value, a method, or the object of which something computed is asked."""
    it = known.get(chain[0])
    for name in chain[1:]:
        own = getattr(it, "__dict__", {})
        if name not in own:
            of_class = getattr(type(it), name, None)
            return types.MethodType(of_class, it) if isinstance(of_class, types.FunctionType) else it
        it = own[name]
    return it


__all__ = ["forget_what_has_changed"]
