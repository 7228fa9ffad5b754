"""Released kernels of BlackJAX, NumPyro and emcee on hard targets: which keep the law, and how sure that is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import blackjax
import emcee
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpyro.infer import HMC, NUTS, BarkerMH
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from experiments.support.verdict import detects
from mcmc1d import verify
from mcmc1d.verify import Law, Report, laws
from mcmc1d.verify.report import versions


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    seconds: float = 10.0
    """What a first stage may take: the gap that it buys is part of the result."""
    kernels: str = "random walk; HMC, lopsided; StretchMove, 3D normal; DESnookerMove, 3D normal"
    """Names, apart by semicolons, or "all"."""


PROFILES = {"quick": Config(), "paper": Config(seconds=40.0, kernels="all")}


def kernels() -> dict[str, tuple[str, Callable[[Law], Any], Callable[[], Law]]]:
    """Name -> (library, the kernel for a law, the law)."""

    def mass(law: Law) -> Any:
        return jnp.ones(np.shape(law.sample(np.random.default_rng(0), 1))[1:])

    def potential(law: Law) -> Any:
        return lambda x: -law.log_density(x)  # pyright: ignore[reportOptionalCall]

    fixed = {"adapt_step_size": False}
    return {
        "random walk": ("blackjax", lambda law: blackjax.rmh(law.log_density, _normal_step(0.7)), laws.lopsided),
        "MALA": ("blackjax", lambda law: blackjax.mala(law.log_density, 0.1), laws.lopsided),
        "Barker": ("blackjax", lambda law: blackjax.barker(law.log_density, 0.6), laws.ridge),
        "HMC, banana": ("blackjax", lambda law: blackjax.hmc(law.log_density, 0.25, mass(law), 6), laws.banana),
        "NUTS, banana": ("blackjax", lambda law: blackjax.nuts(law.log_density, 0.4, mass(law)), laws.banana),
        "HMC, lopsided": (
            "numpyro",
            lambda law: HMC(
                potential_fn=potential(law), step_size=0.3, trajectory_length=1.5, **fixed, adapt_mass_matrix=False
            ),
            laws.lopsided,
        ),
        "NUTS, ridge": (
            "numpyro",
            lambda law: NUTS(potential_fn=potential(law), step_size=0.4, **fixed, adapt_mass_matrix=False),
            laws.ridge,
        ),
        "BarkerMH": (
            "numpyro",
            lambda law: BarkerMH(potential_fn=potential(law), step_size=0.6, **fixed, adapt_mass_matrix=False),
            laws.banana,
        ),
        "StretchMove": ("emcee", lambda _: emcee.moves.StretchMove(), laws.lopsided),
        "WalkMove": ("emcee", lambda _: emcee.moves.WalkMove(), laws.lopsided),
        "DEMove": ("emcee", lambda _: emcee.moves.DEMove(), laws.lopsided),
        "StretchMove, 3D normal": ("emcee", lambda _: emcee.moves.StretchMove(), lambda: laws.normal(3)),
        "DESnookerMove, 3D normal": ("emcee", lambda _: emcee.moves.DESnookerMove(), lambda: laws.normal(3)),
        "DESnookerMove, lopsided": ("emcee", lambda _: emcee.moves.DESnookerMove(), laws.lopsided),
    }


def _normal_step(scale: float) -> Callable:
    from jax import random

    return lambda key, x: x + scale * random.normal(key, x.shape)


WRONG = ("DESnookerMove, 3D normal", "DESnookerMove, lopsided")
"""dfm/emcee #531; the others are right as far as is known."""


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Verify each."""
    known = kernels()
    names = list(known) if config.kernels == "all" else [name.strip() for name in config.kernels.split(";")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"there is no kernel {unknown[0]!r}; known: {'; '.join(known)}")
    todo = {name: known[name] for name in names}
    reports: list[Report] = []
    for k, (_, make, target) in enumerate(todo.values()):
        law = target()
        reports.append(verify.verify(make(law), law, seed=seed, seconds=config.seconds))
        progress("released kernels", k + 1, len(todo))
    found = versions()
    return xr.Dataset(
        {
            "library": ("kernel", [f"{library} {found.get(library, '')}" for library, _, _ in todo.values()]),
            "law": ("kernel", [report.law for report in reports]),
            "verdict": ("kernel", [report.verdict.value for report in reports]),
            "gap": ("kernel", [report.gap for report in reports]),
            "p_value": ("kernel", [report.p_value for report in reports]),
            "replicas": ("kernel", [report.replicas for report in reports]),
            "seconds": ("kernel", [report.seconds for report in reports]),
            "reason": ("kernel", ["; ".join(report.reasons) for report in reports]),
        },
        {"kernel": list(todo)},
    )


def draw(data: xr.Dataset) -> Figure:
    """The gap that each verdict is worth, and the verdict."""
    figure, axes = plt.subplots(figsize=(3.5, 2.9))
    y = np.arange(data.sizes["kernel"])
    colours = {"PASS": "C0", "FAIL": "C1", "INCONCLUSIVE": "0.6"}
    marks = {"PASS": "o", "FAIL": "X", "INCONCLUSIVE": "s"}
    verdicts = data.verdict.to_numpy()
    for verdict, colour in colours.items():
        own = verdicts == verdict
        if own.any():
            axes.plot(data.gap.to_numpy()[own], y[own], marks[verdict], color=colour, markersize=4.5, label=verdict)
    axes.hlines(y, 1e-3, data.gap.to_numpy(), color="0.85", linewidth=0.7, zorder=0)
    names = [
        f"{str(library).partition(' ')[0]} {kernel}"
        for library, kernel in zip(data.library.to_numpy(), data.kernel.to_numpy(), strict=True)
    ]
    axes.set_yticks(y, names, fontsize=5.5)
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="smallest CDF gap detected with probability 0.99", xlim=(3e-3, 0.2))
    axes.legend(loc="upper right", fontsize=6)
    return figure


def table(data: xr.Dataset) -> Table:
    """Verdict, what it is worth, what it took."""
    result = Table(
        "library", "kernel", "verdict", "gap", "p", "replicas", "s", title="in_the_wild", box=SIMPLE, padding=0
    )
    for k, name in enumerate(data.kernel.to_numpy()):
        here = data.isel(kernel=k)
        result.add_row(
            str(here.library.to_numpy()),
            f"{name}",
            str(here.verdict.to_numpy()),
            f"{float(here.gap):.4f}",
            f"{float(here.p_value):.1g}",
            f"{int(here.replicas):,}",
            f"{float(here.seconds):.0f}",
        )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """The snooker move fails, and the others pass."""
    claims = []
    for k, name in enumerate(data.kernel.to_numpy()):
        here = data.isel(kernel=k)
        verdict = str(here.verdict.to_numpy())
        wrong = str(name) in WRONG
        outcomes = {"FAIL" if wrong else "PASS": "holds", "INCONCLUSIVE": "open"}
        library = str(here.library.to_numpy())
        claims.append(
            Claim(
                f"wild.{library.partition(' ')[0]}-{str(name).lower().replace(', ', '-').replace(' ', '-')}",
                f"{library}: {name} {'does not keep' if wrong else 'keeps'} the law ({here.law.to_numpy()})",
                "dfm/emcee #531" if wrong else library,
                outcomes.get(verdict, "fails"),
                "holds",
                f"{verdict}, p {float(here.p_value):.2g}, {int(here.replicas):,} replicas",
                detects(here.gap),
            )
        )
    return claims
