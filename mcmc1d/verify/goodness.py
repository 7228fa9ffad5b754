"""Goodness of fit of independent draws to exact laws, with p-values that are valid far in the tail."""

import numpy as np
from scipy.special import ndtri
from scipy.stats import binom

from mcmc1d.checks import require


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
    return float(min(1.0, _binomial(counts, int(counts.sum()), masses / masses.sum()).min() * len(masses)))


def p_value(counts: np.ndarray, masses: np.ndarray) -> float:
    """Twice the smaller of the two p-values above: valid at every level, for gaps that are broad or narrow."""
    return min(1.0, 2 * min(dkw_p_value(counts, masses), cells_p_value(counts, masses)))


def sign_p_value(more: np.ndarray, less: np.ndarray) -> float:
    """The smallest exact p-value of any pair of counts that are exchangeable, times the number of pairs.

    Given more + less, `more` is binomial with probability 1/2 under the hypothesis: McNemar's test. Two samples are
    compared by it in pairs (in a cell where the other is not, and the reverse), and so are the first and last state
    of one chain (from a to b, and from b to a).
    """
    more, less = np.ravel(np.asarray(more, np.int64)), np.ravel(np.asarray(less, np.int64))
    require(more.shape == less.shape, f"{more.size} counts can not be paired with {less.size}")
    total = more + less
    if not total.any():
        return 1.0
    return float(min(1.0, _binomial(more, total, 0.5).min() * more.size))


def smallest_gap(n: int, level: float, miss: float = 0.01) -> float:
    """The smallest CDF gap that `p_value` under `level` detects among n draws with probability 1 - `miss`.

    (sqrt(ln(4 / level)) + z / sqrt 2) / sqrt(2 n), z the normal quantile of 1 - `miss`: the gap at which the DKW bound
    falls under half of `level` (`p_value` is two tests), and as much again as the count at the widest place may fall
    short by, a binomial of standard deviation sqrt(n) / 2 at most.
    """
    return float((np.sqrt(np.log(4 / level)) - ndtri(miss) / np.sqrt(2)) / np.sqrt(2 * n))


def smallest_cell_gap(n: int, level: float, cells: int, miss: float = 0.01) -> float:
    """As `smallest_gap`, in the probability of one of so many cells, by `cells_p_value` under `level`.

    The count in a cell has a standard deviation of sqrt(n) / 2 at most, be it right or wrong.
    """
    return float((-ndtri(level / (2 * cells)) - ndtri(miss)) / np.sqrt(4 * n))


def smallest_two_sample_gap(n: int, level: float, cuts: int, miss: float = 0.01) -> float:
    """As `smallest_gap`, for two samples of n compared by `sign_p_value` at so many cuts.

    The difference of the counts at a cut has a standard deviation of sqrt(n / 2) at most.
    """
    return float((-ndtri(level / (2 * cuts)) - ndtri(miss)) / np.sqrt(2 * n))


def total_variation(p: np.ndarray, q: np.ndarray) -> float:
    """Half the sum of the absolute differences of two laws on bins."""
    return float(np.abs(p - q).sum() / 2)


def expected_distance(error: np.ndarray) -> float:
    """The total variation that normal errors of these standard deviations make, on average."""
    return float(np.sqrt(2 / np.pi) * error.sum() / 2)


def _binomial(k: np.ndarray, n: np.ndarray | int, p: np.ndarray | float) -> np.ndarray:
    """Two-sided exact p-values: twice the smaller tail, the observed count in both."""
    return np.minimum(1.0, 2 * np.minimum(binom.cdf(k, n, p), binom.sf(np.asarray(k) - 1, n, p)))


def _checked(counts: np.ndarray, masses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    counts, masses = np.ravel(np.asarray(counts, np.float64)), np.ravel(np.asarray(masses, np.float64))
    require(counts.shape == masses.shape, f"{counts.size} counts can not be compared with {masses.size} masses")
    require(bool(np.all(counts >= 0)) and counts.sum() > 0, "counts must not be negative, and some must be positive")
    require(bool(np.all(masses >= 0)) and masses.sum() > 0, "masses must not be negative, and some must be positive")
    return counts, masses
