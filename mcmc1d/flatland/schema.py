"""Tables of a user's file checked against a schema: each error in one line, with file, line, fault and fix."""

import os
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from mcmc1d.flatland.scene import Point
from mcmc1d.flatland.toml_text import line_of


class Kind(NamedTuple):
    """What a value must be, and how it is taken over; `convert` raises where the value is of another kind."""

    wanted: str
    convert: Callable[[Any], Any]


def exactly(kind: type) -> Callable[[Any], Any]:
    """Takes over values of this very type."""

    def convert(value: Any) -> Any:
        if type(value) is not kind:  # in Python, true is a whole number
            raise TypeError
        return value

    return convert


def _number(value: Any) -> float:
    if type(value) not in (int, float):
        raise TypeError
    return float(value)


def _point(value: Any) -> Point:
    x, y = exactly(list)(value)
    return _number(x), _number(y)


def _points(value: Any) -> list[Point]:
    points = [_point(point) for point in exactly(list)(value)]
    if len(points) < 2:
        raise ValueError
    return points


NUMBER = Kind("a number", _number)
WHOLE = Kind("a whole number", exactly(int))
TEXT = Kind("text in quotes", exactly(str))
FLAG = Kind("true or false", exactly(bool))
POINT = Kind("two numbers [x, y]", _point)
POINTS = Kind("a list of two points [x, y] or more", _points)
TABLE = Kind("a table", exactly(dict))

Schema = Mapping[str, Kind]
"""What each key of a table must be."""

Keys = tuple[str | int, ...]
"""Where a value stands: the keys, and in arrays the places, that lead to it."""


class File(NamedTuple):
    """A file's text and where it lies, for messages that name the line."""

    path: str
    text: str

    def fail(self, keys: Keys, message: str) -> NoReturn:
        """Raise `ValueError` at the line where the value under `keys` begins; in one line."""
        raise ValueError(f"{self.path}:{line_of(self.text, keys)}: {' '.join(message.split())}") from None

    def table(self, value: Any, keys: Keys, what: str, schema: Schema, needed: tuple[str, ...] = ()) -> dict:
        """The table's values, converted; an error where it is none, has unknown keys, wrong types or lacks one."""
        table = self.value(value, keys, what, TABLE)
        for key in table:
            if key not in schema:
                self.fail((*keys, key), f"{what} has the unknown key {key!r}; {nearest(key, schema)}")
        for key in needed:
            if key not in table:
                self.fail(keys, f"{what} lacks {key!r}: add {key} = ..., {schema[key].wanted}")
        return {key: self.value(table[key], (*keys, key), f"{what}: {key}", schema[key]) for key in table}

    def value(self, value: Any, keys: Keys, what: str, kind: Kind) -> Any:
        """The value, converted; an error where it is of another kind."""
        try:
            return kind.convert(value)
        except (TypeError, ValueError, OverflowError):
            self.fail(keys, f"{what} must be {kind.wanted}, not {_shown(value)}")

    def build(self, kind: type, given: dict, keys: Keys, what: str) -> Any:
        """`kind(**given)`; what it refuses is reported at the key that its message begins with, or at the table."""
        try:
            return kind(**given)
        except ValueError as error:
            message = str(error).removeprefix(f"{kind.__name__}: ")
            first = message.split()[0]
            self.fail((*keys, first) if first in given else keys, f"{what}: {message}")


def text_of(path: str | os.PathLike[str]) -> str:
    """What a file holds; `ValueError` where it is not there, can not be read, or is not text in UTF-8."""
    try:
        return Path(path).read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except FileNotFoundError:
        raise ValueError(f"{os.fspath(path)}: there is no such file; give the path of a scene's TOML file") from None
    except OSError as error:
        raise ValueError(f"{os.fspath(path)}: can not be read: {error.strerror}; give a scene's TOML file") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{os.fspath(path)}: is not text in UTF-8 (byte {error.start}); save it as such") from None


def nearest(given: str, known: Mapping[str, Any]) -> str:
    """What a message proposes where `given` is not known: the nearest known name, if one is near, and all of them."""
    near = get_close_matches(given, known, n=1)
    proposal = f"did you mean {near[0]!r}? " if near else ""
    return f"{proposal}known: {', '.join(known) or 'none'}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


__all__ = [
    "FLAG",
    "NUMBER",
    "POINT",
    "POINTS",
    "TABLE",
    "TEXT",
    "WHOLE",
    "File",
    "Keys",
    "Kind",
    "Schema",
    "exactly",
    "nearest",
    "text_of",
]
