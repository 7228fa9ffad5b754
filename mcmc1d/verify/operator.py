"""The transition operator of a kernel on cells: the law that a wrong kernel will have, and how it mixes.

Ulam's method, with the target's own law inside each cell (Froyland 2001): no chain is run, so there is no burn-in and
no autocorrelation, and a law is predicted to a few 1e-4 of total variation in seconds.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.special import gammaln

from mcmc1d.checks import require, require_instance, rising, traced
from mcmc1d.metropolis import Kernel, as_kernel
from mcmc1d.moves import Move
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.state import Multiplexed
from mcmc1d.verify.flux import Flux, Starts, measure
from mcmc1d.verify.goodness import expected_distance
from mcmc1d.verify.outcomes import KernelFlux, StepFlux, find_atoms
from mcmc1d.verify.sparse import Matrix, eigenvalues, poisson, stationary, transition

DEFAULT_U = {1: 200, 2: 40, 3: 12}
"""Intervals along each coordinate of u, by how many there are."""
DEFAULT_X = {1: 200, 2: 100, 3: 40}
"""Intervals of a scalar x, which cut the same cells again: a jump keeps x, and must not seem to diffuse in it."""


_PROBES = 2**12
"""Of a plain density, for its largest logarithm."""
_UNKNOWN = 0.1
"""Noise from which on a law is none, and mass below zero that extrapolation does not explain."""


class PredictedLaw(NamedTuple):
    """A predicted law on bins, of shape (n_index, bins), and what it may be off by."""

    masses: np.ndarray
    standard_error: np.ndarray
    """Of each mass, from the spread over the independent scrambles of the net (few: roughly); without the grid's."""
    noise: float
    """The total variation that these standard errors amount to, in expectation."""
    grid: float
    """The total variation by which the extrapolation to cells of no width has moved the law.

    What is left is far less where the kernel's law over the target's is smooth inside the cells, and up to some two
    or three times this where it is not, as at a wall at which one of the two vanishes (of an error that falls as the
    cells' width; six or seven times of one that falls as its root, at a pole like 1 / sqrt(x)): more points do not
    help, more cells do.
    """


class Asymmetry(NamedTuple):
    """How far a flux is from its transpose: half the sum of the absolute differences, and the same of mere noise."""

    residual: float
    """The probability with which, in the target's law, one can tell (first, last) from (last, first), cell by cell."""
    noise: float
    """What the spread over the scrambles makes of a residual that is zero in truth."""
    pairs: Matrix
    """F - F^T of the mean flux, by pair of cells."""
    by_kind: dict[str, tuple[float, float]]
    """(residual, noise) of each kind of move, between coarse cells (index, tenth of the first coordinate)."""

    @property
    def excess(self) -> float:
        """The largest residual in units of its noise, over all kinds; about 1 for a reversible kernel."""
        return max(residual / max(noise, 1e-300) for residual, noise in self.by_kind.values())


Function = Callable[[np.ndarray], np.ndarray]
"""A function g of x, called with many points at once; in several dimensions x has a trailing axis."""


