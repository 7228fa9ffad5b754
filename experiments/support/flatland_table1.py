"""What Hoberock and Hart 2010 say of their table 1, held to the runs in the plane."""

from itertools import pairwise

import numpy as np
import xarray as xr
from scipy.stats import ttest_ind

from experiments.support.flatland_held import exact_claim
from experiments.support.framework import Claim
from experiments.support.intervals import DECIDES, Ratio, over, ratio, shown, under
from experiments.support.stage_methods import METHODS
from experiments.support.verdict import among, verdict

STAGES = ("multi-stage", "noise-aware")
DOOR = "holds if the scene is door"
"""Expected is what was found in the plane, where theory says nothing: in a box independent paths are even by themselves
and easy to find."""

REGIMES = {
    "box": "Cornell box",
    "lab": "lab",
    "door": "dark room",
    "three_rooms": "dark room",
}
"""Which of the paper's a scene stands for."""
THERE = {
    "Cornell box": {
        "shadow": (0.103, 0.0389, 0.0394, 0.0457, 0.0455, 0.0460),
        "acceptance": (np.nan, 0.490, 0.847, 0.443, 0.442, 0.435),
        "variance": (0.0, 3.7320, 3.7322, 0.1558, 0.0936, 0.1035),
        "error": (0.168, 0.169, 0.172, 0.170, 0.182, 0.181),
        "visual": (1.93, 1.67, 1.88, 1.58, 1.54, 1.56),
    },
    "lab": {
        "shadow": (0.743, 0.146, 0.315, 0.671, 0.174, 0.162),
        "acceptance": (np.nan, 0.585, 0.631, 0.121, 0.418, 0.488),
        "variance": (0.0, 1425.1, 1864.7, 90.576, 34.414, 14.695),
        "error": (4647, 841, 1170, 2210, 2303, 5757),
        "visual": (8.80, 7.46, 7.45, 9.14, 5.15, 4.19),
    },
    "dark room": {
        "shadow": (0.974, 0.296, 0.487, 0.312, 0.304, 0.316),
        "acceptance": (np.nan, 0.546, 0.545, 0.499, 0.471, 0.452),
        "variance": (0.0, 1.0260, 1.1449, 0.4051, 0.0693, 0.0952),
        "error": (1.013, 0.045, 0.049, 1.171, 0.458, 0.324),
        "visual": (16.07, 5.43, 5.08, 6.94, 4.70, 4.59),
    },
}
"""Table 1 of the paper but for the head, in the order of its rows."""


def there(scene: str, column: str, method: str) -> float:
    """What the paper has in the regime that a scene stands for."""
    return THERE[REGIMES[scene]][column][METHODS.index(method)]


class Runs:
    """The columns of the table, of every run, and what they say of one algorithm against another."""

    def __init__(self, data: xr.Dataset, source: str):
        self.data, self.source = data, source
        self.scenes = [str(name) for name in data.scene.to_numpy()]

    def of(self, column: str, scene: str, method: str) -> np.ndarray:
        """A column of every run."""
        return self.data[column].sel(scene=scene, algorithm=method).to_numpy()

    def ratios(
        self, columns: tuple[str, ...], methods: tuple[str, ...], rivals: tuple[str, ...], scene: str, miss: float
    ) -> list[Ratio]:
        """Of geometric means: in each column, of each method to each rival; none is missed but with `miss`."""
        each = [(c, m, r) for c in columns for m in methods for r in rivals]
        return [ratio(self.of(c, scene, m), self.of(c, scene, r), miss / len(each)) for c, m, r in each]

    def listed(
        self, column: str, methods: tuple[str, ...], rivals: tuple[str, ...], true: dict[str, bool | None]
    ) -> str:
        """The ratios of all scenes, with intervals of 95 % each, those of the paper, and what is true of each scene."""
        found = []
        for scene in self.scenes:
            each = [
                f"{m}/{r} {shown(ratio(self.of(column, scene, m), self.of(column, scene, r)))} "
                f"({there(scene, column, m) / there(scene, column, r):.3g})"
                for m in methods
                for r in rivals
            ]
            found.append(f"{_named(scene, true)}: {', '.join(each)}")
        return "; ".join(found)

    def claim(
        self,
        name: str,
        statement: str,
        where: str,
        expected: str,
        columns: tuple[str, ...],
        methods: tuple[str, ...],
        rivals: tuple[str, ...],
        *,
        above: float | None = None,
    ) -> Claim:
        """Whether every ratio of a method to a rival is under 1, or over `above`, scene by scene."""
        miss = DECIDES / len(self.scenes)
        deciding = {scene: self.ratios(columns, methods, rivals, scene, miss) for scene in self.scenes}
        true = {s: under(1.0, *found) if above is None else over(above, *found) for s, found in deciding.items()}
        worst = max(high / middle for found in deciding.values() for middle, _, high in found)
        side = "under 1" if above is None else f"over {above:g}"
        return Claim(
            name,
            statement,
            where,
            among(true),
            expected,
            "; ".join(f"{column}: {self.listed(column, methods, rivals, true)}" for column in columns),
            f"ratios of geometric means {side}, the paper's in brackets; Welch's t of {self.data.sizes['run']} runs: "
            f"shown of 95 % each, deciding at {DECIDES:g} family-wise, where they reach to a factor of {worst:.2f}",
        )


