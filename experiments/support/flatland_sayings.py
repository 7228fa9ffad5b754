"""Whose error Hachisuka et al. 2014 say is lower at equal work, and in which scenes."""

from experiments.support.flatland_equal import Rivalry
from experiments.support.flatland_glossy import GLOSSY_DOOR

SOURCE = "Hachisuka et al. 2014"
ALL = ("door", GLOSSY_DOOR, "glossy_corner")
"""What the paper compares MMLT and PSSMLT on; the last two are glossy."""
RIVALRIES = (
    Rivalry(
        "plane.mmlt-against-pssmlt-max",
        "MMLT's error at equal rays is lower than that of PSSMLT with the maximum",
        f"{SOURCE}, fig. 1, 4, 9",
        "holds",
        "MMLT",
        ("PSSMLT, max",),
        ALL,
        b_known=True,
    ),
    Rivalry(
        "plane.mmlt-against-pssmlt-sum",
        "MMLT's error at equal rays is lower than that of PSSMLT with the sum",
        f"ours; {SOURCE} has the maximum",
        "holds",
        "MMLT",
        ("PSSMLT, sum",),
        ALL,
        b_known=True,
    ),
    Rivalry(
        "plane.mmlt-against-bdpt",
        "MMLT's error at equal rays is lower than BDPT's",
        f"{SOURCE}, fig. 4, sec. 5",
        "holds",
        "MMLT",
        ("BDPT",),
        ALL[1:],
        b_known=False,
    ),
    Rivalry(
        "plane.mlt-against-mmlt-door",
        "Without gloss original MLT's error at equal rays is lower than MMLT's",
        f"{SOURCE}, fig. 9",
        "holds",
        "MLT",
        ("MMLT",),
        ALL[:1],
        b_known=True,
    ),
    Rivalry(
        "plane.mmlt-against-mlt-glossy",
        "Where walls are glossy MMLT's error at equal rays is lower than original MLT's",
        f"{SOURCE}, fig. 1, 4",
        "holds",
        "MMLT",
        ("MLT",),
        ALL[1:],
        b_known=True,
    ),
    Rivalry(
        "plane.mmlt-against-pt-lt",
        "MMLT's error at equal rays is lower than that of path and of light tracing",
        "ours",
        "holds",
        "MMLT",
        ("PT", "LT"),
        (*ALL, "mirror_caustic"),
        b_known=False,
    ),
)


__all__ = ["RIVALRIES", "SOURCE"]
