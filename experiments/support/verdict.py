"""A verdict in a word."""

from collections.abc import Iterable
from typing import Any


def passes(said: Iterable[Any]) -> bool | None:
    """Whether all verifications passed that said these words; None where none failed, and one was inconclusive."""
    words = {str(word) for word in said}
    return False if "FAIL" in words else None if "INCONCLUSIVE" in words else True


def fails(said: Iterable[Any]) -> bool | None:
    """Whether all of them failed; None where none passed, and one was inconclusive."""
    return passes({"PASS": "FAIL", "FAIL": "PASS"}.get(str(word), word) for word in said)


def verdict(*conditions: bool | None) -> str:
    """What to say of a claim that all of this is true of: "open" where none is false, and one (None) not decided."""
    if any(condition is not None and not condition for condition in conditions):
        return "fails"
    return "open" if None in conditions else "holds"


def among(true: dict[str, bool] | dict[str, bool | None]) -> str:
    """The same of what was looked at in several scenes; "open" where one of them (None) did not decide it."""
    if None in true.values():
        return "open"
    if all(true.values()) or not any(true.values()):
        return verdict(all(true.values()))
    return f"holds if the scene is {' or '.join(name for name, yes in true.items() if yes)}"
