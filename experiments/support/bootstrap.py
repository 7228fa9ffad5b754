"""Runs whose errors have long tails: ratios of means and of standard deviations, and means of many pixels at once.

By the studentised bootstrap (Efron and Tibshirani 1993, sections 12.5 and 16.4), which follows the skewness of a mean.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

DRAWS = 30_000
"""Resamples; of an interval that is missed with 1 in 3000, five on either side lie beyond it."""
_ROWS = 1024


class Ratios(NamedTuple):
    """Ratio, lower and upper end of its interval: (cases, 3).

    Of 200 errors that are lognormal intervals of means miss as often as asked; of deviations half as often again where
    the logarithm's is 0.5, and up to twice as often where it is 1.
    """

    means: np.ndarray
    deviations: np.ndarray


def ratios(above: np.ndarray, below: np.ndarray, miss: float, draws: int = DRAWS) -> Ratios:
    """Of two independent sets of runs, (cases, runs) each: the intervals miss a ratio with probability `miss`."""
    found = _logs(above.T), _logs(below.T)
    value, error = _difference(*found)
    stray = [
        (log - value) / noise
        for log, noise in (
            _difference(_logs(above.T, upper), _logs(below.T, lower))
            for upper, lower in zip(_weights(above.shape[1], draws, 0), _weights(below.shape[1], draws, 1), strict=True)
        )
    ]
    least, most = np.quantile(np.concatenate(stray, 1), [miss / 2, 1 - miss / 2], axis=1)
    value, error = value[:, 0], error[:, 0]
    return Ratios(*np.exp(np.stack([value, value - most * error, value - least * error], -1)))


def critical(values: np.ndarray, miss: float, draws: int = DRAWS) -> float:
    """How many standard errors any of the means of `values`, (runs, pixels), strays at most, but with `miss`."""
    values = values - values.mean(0)
    lit = values[:, values.var(0) > 0]
    worst = []
    for weights in _weights(len(values), draws, 2):
        mean, square = weights @ lit, weights @ lit**2
        error = np.sqrt((square - mean**2) / (len(values) - 1))
        worst.append(np.max(np.abs(mean) / np.maximum(error, np.finfo(float).tiny), axis=1))
    return float(np.quantile(np.concatenate(worst), 1 - miss))


def _weights(runs: int, draws: int, seed: int) -> Iterator[np.ndarray]:
    """The share of each run in each resample: parts of (draws, runs)."""
    rng = np.random.default_rng(seed)
    for first in range(0, draws, _ROWS):
        rows = min(_ROWS, draws - first)
        taken = rng.integers(runs, size=(rows, runs)) + runs * np.arange(rows)[:, None]
        yield np.bincount(taken.ravel(), minlength=rows * runs).reshape(rows, runs) / runs


def _logs(values: np.ndarray, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The logarithms of mean and standard deviation, of (runs, cases), and their variances: each (2, rows, cases)."""
    runs = len(values)
    weights = np.full((1, runs), 1 / runs) if weights is None else weights
    scale = values.mean(0)
    first, second, third, fourth = (weights @ (values / scale - 1) ** k for k in (1, 2, 3, 4))
    mean, variance = 1 + first, second - first**2
    moment = fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4
    logs = np.stack([np.log(mean * scale), np.log(variance * scale**2) / 2])
    return logs, np.stack([variance / mean**2, (moment / variance**2 - 1) / 4]) / runs


def _difference(above: tuple[np.ndarray, ...], below: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    return above[0] - below[0], np.sqrt(above[1] + below[1])


__all__ = ["DRAWS", "Ratios", "critical", "ratios"]
