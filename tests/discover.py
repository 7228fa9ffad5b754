"""What stands in the library's folders, found and not listed: a new file needs no edit of the tests."""

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import equinox as eqx


def modules(package: str) -> Iterator[ModuleType]:
    """The package and every module under it, the deliberate mistakes of `verify.mutants` left out."""
    root = importlib.import_module(package)
    yield root
    for found in pkgutil.walk_packages(getattr(root, "__path__", ()), f"{package}."):
        if ".mutants" not in found.name:
            yield importlib.import_module(found.name)


def examples(package: str) -> dict[str, Any]:
    """Every value in an `EXAMPLES` mapping of the package's modules, by "folder.module-name"."""
    return {
        f"{module.__name__.removeprefix('mcmc1d.')}-{name}": value
        for module in modules(package)
        for name, value in getattr(module, "EXAMPLES", {}).items()
    }


def nested_types(value: Any) -> set[type]:
    """The types of a value and of everything that its fields hold."""
    if isinstance(value, eqx.Module):
        return {type(value)}.union(*map(nested_types, vars(value).values()))
    if isinstance(value, dict):
        return set().union(*map(nested_types, value.values()))
    if isinstance(value, list | tuple):
        return set().union(*map(nested_types, value))
    return set()
