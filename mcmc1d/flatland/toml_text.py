"""What `tomllib` leaves out: the line on which a value stands, and how text is quoted."""

import json
import re
import tomllib
from collections.abc import Sequence
from typing import Any


def parse(text: str, path: str) -> dict[str, Any]:
    """The text's tables; `ValueError` in one line, `path:line: ...`, where it is not TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        found = re.search(r" \(at line (\d+), column (\d+)\)$", str(error))
        what, place = (str(error)[: found.start()], f":{found[1]}") if found else (str(error), "")
        if " (at end of document)" in what:
            what, place = what.replace(" (at end of document)", ", but the file ends"), f":{len(text.splitlines())}"
        raise ValueError(f"{path}{place}: is not TOML: {' '.join(what.split())}") from None


def line_of(text: str, keys: Sequence[str | int]) -> int:
    """The line, from 1, on which the statement begins that gives the value under `keys` in this TOML text.

    The first lines of a TOML file are TOML again unless a statement is cut in two. So the statement lies between the
    last such piece that does not hold the value and the first that does: both found by bisection, with `tomllib` as
    the judge, whatever quotes and comments the text has.
    """
    lines = text.split("\n")
    without, within = 0, len(lines)
    while True:
        middle = (without + within) // 2
        pieces = [*range(middle, without, -1), *range(middle + 1, within)]
        found = next(((n, held) for n in pieces if (held := _holds("\n".join(lines[:n]), keys)) is not None), None)
        if found is None:
            return without + 1
        without, within = (without, found[0]) if found[1] else (found[0], within)


def _holds(text: str, keys: Sequence[str | int]) -> bool | None:
    """Whether there is a value under `keys`; None where the text is not TOML."""
    try:
        value: Any = tomllib.loads(text)
    except ValueError:
        return None
    for key in keys:
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return False
    return True


def basic_string(text: str) -> str:
    """The text in quotes, as TOML reads it back."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


__all__ = ["basic_string", "line_of", "parse"]
