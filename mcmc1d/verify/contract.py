"""What a verification says: which equation was checked, where it was worst, against which tolerance."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Check:
    """One equation held to one tolerance at many points."""

    equation: str
    """The equation, in words and symbols."""
    passed: bool
    points: int
    """How many points were compared."""
    error: float
    """The error at the worst point: the one with the largest error in units of its tolerance."""
    tolerance: float
    """The tolerance at that point."""
    where: str = ""
    """The worst point, and both sides of the equation there."""
    note: str = ""
    """What the reader must know besides: points left out and why."""

    def __str__(self) -> str:
        mark = "ok  " if self.passed else "FAIL"
        line = f"{mark}  {self.equation}: error {self.error:.1e}, tolerance {self.tolerance:.1e}, {self.points} points"
        if self.where and not self.passed:
            line += f"\n      worst at {self.where}"
        if self.note:
            line += f"\n      {self.note}"
        return line


class ContractError(AssertionError):
    """A contract is broken; the message is the report."""


@dataclass(frozen=True)
class ContractReport:
    """All checks of one object; true where every one passed."""

    subject: str
    checks: list[Check] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def failures(self) -> list[Check]:
        """The checks that did not."""
        return [check for check in self.checks if not check.passed]

    def __bool__(self) -> bool:
        return self.passed

    def __str__(self) -> str:
        head = f"{self.subject}: {'PASS' if self.passed else 'FAIL'}"
        return "\n".join([head, *(f"  {check}" for check in self.checks)])

    def raise_if_failed(self) -> "ContractReport":
        """The report itself, or `ContractError` with its text."""
        if not self.passed:
            raise ContractError(str(self))
        return self


def numbers(values: np.ndarray) -> str:
    """A point for a message, with all the digits that it takes to reproduce it."""
    return np.array2string(np.asarray(values), separator=", ", floatmode="unique", max_line_width=200)
