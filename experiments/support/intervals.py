"""Intervals of means over seeds, by Student's t."""

import numpy as np
from scipy.stats import sem
from scipy.stats import t as student

Ratio = tuple[float, float, float]
"""A ratio of two geometric means, and its interval."""
DECIDES = 1e-4
"""The probability with which an interval that decides misses the ratio; those that are shown are of 95 %."""


def half(values: np.ndarray) -> np.ndarray:
    """Half the width of the 95 % interval of the mean, over the last axis."""
    return student.ppf(0.975, values.shape[-1] - 1) * sem(values, axis=-1)


def paired(above: np.ndarray, below: np.ndarray, miss: float) -> Ratio:
    """The ratio of two geometric means over the same seeds, which share random numbers, missed with `miss`."""
    logs = np.log(above / below)
    middle, width = logs.mean(), student.isf(miss / 2, logs.size - 1) * sem(logs)
    return float(np.exp(middle)), float(np.exp(middle - width)), float(np.exp(middle + width))


def geometric(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The geometric mean over the last axis and its 95 % interval: errors of seeds are skewed."""
    width = half(np.log(values))
    middle = np.log(values).mean(-1)
    return np.exp(middle), np.exp(middle - width), np.exp(middle + width)


def ratio(above: np.ndarray, below: np.ndarray, miss: float = 0.05) -> Ratio:
    """The ratio of the geometric means of two independent sets of seeds, and the interval that misses it with `miss`.

    By Welch's t on their logarithms.
    """
    a, b = np.log(above), np.log(below)
    parts = a.var(ddof=1) / a.size, b.var(ddof=1) / b.size
    freedom = sum(parts) ** 2 / (parts[0] ** 2 / (a.size - 1) + parts[1] ** 2 / (b.size - 1))
    width = student.isf(miss / 2, freedom) * sum(parts) ** 0.5
    middle = a.mean() - b.mean()
    return float(np.exp(middle)), float(np.exp(middle - width)), float(np.exp(middle + width))


def under(limit: float, *ratios: Ratio) -> bool | None:
    """Whether all ratios are under the limit; None where their intervals do not decide it."""
    if all(high < limit for _, _, high in ratios):
        return True
    return False if any(low > limit for _, low, _ in ratios) else None


def over(limit: float, *ratios: Ratio) -> bool | None:
    """Whether all ratios are over the limit; None where their intervals do not decide it."""
    return under(1 / limit, *((1 / middle, 1 / high, 1 / low) for middle, low, high in ratios))


def shown(found: Ratio) -> str:
    """A ratio and its interval."""
    middle, low, high = found
    return f"{middle:.3g} [{low:.3g}, {high:.3g}]"
