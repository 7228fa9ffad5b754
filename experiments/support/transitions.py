"""Chains on a few states, as transition matrices."""

import numpy as np


def stationary(matrix: np.ndarray) -> np.ndarray:
    """The law that a transition matrix keeps."""
    n = len(matrix)
    system = np.concatenate([matrix.T - np.eye(n), np.ones((1, n))])
    return np.linalg.lstsq(system, np.concatenate([np.zeros(n), [1.0]]), rcond=None)[0]
