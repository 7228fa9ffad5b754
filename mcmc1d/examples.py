"""What a module offers by example, made when it is first asked for."""

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any


class Examples(Mapping[str, Any]):
    """The `EXAMPLES` of a module, by name: what the tests of all techniques, all moves, all targets go through.

    To make them takes tracing and compiling, which is no part of an import; a dict does as well where it does not.
    """

    def __init__(self, make: Callable[[], dict[str, Any]]):
        self._make = make

    @cached_property
    def _made(self) -> dict[str, Any]:
        return self._make()

    def __getitem__(self, name: str) -> Any:
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


__all__ = ["Examples"]
