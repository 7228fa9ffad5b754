"""Whose error Hachisuka et al. 2014 say is lower at equal work, and in which scenes."""

from experiments.support.flatland_equal import Rivalry
from experiments.support.flatland_glossy import GLOSSY_DOOR

SOURCE = "Hachisuka et al. 2014"
GLOSSY = (GLOSSY_DOOR, "glossy_corner")
ALL = ("door", *GLOSSY)
"""What the paper compares MMLT with PSSMLT on."""
LOWER = "; lower in the paper"
AGAINST = "fails"
"""Expected of what the plane has shown against the paper, and where theory has no word: a change of it is news."""


def _lower(
    name: str,
    where: str,
    rivals: str | tuple[str, ...],
    source: str,
    scenes: tuple[str, ...],
    expected: str,
    note: str = "",
    *,
    b_known: bool = True,
) -> Rivalry:
    """MMLT's error is said to be lower."""
    higher = (rivals,) if isinstance(rivals, str) else rivals
    statement = f"{where}MMLT's error at equal rays is lower than that of {' and '.join(higher)}"
    return Rivalry(name, statement, source, expected, "MMLT", higher, scenes, b_known, note=note)


RIVALRIES = (
    _lower("plane.mmlt-against-pssmlt", "", "PSSMLT, max", f"{SOURCE}, fig. 1, 4, 9", ALL, AGAINST, LOWER),
    _lower("plane.mmlt-against-pssmlt-sum", "", "PSSMLT, sum", f"ours; {SOURCE} has the maximum", ALL, "holds"),
    _lower("plane.mmlt-against-bdpt", "", "BDPT", f"{SOURCE}, fig. 4", GLOSSY, AGAINST, LOWER, b_known=False),
    _lower("plane.mmlt-against-mlt", "With gloss ", "MLT", f"{SOURCE}, fig. 1, 4", GLOSSY, AGAINST, LOWER),
    Rivalry(
        "plane.mmlt-against-mlt-door",
        "Without gloss original MLT's error at equal rays is lower than MMLT's",
        f"{SOURCE}, fig. 9",
        "holds",
        "MLT",
        ("MMLT",),
        ("door",),
        b_known=True,
        note=LOWER,
    ),
    _lower("plane.mmlt-against-pt-lt", "", ("PT", "LT"), "ours", ALL, AGAINST, b_known=False),
)

__all__ = ["AGAINST", "RIVALRIES", "SOURCE"]
