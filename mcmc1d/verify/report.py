"""What a verification says of a kernel: the verdict, what it rests on, and what it would not have caught."""

import json
import platform
from dataclasses import asdict, dataclass, field
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np


class Verdict(Enum):
    """PASS, FAIL, or INCONCLUSIVE: the power asked for was out of reach, or a bad start was not forgotten."""

    PASS = "PASS"
    FAIL = "FAIL"
    INCONCLUSIVE = "INCONCLUSIVE"


class VerificationError(AssertionError):
    """A kernel did not pass; the message is the report."""


@dataclass(frozen=True)
class Result:
    """One test of the deciding stage."""

    layer: str
    name: str
    steps: int
    """After how many steps; 0 is the law's own sampler."""
    p_value: float
    """Its own, not yet multiplied by the number of tests."""
    gap: float | None
    """The smallest CDF gap that it shows with the stated probability, at the first stage or the second.

    Of cells without an order, the smallest difference in the probability of one; None where none is meant.
    """
    where: list[str] = field(default_factory=list)
    """Where it deviates most."""
    curve: list[float] | None = None
    """ECDF minus CDF at equal steps of probability."""
    residuals: list[float] | None = None
    """(observed - expected) / s.d. by cell."""


@dataclass(frozen=True)
class Report:
    """The verdict on one kernel; true if it passed, printed for a terminal, `to_json` for a certificate."""

    name: str
    """Of the test; its random numbers derive from it and from the seed."""
    kernel: str
    law: str
    verdict: Verdict
    reasons: list[str]
    """Why not PASS; empty if it is."""
    level: float
    """The probability that a right kernel fails."""
    threshold: float
    """The p-value at or under which one test fails at the deciding stage."""
    p_value: float
    """The first stage's: the smallest of all its tests', times their number."""
    stages: int
    """How many were needed."""
    replicas: int
    """Independent chains, of all stages."""
    first_replicas: int
    """Those of the first stage; `verify(..., replicas=this, seed=seed)` does the same again."""
    gap: float
    """The smallest gap in a coordinate's CDF, of the law after so many steps, that is detected...

    Of a coordinate whose values have no order, in the probability of one of them.
    """
    power: float
    """...with at least this probability."""
    moved: float
    """The share of replicas that were elsewhere when looked at."""
    forgotten: int | None
    """After how many steps from some bad points the law had been reached; None where it was not, or not asked."""
    forgotten_within: float
    """How near, as a CDF gap."""
    resolution: float
    """The largest probability between two points at which a coordinate's CDF was looked at: within is not seen."""
    reversible: bool
    """Whether the kernel was held to detailed balance."""
    seed: int
    seconds: float
    steps: tuple[int, ...]
    tests: int
    """Among how many tests the level is shared."""
    deciding_replicas: int
    """Those that `results` rest on."""
    gap_in: tuple[str, ...] = ("CDF",)
    """In what `gap` is one: "CDF", "cell" (its probability), or both, in different coordinates."""
    first_stage: dict[str, float] = field(default_factory=dict)
    """The first stage's p-values by "layer: name after k"; each test's own."""
    results: list[Result] = field(default_factory=list)
    untested: list[str] = field(default_factory=list)
    """What no test looked at."""
    diagnosis: list[str] = field(default_factory=list)
    """For a move of this library that fails: which kind of move, between which states."""

    @property
    def passed(self) -> bool:
        """Whether the verdict is PASS."""
        return self.verdict is Verdict.PASS

    def __bool__(self) -> bool:
        return self.passed

    @property
    def failures(self) -> list[Result]:
        """The tests at or under the threshold, worst first."""
        return sorted((r for r in self.results if r.p_value <= self.threshold), key=lambda r: r.p_value)

    def raise_if_failed(self) -> "Report":
        """The report itself, or `VerificationError` with its text unless the verdict is PASS."""
        if not self.passed:
            raise VerificationError(str(self))
        return self

    def __str__(self) -> str:
        lines = [f"{self.verdict.value}  {self.kernel} on {self.law}"]
        lines += [f"  {reason}" for reason in self.reasons]
        for result in self.failures[:4]:
            lines.append(
                f"  {result.layer}: {result.name} after {_steps(result.steps)}: p = {result.p_value:.1e} "
                f"(fails at {self.threshold:.1e})"
            )
            lines += [f"      {place}" for place in result.where[:3]]
        if len(self.failures) > 4:
            lines.append(f"  and {len(self.failures) - 4} more of {len(self.results)} tests")
        lines += [f"  {line}" for line in self.diagnosis]
        lines += [f"  {line}" for line in self._small_print()]
        return "\n".join(lines)

    def _small_print(self) -> list[str]:
        """What the verdict is worth, and how to get it again."""
        kinds = {"CDF": f"a CDF gap of {self.gap:.2g}", "cell": f"an error of {self.gap:.2g} in a cell's probability"}
        gap = " or ".join(kinds[kind] for kind in self.gap_in) if np.isfinite(self.gap) else "nothing that varies"
        if self.resolution > 1e-3:
            gap += f", looked at every {self.resolution:.2g} of probability,"
        forgotten = f"; bad starts forgotten in {self.forgotten} steps, to {self.forgotten_within:.2g}"
        forgotten = forgotten if self.forgotten else ""
        moved = f"{self.moved:.1%}" if self.moved >= 0.01 or self.moved == 0 else f"only {self.moved:.2g} of them"
        lines = [
            f"detects    {gap} in the law after any of {', '.join(map(str, self.steps))} steps, "
            f"with probability {self.power:g}",
            f"level      {self.level:.1e}, shared by {self.tests} tests; first-stage p = {self.p_value:.2g} by the "
            f"union bound, {_count(self.stages, 'stage')}",
            f"replicas   {self.replicas:,} exact starts; {moved} moved{forgotten}",
            f"again      seed={self.seed}, replicas={self.first_replicas}"
            + (f", name={self.name!r}" if self.name != f"{self.kernel} on {self.law}" else "")
            + f"; took {self.seconds:.1f} s",
        ]
        if self.passed:
            lines[1:1] = [f"untested   {what}" for what in self.untested]
        return lines

    def to_json(self) -> str:
        """A certificate: everything above, with the versions of what was used."""
        record = asdict(self) | {"verdict": self.verdict.value, "versions": versions()}
        return json.dumps(_plain(record), indent=2, allow_nan=False)

    def plot(self) -> Any:
        """A matplotlib figure: residuals by test and cell, and each ECDF minus its CDF within its simultaneous band."""
        import matplotlib.pyplot as plt

        curves = [r for r in self.results if r.curve is not None and r.steps > 0]
        maps = [r for r in self.results if r.residuals is not None and r.steps > 0]
        figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.4), layout="constrained")
        width = max((len(r.residuals or []) for r in maps), default=1)
        image = np.full((max(len(maps), 1), width), np.nan)
        for row, result in zip(image, maps, strict=False):
            row[: len(result.residuals or [])] = result.residuals or []
        limit = max(5.0, float(np.nanmax(np.abs(image))) if np.isfinite(image).any() else 5.0)
        shown = left.imshow(
            image,
            aspect="auto",
            cmap="PuOr",
            vmin=-limit,
            vmax=limit,
            interpolation="nearest",
            extent=(0, 1, len(maps), 0),
        )
        left.set_yticks(np.arange(len(maps)) + 0.5, [f"{r.name}, {r.steps}" for r in maps], fontsize=6)
        left.set(xlabel="cells in order, from the first to the last", title="residual by cell (s.d.)")
        figure.colorbar(shown, ax=left, fraction=0.05)
        band = float(np.sqrt(np.log(4 / self.threshold) / (2 * max(self.deciding_replicas, 1))))
        right.axhspan(-band, band, color="0.9", label=f"band at {self.threshold:.0e}")
        last = max((r.steps for r in curves), default=0)
        shades = plt.get_cmap("viridis")(np.linspace(0, 0.85, max(len(curves), 1)))
        for shade, result in zip(shades, curves, strict=False):
            y = np.asarray(result.curve)
            label = f"{result.name}, {result.steps}" if result.steps == last else None
            right.plot(np.linspace(0, 1, len(y)), y, color=shade, linewidth=0.9, label=label)
        right.set(xlabel="exact CDF", ylabel="ECDF − CDF", title=f"{self.verdict.value}: {self.kernel}"[:48])
        right.legend(fontsize=6, loc="best")
        return figure


def versions() -> dict[str, str]:
    """Of Python and of every package that may have had a part in the numbers."""
    found = {"python": platform.python_version()}
    for package in ("mcmc1d", "jax", "jaxlib", "equinox", "numpy", "scipy", "blackjax", "numpyro", "emcee"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _plain(value: Any) -> Any:
    """JSON has no infinities and no NaN: they become null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.value if isinstance(value, Enum) else int(value) if isinstance(value, np.integer) else value


def _steps(k: int) -> str:
    return "no step (the law's own sampler)" if k == 0 else _count(k, "step")


def _count(k: int, what: str) -> str:
    return f"{k} {what}{'' if k == 1 else 's'}"
