"""A verdict in a word."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from mcmc1d.checks import require
from mcmc1d.verify import Verdict


def passes(said: Iterable[Any]) -> bool | None:
    """Whether all verifications passed that said these words; None where none failed, and one was inconclusive."""
    words = {Verdict(str(word)) for word in said}
    require(bool(words), "passes: nothing was verified")
    return False if Verdict.FAIL in words else None if Verdict.INCONCLUSIVE in words else True


def fails(said: Iterable[Any]) -> bool | None:
    """Whether all of them failed; None where none passed, and one was inconclusive."""
    turned = {Verdict.PASS: Verdict.FAIL, Verdict.FAIL: Verdict.PASS, Verdict.INCONCLUSIVE: Verdict.INCONCLUSIVE}
    return passes(turned[Verdict(str(word))].value for word in said)


def detects(gap: Any, level: float = 1e-5) -> str:
    """What verifications at this level are held to, the largest of their gaps."""
    return f"verify at {level:.0e} detects a CDF gap of {float(np.max(gap)):.3f} with probability 0.99"


def near(distance: float, noise: float) -> bool | None:
    """Whether a law is another up to noise that makes such a distance on average: within twice; None up to four times.

    Of ten bins with independent errors, and noise known from two nets alone, four times come by chance in 2e-4 of the
    cases, twice in three of a hundred; where fewer errors are independent, more often. The nets are the same whatever
    the seed, so that a verdict does not change.
    """
    return True if distance < 2 * noise else None if distance < 4 * noise else False


def verdict(*conditions: bool | None) -> str:
    """What to say of a claim that all of this is true of: "open" where none is false, and one (None) not decided."""
    if any(condition is not None and not condition for condition in conditions):
        return "fails"
    return "open" if None in conditions else "holds"


def witnessed(exact: bool, verified: bool | None) -> str:
    """The same of what is known exactly and has been verified as well: what is wrong must be seen to be, or is open."""
    return verdict(verified) if exact else "fails" if verified is False else "open"


def among(true: dict[str, bool] | dict[str, bool | None]) -> str:
    """What to say of what was looked at in several scenes, of which some (None) may not have decided it, or of none.

    What one refutes does not hold in all, whatever the others may show; it holds in those that are named.
    """
    held = [name for name, yes in true.items() if yes]
    if False in true.values():
        return f"holds if the scene is {' or '.join(held)}" if held else "fails"
    return "holds" if true and None not in true.values() else "open"
