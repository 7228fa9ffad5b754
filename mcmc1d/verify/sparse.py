"""The linear algebra of a flux between cells: its stationary law, its leading eigenvalues, its Poisson equation."""

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg

from mcmc1d.checks import require

if TYPE_CHECKING:
    Matrix: TypeAlias = Any  # SciPy's stubs do not know the shape of a sparse matrix
else:
    Matrix: TypeAlias = sp.csr_matrix

_linalg: Any = scipy.sparse.linalg

_DENSE = 200
"""Matrices up to this size are solved densely: Lanczos and Arnoldi want room."""


def transition(flux: Matrix) -> Matrix:
    """The flux over its row sums; an empty row stays empty."""
    rows = np.asarray(flux.sum(1)).ravel()
    return sp.csr_matrix(sp.diags(np.divide(1, rows, out=np.zeros_like(rows), where=rows > 0)) @ flux)


def recurrent(flux: Matrix) -> tuple[np.ndarray, Matrix]:
    """The cells from which points start, again and again without those from which none does, and P on them.

    What flows into a cell in which no point started (its mass is under that of a point) is taken to stay out.
    """
    alive = np.arange(flux.shape[0])
    while True:
        rows = np.asarray(flux.sum(1)).ravel()
        if np.all(rows > 0):
            return alive, transition(flux)
        keep = np.flatnonzero(rows > 0)
        alive, flux = alive[keep], sp.csr_matrix(flux[keep][:, keep])


def eigenvalues(flux: Matrix, count: int) -> np.ndarray:
    """The `count` eigenvalues of P of the largest modulus, falling."""
    return _leading(recurrent(flux)[1], count)[0]


def stationary(flux: Matrix) -> np.ndarray:
    """The law mu with mu P = mu, zero in cells from which no point starts.

    Raises `ValueError` where the second eigenvalue, too, is of modulus one: then there are several, or a cycle.
    """
    alive, p = recurrent(flux)
    values, vectors = _leading(p, 2) if p.shape[0] > 1 else (np.ones(1), np.ones((1, 1)))
    require(
        len(values) < 2 or abs(values[1]) < 1 - 1e-9,
        "the kernel's law is not unique: it is reducible or periodic (two eigenvalues of modulus one)",
    )
    mu = np.zeros(flux.shape[0])
    vector = np.real(vectors[:, 0])
    mu[alive] = np.abs(vector) / np.abs(vector).sum()
    return mu


def poisson(flux: Matrix, mu: np.ndarray, g: np.ndarray) -> np.ndarray:
    """The sum over k >= 1 of P^k g, for a g whose mean in the law mu is zero."""
    alive, p = recurrent(flux)
    weights, here = mu[alive], g[alive] - mu[alive] @ g[alive]
    # The projection onto the constants makes the system regular and leaves the solution alone.
    system = _linalg.LinearOperator(p.shape, matvec=lambda z: z - p @ z + weights @ z, dtype=np.float64)
    z, failed = _linalg.gmres(system, here, rtol=1e-9, atol=0, restart=60, maxiter=100)
    require(not failed, "the Poisson equation was not solved: the kernel hardly mixes")
    result = np.zeros_like(g)
    result[alive] = z - here
    return result


def _leading(p: Matrix, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The leading eigenvalues of P, and the eigenvectors of its transpose."""
    if p.shape[0] <= _DENSE:
        values, vectors = np.linalg.eig(p.toarray().T)
    else:
        # From a law with mass everywhere; the same numbers at every run.
        start = np.ones(p.shape[0]) + 0.5 * np.random.default_rng(0).random(p.shape[0])
        try:
            values, vectors = _linalg.eigs(p.T.tocsr(), k=count, which="LM", v0=start, tol=1e-9, ncv=40, maxiter=2000)
        except _linalg.ArpackNoConvergence as error:
            raise ValueError("the kernel's law was not found: it is reducible, periodic, or hardly mixes") from error
    order = np.argsort(-np.abs(values))[:count]
    return values[order], vectors[:, order]
