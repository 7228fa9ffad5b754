"""The 1D multiplexed step: this library, a hand-written loop in C, Numba and NumPy."""

import functools
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import mcmc1d
from experiments.support.bench import Go
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import Move, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.numerics import limit
from mcmc1d.special import cos_turns, sin_turns
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Inversion, PiecewiseConstant, Tent, density_within, within
from mcmc1d.types import Scalar

CHAINS, STEPS, BINS = 8192, 8192, 100


class Contestant(NamedTuple):
    """One that is timed, and what an independent sample costs it in steps; NaN where that is not asked."""

    go: Go
    autocorrelation_time: float = float("nan")


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


def contestants(work: float) -> dict[str, Contestant]:
    """Those that can be had here: C needs a compiler, Numba the package."""
    target, move = multiplexed_step()
    steps = max(1, int(STEPS * work))
    found = {source: Contestant(library(target, move, steps, source)) for source in ("threefry", "hash32")}
    program = compiled_yardstick()
    if program is not None:
        found["C"] = Contestant(functools.partial(_in_c, program, max(2, int(20_000 * work))))
    try:
        from experiments.support.bench_numba import steps_per_second
    except ImportError:
        pass
    else:
        steps_per_second(64, 2, 0)  # compiles
        found["Numba"] = Contestant(lambda seed: steps_per_second(1024, max(1, int(2000 * work)), seed))
    found["NumPy"] = Contestant(lambda seed: _in_numpy(CHAINS, max(1, int(60 * work)), seed))
    return found


def library(target: mcmc1d.Multiplexed, move: Move | Kernel, steps: int, source: str, chains: int = CHAINS) -> Go:
    """The library's public `run`, with a histogram of its deposits, compiled."""
    start = mcmc1d.exact_start(jax.random.key(0), target, chains)
    estimators = {"x": mcmc1d.Histogram(BINS)}

    def go(seed: int) -> float:
        key = jax.random.key(seed)
        begin = time.process_time()
        run = mcmc1d.run(
            key, move, target, steps=steps, chains=chains, blocks=1, start=start, estimators=estimators, random=source
        )
        jax.block_until_ready(run.state)
        return chains * steps / (time.process_time() - begin)

    go(0)
    return go


@functools.cache
def compiled_yardstick() -> str | None:
    """The path of the C program, built for this processor; None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    program = Path(tempfile.mkdtemp(prefix="mcmc1d-")) / "yardstick"
    flags = ["-O3", "-march=native", "-ffast-math", "-Wno-psabi"]
    source = Path(__file__).with_name("yardstick.c")
    subprocess.run([compiler, *flags, str(source), "-o", str(program), "-lm"], check=True)
    return str(program)


def _in_c(program: str, steps: int, seed: int) -> float:
    """Steps per second of the C loop, which inherits the pinning."""
    command = [program, "12", str(steps), str(seed)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[0])


def _in_numpy(chains: int, steps: int, seed: int) -> float:
    """The step on arrays of chains in float32, as one would write it."""
    rng = np.random.default_rng(seed)
    f32 = np.float32
    u, t = rng.random(chains, f32), rng.integers(0, 3, chains)
    x = _sample(u, t)
    c, histogram = _density(x), np.zeros(BINS)
    begin = time.process_time()
    for _ in range(steps):
        u2 = u + f32(0.05) * rng.standard_normal(chains, f32)
        u2 -= np.floor(u2)
        change = rng.random(chains, f32)
        t2 = np.where(change < 0.3, np.minimum((change * 10).astype(int), 2), t)
        x2 = _sample(u2, t2)
        c2 = _density(x2)
        a = np.minimum(c2 / c, 1)
        for where, weight in ((x, 1 - a), (x2, a)):
            histogram += np.bincount(np.minimum((where * BINS).astype(int), BINS - 1), weight, BINS)
        yes = rng.random(chains, f32) < a
        u, t, x, c = np.where(yes, u2, u), np.where(yes, t2, t), np.where(yes, x2, x), np.where(yes, c2, c)
    seconds = time.process_time() - begin
    if abs(histogram.sum() / (chains * steps) - 1) > 1e-4:
        raise RuntimeError("bench: the NumPy step has lost deposits")
    return chains * steps / seconds


def _sample(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    tent = np.where(u < 0.5, np.sqrt(0.5 * u), 1 - np.sqrt(0.5 * (1 - u)))
    step = np.interp(u, [0, 0.1, 0.5, 0.65, 1], [0, 0.25, 0.5, 0.75, 1]).astype(u.dtype)
    x = np.float32(0.94076407) * np.sqrt(u + np.float32(1e-4)) - np.float32(0.0493469)
    turn = np.float32(2 * np.pi)
    for _ in range(3):
        error = x * (np.float32(0.6) + np.float32(0.4) * x) - np.sin(turn * x) * np.float32(0.07957747) - u
        x = np.clip(x - error / (np.float32(0.6) + np.float32(0.8) * x - np.float32(0.5) * np.cos(turn * x)), 0, 1)
    return np.where(t == 0, tent, np.where(t == 1, step, x))


def _density(x: np.ndarray) -> np.ndarray:
    turn = np.float32(2 * np.pi)
    sine, cosine = np.sin(turn * x), np.cos(turn * x)
    heights = np.array([0.4, 1.6, 0.6, 1.4], x.dtype)
    total = 4 * np.minimum(x, 1 - x) + heights[np.minimum((4 * x).astype(int), 3)]
    total += np.float32(0.6) + np.float32(0.8) * x - np.float32(0.5) * cosine
    return (1 + np.float32(1.8) * sine * cosine) / total