@dataclass(frozen=True, repr=False)
class Operator:
    """The flux F_ab of mass from cell a to cell b in one step from the target's law, and P = F / row sums.

    What a cell is, and what it can not see: an error in the law arises only where the kernel's law differs from the
    target's inside a cell, at the second order of the cell's width (the first, where the ratio of the two jumps
    inside cells). A law that charges single values of u, as a fixed-point inverse makes them, has cells of their own
    for these values; one that charges a curve has not.
    """

    flux: Flux

    def __repr__(self) -> str:
        return f"<Operator on {len(self.flux.cells.used)} cells, of the moves {', '.join(self.flux.kinds)}>"

    @cached_property
    def mean_flux(self) -> Matrix:
        """F, of shape (n, n), the mean over the scrambles."""
        return sp.csr_matrix(sum(self.flux.scrambles[1:], self.flux.scrambles[0]) / len(self.flux.scrambles))

    @cached_property
    def masses(self) -> np.ndarray:
        """The target's law on the n cells, from the same net; zero on the cells of atoms."""
        rows = np.asarray(self.mean_flux.sum(1)).ravel() * ~self.flux.cells.atomic
        return rows / rows.sum()

    @cached_property
    def matrix(self) -> Matrix:
        """P, of shape (n, n): rows that sum to one, empty in the few cells where no point of the net starts."""
        return transition(self.mean_flux)

    def stationary(self) -> np.ndarray:
        """The law on the n cells that the kernel keeps, right or wrong.

        Raises `ValueError` where it keeps several, or runs through them in turn.
        """
        return stationary(self.mean_flux)

    def law_of(self, edges: ArrayLike, function: Function | None = None) -> PredictedLaw:
        """The law of (index, x), or of (index, function(x)), that the kernel keeps, on the bins between `edges`.

        Extrapolated to cells of no width from these cells and from cells twice as wide, whose flux is the same net's.
        Raises `ValueError` where the net was too small to find it.
        """
        edges = rising(np.asarray(edges, np.float64), "law_of")
        # Each scramble's own starts say how x lies inside the cells, so that its law is independent of the others'.
        insides = [self._inside(edges, function, starts) for starts in self.flux.points]
        fine, coarse = np.arange(self.mean_flux.shape[0]), self.flux.cells.coarser()

        def law(flux: Matrix, inside: Matrix, labels: np.ndarray) -> np.ndarray:
            group = sp.csr_matrix((np.ones(len(labels)), (labels, np.arange(len(labels)))))
            spread = group @ inside
            rows = np.asarray(spread.sum(1)).ravel()
            mu = stationary(sp.csr_matrix(group @ flux @ group.T))
            shares = np.asarray(np.divide(mu, rows, out=np.zeros_like(mu), where=rows > 0) @ spread)
            return (shares / shares.sum()).reshape(self.flux.cells.n_index, -1)

        def extrapolated(flux: Matrix, inside: Matrix) -> tuple[np.ndarray, np.ndarray]:
            here = law(flux, inside, fine)
            return (4 * here - law(flux, inside, coarse)) / 3, here

        each = np.stack([extrapolated(*own)[0] for own in zip(self.flux.scrambles, insides, strict=True)])
        masses, here = extrapolated(self.mean_flux, sp.csr_matrix(sum(insides[1:], insides[0])))
        error = each.std(0, ddof=1) / _c4(len(each)) / np.sqrt(len(each))
        noise = expected_distance(error)
        require(
            noise < _UNKNOWN and masses.min() > -_UNKNOWN,
            f"the law was not found: the net's scrambles differ by {noise:.2g} of total variation, and the least "
            f"mass is {masses.min():.2g}: raise `points` or take fewer cells",
        )
        return PredictedLaw(masses, error, noise, float(np.abs(masses - here).sum() / 2))

    def detailed_balance_residual(self) -> Asymmetry:
        """F - F^T, which is zero for a reversible kernel: by pair of cells, in all, and by kind of move.

        A right kernel need not be reversible (a cycle is not). The kinds' stays are left out, and so are the starts
        in the cells of atoms, which the target's law does not charge.
        """
        keep = sp.diags((~self.flux.cells.atomic).astype(np.float64))
        differences = [sp.csr_matrix(keep @ flux - (keep @ flux).T) for flux in self.flux.scrambles]
        mean = sp.csr_matrix(sum(differences[1:], differences[0]) / len(differences))
        spread = sum(abs(d - mean).power(2) for d in differences)
        kinds = {}
        for k, name in enumerate(self.flux.kinds):
            odd = self.flux.by_kind[:, k] - self.flux.by_kind[:, k].transpose(0, 2, 1)
            kinds[name] = (float(np.abs(odd.mean(0)).sum() / 2), self._noise(((odd - odd.mean(0)) ** 2).sum(0)))
        return Asymmetry(float(abs(mean).sum() / 2), self._noise(sp.csr_matrix(spread).data), mean, kinds)

    def _noise(self, squares: np.ndarray) -> float:
        """Half the expected sum of absolute means, from sums of squared deviations over the scrambles."""
        r = len(self.flux.scrambles)
        return expected_distance(np.sqrt(squares / (r - 1) / r)) / _c4(r)

    def spectral_gap(self) -> float:
        """1 - |lambda_2|, of P: the rate at which what is left of the start decays.

        Of the chain on cells, which forgets where inside a cell it was: too large for a kernel that is slow on a scale
        below the cells', as one of multiplicative steps near a wall. Finer cells show whether it is. Too small from few
        points: of a kernel that forgets everything at once, whose gap is 1, 2**12 of them make 0.85, 2**15 make 0.95
        and 2**18 0.99 (on 200 cells).
        """
        return 1 - abs(eigenvalues(self.mean_flux, 2)[1])

    def integrated_autocorrelation_time(self, g: Function | ArrayLike) -> float:
        """1 + 2 times the sum of the autocorrelations of g along a stationary chain, whether reversible or not.

        `g`: a function of x, or its values on the cells.
        """
        variance, covariances = self._moments(g)
        return 1 + 2 * covariances / variance

    def asymptotic_variance(self, g: Function | ArrayLike) -> float:
        """The variance of the mean of g over n steps, times n, as n grows: Var(g) times the autocorrelation time.

        Of plain deposits, that is, one state a step.
        """
        variance, covariances = self._moments(g)
        return variance + 2 * covariances

    def _moments(self, g: Function | ArrayLike) -> tuple[float, float]:
        """Var(g), and the sum of the covariances at the lags from 1 on, in the kernel's own law."""
        mu = self.stationary()
        if callable(g):
            cell, _, x, weight = (np.concatenate(parts) for parts in zip(*self.flux.points, strict=True))
            y = np.asarray(g(x), np.float64)
            require(y.shape == cell.shape, f"g must map x of shape {x.shape} to numbers of shape {cell.shape}")
            count = len(mu)
            rows = np.bincount(cell, weight, count)
            rows = np.where(rows > 0, rows, 1)
            mean, square = (np.bincount(cell, weight * part, count) / rows for part in (y, y * y))
        else:
            mean = np.asarray(g, np.float64)
            require(mean.shape == mu.shape, f"g has shape {mean.shape}; there are {mu.size} cells")
            square = mean * mean
        centre = mu @ mean
        variance = float(mu @ square - centre**2)
        return variance, float((mu * (mean - centre)) @ poisson(self.mean_flux, mu, mean - centre))

    def _inside(self, edges: np.ndarray, function: Function | None, starts: Starts) -> Matrix:
        """The weight of the kept starts by (cell, index and bin): how x is spread inside each cell."""
        cell, index, x, weight = starts
        y = np.asarray(x if function is None else function(x), np.float64)
        require(y.shape == cell.shape, f"law_of: x has shape {x.shape[1:]}; give a function of it that is a scalar")
        n, bins = self.mean_flux.shape[0], len(edges) - 1
        inside = (y >= edges[0]) & (y <= edges[-1])
        require(bool(inside.all()), f"law_of: the edges [{edges[0]}, {edges[-1]}] leave out {y[~inside][:1]}")
        place = np.clip(np.searchsorted(edges, y, side="right") - 1, 0, bins - 1)
        return sp.coo_matrix((weight, (cell, index * bins + place)), shape=(n, self.flux.cells.n_index * bins)).tocsr()