def _named(scene: str, true: dict[str, bool | None]) -> str:
    """A scene, the paper's regime, and what is said of it alone."""
    return f"{scene} ({REGIMES[scene]}, {verdict(true[scene])})"


def claims(data: xr.Dataset, source: str) -> list[Claim]:
    """Exact images; who is even; who looks better, and has the lower error; shadow rays and acceptance."""
    runs = Runs(data, source)
    table = f"{source}, sec. 5.3, table 1"
    return [
        exact_claim(data, source),
        runs.claim(
            "plane.stages-even",
            "Multi-stage and noise-aware spread their samples more evenly than MLT: the density's variance",
            table,
            "holds",
            ("variance",),
            STAGES,
            ("MLT",),
        ),
        runs.claim(
            "plane.stages-even-two",
            "Multi-stage spreads its samples more evenly than two-stage",
            table,
            "holds",
            ("variance",),
            ("multi-stage",),
            ("two-stage",),
        ),
        runs.claim(
            "plane.erpt-even",
            "ERPT's samples stratify no better than MLT's: the density's variance is no less than 0.9 of theirs",
            table,
            "holds",
            ("variance",),
            ("ERPT",),
            ("MLT",),
            above=0.9,
        ),
        *(
            runs.claim(
                f"plane.{method}-visual",
                f"{method.capitalize()} has a lower visual error at equal rays than MLT, ERPT and two-stage",
                table,
                "holds",
                ("visual",),
                (method,),
                ("MLT", "ERPT", "two-stage"),
            )
            for method in STAGES
        ),
        runs.claim(
            "plane.stages-visual-path",
            "Multi-stage and noise-aware have a lower visual error at equal rays than path tracing",
            table,
            DOOR,
            ("visual",),
            STAGES,
            ("path",),
        ),
        runs.claim(
            "plane.noise-aware-gain",
            "Noise-aware has a lower visual error than multi-stage",
            f"ours; {source}, table 1",
            "fails",
            ("visual",),
            ("noise-aware",),
            ("multi-stage",),
        ),
        runs.claim(
            "plane.stages-absolute",
            "Multi-stage and noise-aware raise the absolute (squared) error against MLT",
            table,
            "holds",  # of independent samples, those in proportion to f have the least variance
            ("error",),
            STAGES,
            ("MLT",),
            above=1.0,
        ),
        runs.claim(
            "plane.acceptance-visual",
            "A high acceptance rate is no goal: multi-stage accepts less than MLT and has a lower visual error",
            f"{source}, sec. 5.3",
            "holds",
            ("acceptance", "visual"),
            ("multi-stage",),
            ("MLT",),
        ),
        _shadow_claim(runs),
    ]


_ORDER = ("path", "ERPT", "MLT")
"""From those whose shadow rays are blocked most."""


def _shadow_claim(runs: Runs) -> Claim:
    pairs = list(pairwise(_ORDER))
    miss = DECIDES / (len(runs.scenes) * len(pairs))
    true, listed, widest = {}, [], 0.0
    for scene in runs.scenes:
        rates = {m: runs.of("shadow", scene, m) for m in _ORDER}
        apart = [difference(rates[a], rates[b], miss) for a, b in pairs]
        true[scene] = ordered(apart)
        widest = max(widest, *((high - low) / 2 for low, high in apart))
        each = [f"{m} {rate.mean():.1%} ({there(scene, 'shadow', m):.1%})" for m, rate in rates.items()]
        listed.append(f"{_named(scene, true)}: {', '.join(each)}")
    return Claim(
        "plane.shadow-rays",
        "More of path tracing's shadow rays are blocked than of ERPT's, and of those more than of MLT's",
        f"{runs.source}, sec. 5.3, table 1",
        among(true),
        # Of ERPT's rays half are those of paths, and the other half, as nine of ten of MLT's, are of small steps.
        "holds",
        "; ".join(listed),
        f"the paper's, shares of paths, in brackets; Welch's t of {runs.data.sizes['run']} runs, {DECIDES:g} "
        f"family-wise, ± {widest:.2%} at most",
    )


def difference(above: np.ndarray, below: np.ndarray, miss: float) -> tuple[float, float]:
    """The interval of a difference of two means, of independent runs, that misses it with `miss`; by Welch's t."""
    low, high = ttest_ind(above, below, equal_var=False).confidence_interval(1 - miss)
    return float(low), float(high)


def ordered(apart: list[tuple[float, float]]) -> bool | None:
    """Whether all differences are positive; None where an interval, or a run without a ray, does not decide it."""
    if any(high < 0 for _, high in apart):
        return False
    return True if all(low > 0 for low, _ in apart) else None


__all__ = ["claims", "difference", "ordered", "there"]
