"""Goodness of fit of independent draws to exact bin masses, with p-values that are valid far in the tail."""

import numpy as np
from scipy.stats import binom

from mcmc1d.numerics import require


def dkw_p_value(counts: np.ndarray, masses: np.ndarray) -> float:
    """P(a gap in the CDF this large), by the Dvoretzky-Kiefer-Wolfowitz bound with Massart's constant: 2 exp(-2 n g^2).

    `counts` and `masses` are arrays of one shape, of bins. The gap is looked up at the bins' ends, in the arrays'
    order; the bound holds at every n and every level.
    """
    counts, masses = _checked(counts, masses)
    n = counts.sum()
    return float(min(1.0, 2 * np.exp(-2 * n * cdf_gap(counts, masses) ** 2)))


def cdf_gap(counts: np.ndarray, masses: np.ndarray) -> float:
    """The largest difference of the two cumulative distribution functions at the bins' ends."""
    counts, masses = _checked(counts, masses)
    return float(np.abs(np.cumsum(counts / counts.sum() - masses / masses.sum())).max())


def cells_p_value(counts: np.ndarray, masses: np.ndarray) -> float:
    """The smallest exact two-sided binomial p-value of any bin, times the number of bins (the union bound)."""
    counts, masses = _checked(counts, masses)
    n, p = int(counts.sum()), masses / masses.sum()
    tail = np.minimum(binom.cdf(counts, n, p), binom.sf(counts - 1, n, p))
    return float(min(1.0, 2 * tail.min() * len(p)))


def p_value(counts: np.ndarray, masses: np.ndarray) -> float:
    """Twice the smaller of the two p-values above: valid at every level, for gaps that are broad or narrow."""
    return min(1.0, 2 * min(dkw_p_value(counts, masses), cells_p_value(counts, masses)))


def smallest_gap(n: int, level: float, miss: float = 0.01) -> float:
    """The smallest CDF gap that `p_value` under `level` detects among n draws with probability 1 - `miss`.

    (sqrt(ln(2 / a)) + sqrt(ln(2 / miss))) / sqrt(2 n), with a half of `level` for the two tests of `p_value`.
    """
    return float((np.sqrt(np.log(4 / level)) + np.sqrt(np.log(2 / miss))) / np.sqrt(2 * n))


def total_variation(p: np.ndarray, q: np.ndarray) -> float:
    """Half the sum of the absolute differences of two laws on bins."""
    return float(np.abs(p - q).sum() / 2)


def _checked(counts: np.ndarray, masses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    counts, masses = np.ravel(np.asarray(counts, np.float64)), np.ravel(np.asarray(masses, np.float64))
    require(counts.shape == masses.shape, f"{counts.size} counts can not be compared with {masses.size} masses")
    require(bool(np.all(counts >= 0)) and counts.sum() > 0, "counts must not be negative, and some must be positive")
    require(bool(np.all(masses >= 0)) and masses.sum() > 0, "masses must not be negative, and some must be positive")
    return counts, masses