def _c4(n: int) -> float:
    """By how much the sample standard deviation of n normal numbers falls short of theirs, in expectation."""
    return float(np.sqrt(2 / (n - 1)) * np.exp(gammaln(n / 2) - gammaln((n - 1) / 2)))


def transition_operator(
    kernel: Kernel | Move,
    target: Multiplexed,
    *,
    x_cells: int | None = None,
    u_cells: int | tuple[int, ...] | None = None,
    points: int = 2**20,
    scrambles: int = 2,
    seed: int = 0,
) -> Operator:
    """The operator of a kernel, or of a move that `Metropolis` then accepts, on a target with up to three u.

    Every point of a scrambled Sobol net over (u, w), the same for all starts, is a start u in the whole cube,
    weighted by C_i(u), with numbers w. Of a `Metropolis` both outcomes count, by the acceptance probability, and of a
    `moves.Mixture` every branch; of any other kernel the one outcome. A cell is (index, interval of x, box of u): as
    fine in x as a jump needs, which keeps x, and in u as a step needs. `points`, a power of two, is the size of a net
    for one index; there are `scrambles` of them, independent.

    Raises `ValueError` for more than three u, and where the kernel does not fit the target.
    """
    forget_what_has_changed(kernel, target)
    kernel = as_kernel(kernel, "transition_operator: the kernel")
    require_instance(target, Multiplexed, "transition_operator: the target")
    kernel.check(target)
    m = target.dim_u
    require(1 <= m <= 3, f"transition_operator: u has {m} coordinates; cells are made of three at most")
    u = (DEFAULT_U[m] if u_cells is None else u_cells,) * m if not isinstance(u_cells, tuple) else u_cells
    require(len(u) == m, f"transition_operator: u has {m} coordinates, u_cells names {len(u)}")
    scalar = np.ndim(target.target.domain[0]) == 0
    counts = ((DEFAULT_X[m] if x_cells is None else x_cells,) if scalar else ()) + u
    flux = KernelFlux(kernel, target)
    atoms = find_atoms(flux, seed)
    return Operator(
        measure(flux, target.n_techniques, counts, points=points, scrambles=scrambles, seed=seed, atoms=atoms)
    )


