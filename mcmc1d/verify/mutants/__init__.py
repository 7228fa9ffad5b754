"""Wrong techniques, moves and kernels, on purpose, and right ones that look wrong: what a verification must tell apart.

Nothing here is for use. Each mutant is a mistake that was really made, a few lines from the right thing, with where it
comes from and which layer must catch it; each trap is right and must pass. They stand in their files' `MUTANTS` and
`TRAPS` mappings; `mutants()` and `traps()` collect them.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

LAYERS = ("contract", "law", "marginal", "joint", "density", "exchangeability", "deposits", "motion", "efficiency")
"""What can catch a mutant: `check_technique` and `check_move`; "law", that a target's exact draws and exact values
agree (a wrong technique's do not); the tests of `verify` by kind; "motion", that it moves, stays where the law is and
forgets a bad start; "efficiency", `verify.efficiency` against the right kernel, for what changes the variance only."""


@dataclass(frozen=True)
class Mutant:
    """A wrong technique, move or kernel."""

    subject: Any
    """A `Technique` or a `Move` for the contract, or whatever `verify` takes."""
    mistake: str
    origin: str
    """The paper or the released software in which it was made."""
    caught_by: str = ""
    """The equation of the contract that it breaks, as the report words it."""
    layer: str = "contract"
    """One of `LAYERS`, which must catch it; others may as well."""
    law: Any = None
    """What `verify` is given as the target."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of `verify`."""
    right: Any = None
    """The kernel without the mistake, which passes."""


@dataclass(frozen=True)
class Trap:
    """A right kernel that looks wrong."""

    subject: Any
    law: Any
    why: str
    """What makes it look wrong."""
    options: Mapping[str, Any] = field(default_factory=dict)


def mutants() -> dict[str, Mutant]:
    """Every mutant by name."""
    return _collect("MUTANTS")


def traps() -> dict[str, Trap]:
    """Every trap by name."""
    return _collect("TRAPS")


def _collect(mapping: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for module in pkgutil.iter_modules(__path__):
        entries = getattr(importlib.import_module(f"{__name__}.{module.name}"), mapping, {})
        twice = found.keys() & entries.keys()
        if twice:
            raise ValueError(f"{mapping}: the name {twice} is taken")
        found |= entries
    return found


__all__ = ["LAYERS", "Mutant", "Trap", "mutants", "traps"]
