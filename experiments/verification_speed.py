"""How long a verdict takes, and which gap it is worth: right kernels and wrong ones, each at the default settings."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import blackjax
import emcee
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from mcmc1d.moves import LargeStep, Mixture, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.verify import HostKernel, Law, adapters, hard_target, laws, verify
from mcmc1d.verify.mutants.jumps import no_jacobian


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    seeds: int = 2
    """Seeds a kernel, one after the other: the first compiles."""
    cases: int = 3
    """Of this library's cases, how many."""
    libraries: bool = False
    """The kernels of other libraries too, which take most of the time; `in_the_wild` has more of them."""


PROFILES = {"quick": Config(), "paper": Config(seeds=5, cases=5, libraries=True)}


ALONE = True
"""It measures time: nothing may run beside it."""


class Case(NamedTuple):
    """A right kernel and a wrong one on the same law."""

    right: Any
    wrong: Any
    law: Any
    options: dict[str, Any]


def cases() -> dict[str, Case]:
    """Of this library, and a walk in JAX and in NumPy: all at the default settings."""
    line, space = laws.walls(), laws.lopsided()
    mixed = {"small": (0.7, SmallStep(0.1)), "jump": (0.3, ReversibleJump())}
    wrong = mixed | {"jump": (0.3, no_jacobian(ReversibleJump()))}
    naive = {"small": (0.8, no_jacobian(ReversibleJump()))}
    steps = {"large": (0.2, StepAndChange(LargeStep())), "small": (0.8, StepAndChange(SmallStep(0.1)))}
    return {
        "random walk, 1D": Case(_walk(line, 0.3, 1.0), _walk(line, 0.3, 1.1), line, {}),
        "NumPy walk, 1D": Case(_host_walk(1.0), _host_walk(1.1), laws.normal(1), {}),
        "reversible jumps": Case(Mixture(mixed), Mixture(wrong), hard_target(), {}),
        "random walk, 3D": Case(_walk(space, 0.8, 1.0), _walk(space, 0.8, 1.1), space, {}),
        "multiplexed MLT": Case(Mixture(steps), Mixture(steps | naive), hard_target(), {}),
    }


def foreign() -> dict[str, Case]:
    """Kernels of other libraries: what a step costs, and so the gap that a time buys, is theirs."""
    banana = laws.banana()
    return {
        "emcee, 3D": Case(
            _ensemble("StretchMove"), _ensemble("DESnookerMove"), laws.normal(3), {"gap": 0.02, "seconds": 55.0}
        ),
        "BlackJAX NUTS, 2D": Case(_nuts(banana, 1.0), _nuts(banana, 1.1), banana, {}),
    }


def _walk(law: Law, scale: float, power: float) -> Callable:
    """A random walk; of the wrong power the acceptance ratio, and so its law, are those of f^power."""
    log_f: Any = law.log_density

    def walk(key: Any, x: Any) -> Any:
        first, second = jax.random.split(key)
        y = x + scale * jax.random.normal(first, x.shape)
        return jnp.where(jnp.log(jax.random.uniform(second)) < power * (log_f(y) - log_f(x)), y, x)

    return walk


def _host_walk(power: float) -> HostKernel:
    def walk(rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
        y = x + 2 * rng.standard_normal(x.shape, np.float32)
        accepted = np.log1p(-rng.random(len(x))) < power * (x * x - y * y) / 2
        return np.where(accepted, y, x)

    return HostKernel(walk, name="NumPy walk")


def _ensemble(move: str) -> Any:
    """In ensembles of 32, the most that still show what walkers do to each other: a proposal costs the same for 8."""
    return adapters.emcee(getattr(emcee.moves, move)(), laws.normal(3), walkers=32)


def _nuts(law: Law, power: float) -> Any:
    log_f: Any = law.log_density
    return blackjax.nuts(lambda x: power * log_f(x), 0.4, jnp.ones(2))


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """Verify each, right and wrong."""
    todo = dict(list(cases().items())[: config.cases]) | (foreign() if config.libraries else {})
    shape = (len(todo), 2, config.seeds)
    seconds, gap, replicas, passed, failed = (np.zeros(shape) for _ in range(5))
    for row, case in enumerate(todo.values()):
        for column, kernel in enumerate((case.right, case.wrong)):
            for k in range(config.seeds):
                report = verify(kernel, case.law, seed=seed + k, **case.options)
                at = row, column, k
                seconds[at], gap[at], replicas[at] = report.seconds, report.gap, report.replicas
                passed[at], failed[at] = report.passed, report.verdict.value == "FAIL"
                progress("verifications", int(np.ravel_multi_index(at, shape)) + 1, int(np.prod(shape)))
    dimensions = ("kernel", "side", "seed")
    return xr.Dataset(
        {
            "seconds": (dimensions, seconds),
            "gap": (dimensions, gap),
            "replicas": (dimensions, replicas),
            "passed": (dimensions, passed),
            "failed": (dimensions, failed),
        },
        {"kernel": list(todo), "side": ["right", "wrong"]},
    )


def draw(data: xr.Dataset) -> Figure:
    """Seconds to a verdict: hollow the first, which compiles, filled those after it."""
    figure, axes = plt.subplots(figsize=(3.5, 2.2))
    y = np.arange(data.sizes["kernel"])
    for side, colour, mark, by in (("right", "C0", "o", -0.15), ("wrong", "C1", "X", 0.15)):
        own = data.sel(side=side).seconds
        first, later = own.isel(seed=0), own.isel(seed=slice(1, None)).median("seed")
        # What does not compile takes as long each time: the hollow mark is larger, and stands around the filled one.
        axes.plot(first, y + by, mark, color=colour, markersize=5.5, markerfacecolor="none", label=f"{side}, the first")
        axes.plot(later, y + by, mark, color=colour, markersize=3, label=f"{side}, compiled")
    axes.set_yticks(y, data.kernel.to_numpy(), fontsize=6)
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="seconds to a verdict", xlim=(0.1, 100))
    axes.legend(fontsize=6)
    return figure


def table(data: xr.Dataset) -> Table:
    """The first verdict, which compiles, the median of the others, and what they are worth."""
    result = Table(
        "kernel", "side", "first s", "then s", "gap", "replicas", title="verification_speed", box=SIMPLE, padding=0
    )
    for name in data.kernel.to_numpy():
        for side in ("right", "wrong"):
            here = data.sel(kernel=name, side=side)
            result.add_row(
                str(name),
                side,
                f"{float(here.seconds[0]):.1f}",
                f"{float(here.seconds[1:].median()):.1f}",
                f"{float(here.gap.median()):.4f}",
                f"{int(here.replicas.median()):,}",
            )
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """The verdicts; the seconds are the machine's."""
    right, wrong = data.sel(side="right"), data.sel(side="wrong")
    count = int(right.passed.size)
    times = right.seconds.isel(seed=slice(1, None)).median("seed").to_numpy()
    return [
        Claim(
            "verify.default-settings",
            "At the default settings right kernels pass and wrong ones fail, cheap ones within seconds",
            "ours",
            "holds" if bool((right.passed == 1).all() and (wrong.failed == 1).all()) else "fails",
            "holds",
            f"{int(right.passed.sum())} of {count} pass, {int(wrong.failed.sum())} of {count} fail; "
            f"{times.min():.1f} to {times.max():.0f} s",
            f"level 1e-5; gaps {float(right.gap.min()):.4f} to {float(right.gap.max()):.3f}",
        )
    ]
