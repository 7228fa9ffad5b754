"""A random walk on a law's own density, from the law's own draws: where it leaves them, the kernel may be right."""

import time
from functools import partial
from typing import Any

import jax
import numpy as np
from scipy.stats import iqr, ks_2samp

from mcmc1d.verify.battery import coordinates
from mcmc1d.verify.sampler import Sampler, inside

_REPLICAS, _STEPS = 2**14, 32
_SMALLEST = 0.03  # of the steps' sizes, which are drawn evenly on a logarithmic scale up to a coordinate's own spread
_SECONDS = 5.0  # what the walk may take
_LEVEL = 1e-9  # at which a law is said to contradict itself that does not
_DISTINCT = 0.99  # of a coordinate's draws, without which it has atoms, and no step has a density
_FLAT = 1e-6  # the least eigenvalue of a correlation, under which the law lives on a plane


def doubts(sampler: Sampler) -> list[str]:
    """A line where the log-density is not that of the draws; for a right one that is said with a probability of 1e-9.

    Metropolis's walk, inside of the draws' range, keeps whatever law has the density. It shows what is off by some 0.04
    of a CDF after 32 steps, of a coordinate or of the log-density.
    """
    law, density = sampler.law, sampler.energy
    if density is None or law.auxiliary:
        return []
    drawn = sampler.draw("diagnosis", 1, 0, 2 * _REPLICAS)
    start, fresh = (jax.tree.map(lambda a, part=part: a[part::2], drawn) for part in (0, 1))
    known = coordinates(fresh)
    names = [name for name, values in known.items() if _continuous(values)]
    if not names or _flat([known[name] for name in names]):
        return []
    rng = np.random.default_rng(sampler.words("diagnosis", 2))
    lower, upper = (jax.tree.map(lambda a, end=end: end(a, axis=0), drawn) for end in (np.min, np.max))
    spread = jax.tree.map(_spread, drawn)
    there = density(fresh)  # and compiled
    began = time.perf_counter()
    now, where = density(start), start
    if time.perf_counter() - began > _SECONDS / _STEPS:
        return []
    for _ in range(_STEPS):
        with np.errstate(over="ignore"):  # of a heavy tail
            after = jax.tree.map(lambda a, size: _stepped(a, size, rng), where, spread)
        within = inside(law, after, sampler.slack)
        for a, low, high in zip(*map(jax.tree.leaves, (after, lower, upper)), strict=True):
            within &= ((a >= low) & (a <= high)).reshape(len(a), -1).all(1)
        then = density(after)
        with np.errstate(all="ignore"):
            taken = (np.log(1 - rng.random(len(now))) < then - now) & within
        now = np.where(taken, then, now)
        where = jax.tree.map(partial(_chosen, taken), after, where)
    walked = coordinates(where)
    pairs = {name: (walked[name], known[name]) for name in names} | {"the log density": (now, there)}
    test: Any = ks_2samp
    p, worst = min((float(test(*pair).pvalue), name) for name, pair in pairs.items())
    if p * len(pairs) > _LEVEL:
        return []
    return [
        f"a random walk on the law's log_density, from the law's own draws, leaves their law too (that of {worst}: "
        f"p = {p:.0e}): log_density or sample is wrong, unless the law lives on a curve or a surface"
    ]


def _continuous(values: np.ndarray) -> bool:
    return values.dtype.kind == "f" and len(np.unique(values)) > _DISTINCT * len(values)


def _flat(columns: list[np.ndarray]) -> bool:
    """Whether they lie on a plane."""
    with np.errstate(all="ignore"):
        found = np.corrcoef(np.asarray(columns, np.float64))
    return len(columns) > 1 and bool(np.isfinite(found).all() and np.linalg.eigvalsh(found)[0] < _FLAT)


def _spread(a: np.ndarray) -> np.ndarray:
    """Of each coordinate; zero of those that have atoms, and do not move."""
    columns = a.reshape(len(a), -1).T
    return np.reshape([iqr(column) if _continuous(column) else 0.0 for column in columns], a.shape[1:])


def _stepped(a: np.ndarray, spread: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each row moved by a normal step of its own size."""
    if not spread.any():
        return a
    size = _SMALLEST ** rng.random((len(a), *(1,) * (a.ndim - 1)))
    return (a + size * spread * rng.standard_normal(a.shape)).astype(a.dtype)


def _chosen(taken: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rows of a where they were taken, else those of b."""
    return np.where(taken.reshape(-1, *(1,) * (a.ndim - 1)), a, b)
