"""Wrong techniques and wrong moves, on purpose: what a verification must catch.

Nothing here is for use. Each is a few lines on the right thing, reproduces a mistake that was really made, and stands
in its file's `MUTANTS` mapping with where the mistake comes from and which layer must catch it.
"""

from dataclasses import dataclass

from mcmc1d.moves import Move
from mcmc1d.techniques import Technique


@dataclass(frozen=True)
class Mutant:
    """A wrong technique or move."""

    subject: Technique | Move
    mistake: str
    origin: str
    """The paper or the released software in which it was made."""
    caught_by: str
    """The equation of the contract that it breaks, as the report words it."""


__all__ = ["Mutant"]
