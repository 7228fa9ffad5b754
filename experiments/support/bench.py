"""The speed of the 1D multiplexed step through the public classes, as a share of a hand-written C loop."""

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import mcmc1d
from mcmc1d.moves import SmallStep, StepAndChange, TechniqueChange
from mcmc1d.numerics import cos_turns, limit, sin_turns
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Inversion, PiecewiseConstant, Tent, density_within, within
from mcmc1d.types import Scalar

CHAINS, STEPS, BINS = 8192, 4096, 100


class Smooth(Inversion):
    """The density 0.6 + 0.8 x - 0.5 cos(2 pi x), its distribution function inverted by three Newton steps."""

    def quantile(self, u: Scalar) -> Scalar:
        """Right to float32, from a square root that is near."""
        x = 0.94076407 * jnp.sqrt(u + 1e-4) - 0.0493469
        for _ in range(3):
            x = limit(x - (self.cdf(x) - u) / self._density(x), 0, 1)
        return x

    def cdf(self, x: Scalar) -> Scalar:
        """The integral of the density from 0."""
        return x * (0.6 + 0.4 * x) - sin_turns(x) * (0.25 / np.pi)

    def log_prob(self, x: Scalar) -> Scalar:
        """The log-density."""
        return within(x, jnp.log(self._density(x)))

    def prob(self, x: Scalar) -> Scalar:
        """The density."""
        return density_within(x, self._density(x))

    def _density(self, x: Scalar) -> Scalar:
        return 0.6 + 0.8 * x - 0.5 * cos_turns(x)


def multiplexed_step() -> tuple[mcmc1d.Multiplexed, StepAndChange]:
    """The yardstick's target and move: sigma 0.05, the technique drawn afresh with probability 0.3."""
    step = PiecewiseConstant([0, 0.25, 0.5, 0.75, 1], [0.4, 1.6, 0.6, 1.4])
    target = mcmc1d.Multiplexed(Sinusoid(0.9, 2.0), (Tent(), step, Smooth()))
    return target, StepAndChange(SmallStep(0.05), TechniqueChange(0.7 * np.eye(3) + 0.1))


def measure(rounds: int) -> dict[str, Any]:
    """Alternating rounds of C and of this library on one pinned core, and the medians of their steps per second.

    Which cores the process may use is afterwards what it was.
    """
    pinned = hasattr(os, "sched_setaffinity")
    if not pinned:
        return _measure(rounds) | {"pinned to one core": False}
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        return _measure(rounds) | {"pinned to one core": True}
    finally:
        os.sched_setaffinity(0, cores)


def _measure(rounds: int) -> dict[str, Any]:
    target, move = multiplexed_step()
    start = mcmc1d.exact_start(jax.random.key(0), target, CHAINS)
    estimators = {"x": mcmc1d.Histogram(BINS)}

    def here(seed: int) -> float:
        begin = time.perf_counter()
        run = mcmc1d.run(
            jax.random.key(seed), move, target, steps=STEPS, chains=CHAINS, blocks=1, start=start, estimators=estimators
        )
        jax.block_until_ready(run.state)
        return CHAINS * STEPS / (time.perf_counter() - begin)

    here(0)  # compiles
    with tempfile.TemporaryDirectory() as folder:
        program = _compile(Path(folder))
        pairs = [(here(seed), _in_c(program, seed)) for seed in range(1, rounds + 1)]
    ours, theirs = (median(side) for side in zip(*pairs, strict=True))
    return {
        "ratio to C": ours / theirs if program else "no C compiler found",
        "steps/s": ours,
        "steps/s in C": theirs,
        "rounds": rounds,
        "chains": CHAINS,
        "jax": jax.__version__,
    }


def _compile(folder: Path) -> Path | None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    program = folder / "yardstick"
    source = Path(__file__).with_name("yardstick.c")
    flags = ["-O3", "-march=native", "-ffast-math", "-Wno-psabi"]
    subprocess.run([compiler, *flags, str(source), "-o", str(program), "-lm"], check=True)
    return program


def _in_c(program: Path | None, seed: int) -> float:
    """Steps per second of the C loop, which inherits the pinning."""
    if program is None:
        return float("nan")
    command = [str(program), "12", "60000", str(seed)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[0])