def step_operator(
    step: Callable[[Any, Any], Any],
    *,
    log_density: Callable[[Any], Any],
    lower: ArrayLike,
    upper: ArrayLike,
    cells: int | None = None,
    points: int = 2**20,
    scrambles: int = 2,
    seed: int = 0,
) -> Operator:
    """The operator of a plain JAX function `step(key, position) -> position` on a box, for a density on it.

    The starts are a Sobol net as for a kernel, each with a key of its own: the steps' noise is Monte Carlo's, and
    higher than a kernel's. `position` has the shape (d,), d up to three; mass that leaves the box counts at its edge.
    """
    forget_what_has_changed(step, log_density)
    lower, upper = np.atleast_1d(np.asarray(lower, np.float64)), np.atleast_1d(np.asarray(upper, np.float64))
    finite = bool(np.isfinite([lower, upper]).all()) if lower.shape == upper.shape else False
    require(
        finite and 1 <= lower.size <= 3 and bool(np.all(lower < upper)),
        f"step_operator: the box is {lower} to {upper}; give finite ends in one to three dimensions, lower under upper",
    )
    counts = (DEFAULT_U[lower.size] if cells is None else cells,) * lower.size
    density = jax.eval_shape(log_density, jax.ShapeDtypeStruct(lower.shape, jnp.zeros(()).dtype))
    require(
        np.shape(density) == (),
        f"step_operator: log_density of a position of shape {lower.shape} must be one number, not of shape "
        f"{np.shape(density)}",
    )
    places = np.random.default_rng(seed).random((_PROBES, lower.size))
    _require_step(step, lower.shape)
    values = np.asarray(jax.vmap(log_density)(jnp.asarray(lower + (upper - lower) * places)), np.float64)
    top = float(np.max(values, where=np.isfinite(values), initial=-np.inf))
    require(top > -np.inf, "step_operator: the density is zero, or not a number, everywhere in the box")
    flux = StepFlux(step, log_density, lower, upper, top)
    return Operator(measure(flux, 1, counts, points=points, scrambles=scrambles, seed=seed))


def _require_step(step: Callable[[Any, Any], Any], shape: tuple[int, ...]) -> None:
    """Raise `ValueError` unless the step takes a key and a position of this shape, and returns a position alone."""
    position = jax.ShapeDtypeStruct(shape, jnp.zeros(()).dtype)
    with traced("step_operator: step(key, position)"):
        after = jax.eval_shape(step, jax.random.key(0, impl="threefry2x32"), position)
    require(
        hasattr(after, "shape") and np.prod(after.shape) == np.prod(shape),
        f"step_operator: step(key, position) must return the position alone, of shape {shape}, not "
        f"{jax.tree.map(lambda leaf: leaf.shape, after)}; of one that returns (position, info) give "
        "lambda key, x: step(key, x)[0]",
    )


__all__ = ["Asymmetry", "Operator", "PredictedLaw", "step_operator", "transition_operator"]
