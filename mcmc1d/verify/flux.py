"""The flux of a kernel between cells: what is sent where in one step from the target's law, by a Sobol net."""

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from mcmc1d.checks import require, require_mass
from mcmc1d.compiling import wide_jit
from mcmc1d.numerics import cast
from mcmc1d.types import Array, Float, Index, UInt32
from mcmc1d.verify.cells import Cells, net_points, number, regular, require_nets, sobol
from mcmc1d.verify.outcomes import KernelFlux, StepFlux
from mcmc1d.verify.sparse import Matrix

ATOM_WIDTH = 5e-7
"""Half the width of an atom's cell: a few roundings of float32, whose last bit depends on the compiled program."""
COARSE = 10
"""Intervals of the first coordinate between which the flux of each kind of move is kept."""

_LOST = 2e-3  # of the flux: what may go to cells that hold too little mass for a point of the net, or come from traps

_FEW = 32  # points of a net, that start in cells which none of them leaves: too few to say that the kernel stays there

_BATCH = 2**17


class Starts(NamedTuple):
    """Where a net has started, and what was there."""

    cell: np.ndarray
    technique: np.ndarray
    x: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Flux:
    """The share of the target's mass that goes from each cell to each, estimated by several scrambles of the net."""

    cells: Cells
    scrambles: tuple[Matrix, ...]
    """One (n, n) matrix each, of sum one (but for the rows of atoms); rows from which no point starts are empty."""
    by_kind: Float[np.ndarray, "scrambles kinds c c"]
    """The same for each kind of move between coarse cells (index, interval of the first coordinate), stays left out."""
    kinds: tuple[str, ...]
    points: tuple[Starts, ...]
    """Some of each scramble's starts, one at least in each cell where any scramble starts."""


@wide_jit
def _batch(
    flux: KernelFlux | StepFlux,
    points: Float[Array, "dim n"],
    shift: UInt32[Array, ""],
    first: UInt32[Array, ""],
    index: Index,
    edges: tuple[Float[Array, " _"], ...],
    counts: tuple[int, ...],
) -> Any:
    """One batch of the net: cells and coarse cells of the start and each outcome, a list of (n,) each, and the rest.

    Lists, not stacks: what XLA's CPU compiler fuses into a concatenation it computes point by point, twenty times
    slower.
    """
    # The shift, which differs from scramble to scramble, and the counter: a key for what draws its own numbers.
    counter = first + jnp.arange(points.shape[1], dtype=jnp.uint32)
    counters = jnp.stack([jnp.full_like(counter, shift), counter], 1)

    def one(numbers: Float[Array, " dim"], counter: UInt32[Array, " 2"]) -> Any:
        out = flux(index, numbers, counter)
        places = [(s.index, flux.coordinates(s)) for s in (out.start, *out.ends)]
        cells = [number(edges, counts, i, q) for i, q in places]
        rough = [i * COARSE + jnp.clip((q[0] * COARSE).astype(jnp.int32), 0, COARSE - 1) for i, q in places]
        weights = [out.weight * p for p in out.probabilities]
        kinds = [jnp.asarray(k) for k in out.kinds]
        return cells, rough, weights, kinds, out.weight, flux.sample(out.start)

    return jax.vmap(one, in_axes=(-1, 0), out_axes=-1)(points, counters)


class _Sums:
    """What the batches of one scramble add up to."""

    def __init__(self, cells: Cells, kinds: int):
        self.size, self.coarse = int(np.prod(cells.shape)), cells.n_index * COARSE
        self.matrix: Matrix = sp.csr_matrix((self.size, self.size))
        self.by_kind = np.zeros((kinds, self.coarse**2))
        self.starts = np.zeros(self.size, np.int64)
        self.mass = 0.0
        self.kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.representative: Any = None

    def add(self, out: Any, allowed: np.ndarray | None, keep: bool, reference: bool) -> None:
        """Add a batch, only its starts in the `allowed` cells; `reference`: from the target's own law."""
        places, rough, weights, kinds = (np.stack([np.asarray(one) for one in part]) for part in out[:4])
        start, x = (np.asarray(part) for part in out[4:])
        weights, start, x = weights.astype(np.float64), start.astype(np.float64), np.moveaxis(x, -1, 0)
        if allowed is not None:
            weights, start = weights * allowed[places[0]], start * allowed[places[0]]
        lit = weights > 0
        rows = np.broadcast_to(places[0], weights.shape)
        entries = (weights[lit], (rows[lit], places[1:][lit]))
        self.starts += np.bincount(places[0][start > 0], minlength=self.size)
        self.matrix = self.matrix + sp.coo_matrix(entries, shape=self.matrix.shape).tocsr()
        if reference:
            self.mass += float(start.sum())
            pairs = rough[0] * self.coarse + rough[1:]
            for k in range(len(self.by_kind)):
                chosen = lit & (kinds == k) & (places[1:] != places[0])
                self.by_kind[k] += np.bincount(pairs[chosen], weights[chosen], minlength=self.coarse**2)
        if self.representative is None:
            self.representative = np.full((self.size, *x.shape[1:]), np.nan)
        self.representative[places[0][start > 0]] = x[start > 0]
        if keep:
            self.kept.append((places[0][start > 0], x[start > 0], start[start > 0]))

    def escapable(self) -> Matrix:
        """The flux, without that from cells which the few points that start there do not leave.

        Where the cells of u and those of x cut one another there are slivers, with a point or two; where all of these
        are rejected, the cell looks like a trap, and would hold all of the law that the kernel keeps. A kernel that
        stays in more than such a sliver is left as it is.
        """
        matrix, rows, columns = self.matrix, *self.matrix.nonzero()
        while True:
            # What leads to cells in which no point starts leads nowhere.
            alive = np.asarray(matrix.sum(1)).ravel() > 0
            inner = alive[rows] & alive[columns]
            edges = (np.ones(inner.sum(), bool), (rows[inner], columns[inner]))
            _, label = connected_components(sp.csr_matrix(edges, shape=matrix.shape), connection="strong")
            left = label[rows[inner]][label[rows[inner]] != label[columns[inner]]]
            leaves = np.bincount(left, minlength=label.max() + 1) > 0
            trap = alive & (~leaves & (np.bincount(label, self.starts) < _FEW))[label]
            if not trap.any():
                return matrix if matrix.sum() > (1 - _LOST) * self.matrix.sum() else self.matrix
            matrix = sp.csr_matrix(sp.diags((~trap).astype(float)) @ matrix)


def measure(
    flux: KernelFlux | StepFlux,
    n_index: int,
    counts: tuple[int, ...],
    *,
    points: int,
    scrambles: int,
    seed: int,
    atoms: tuple[np.ndarray, ...] | None = None,
) -> Flux:
    """The flux of `scrambles` nets of `points` points (a power of two) an index.

    A start inside a cell is weighted by the target's density: a uniform one would make right kernels look wrong, at
    the order of the cell's width squared. Where there are atoms, which the density does not charge, the starts in
    their cells are the states in which one step of the kernel has left the target's law.
    """
    log2 = require_nets(points, scrambles)
    cells = regular(n_index, counts, (np.zeros(0),) * len(counts) if atoms is None else atoms, ATOM_WIDTH)
    batch, dtype = min(_BATCH, points // 2), jnp.zeros(()).dtype
    flux = cast(flux, dtype)
    passes: list[tuple[KernelFlux | StepFlux, np.ndarray | None, int]] = [(flux, None, points)]
    atomic = dataclasses.replace(cells, used=np.arange(np.prod(cells.shape))).atomic
    if atomic.any():
        # Half of the points do, for the small share of the mass that a wrong law has there.
        passes = [(flux, ~atomic, points), (dataclasses.replace(flux, lead=1), atomic, points // 2)]
    edges = tuple(jnp.asarray(e, dtype) for e in cells.edges)
    sums = [_Sums(cells, len(flux.kinds)) for _ in range(scrambles)]
    for r, total in enumerate(sums):
        for each, allowed, count in passes:
            for index in range(n_index):
                words = jnp.asarray(sobol(each.dim, log2, np.random.default_rng([seed, r, index, each.lead])))
                for first in range(0, count, batch):
                    net = net_points(words, jnp.uint32(first), batch, dtype)
                    at = (words[0, 0], jnp.uint32(first), jnp.int32(index))
                    total.add(_batch(each, net, *at, edges, counts), allowed, first == 0, each.lead == 0)
    return _gather(cells, sums, flux.kinds)


def _gather(cells: Cells, sums: list[_Sums], kinds: tuple[str, ...]) -> Flux:
    """The used cells alone, and everything relative to the target's mass."""
    for s in sums:
        require_mass(s.mass, "the transition operator", "the target")
    scrambles = [s.escapable() for s in sums]
    reached: Matrix = sum(scrambles[1:], scrambles[0])
    starts = np.diff(reached.indptr) > 0
    lost = float(reached.sum() - reached[:, np.flatnonzero(starts)].sum()) / float(reached.sum())
    require(
        lost < _LOST,
        f"the kernel sends {lost:.2g} of its mass in a step to cells where no point of the net starts: raise `points` "
        "or take fewer cells; if it stays so, the target's density is zero there, and the law it would have unknown",
    )
    used = np.flatnonzero((np.diff(reached.indptr) > 0) | (np.asarray(reached.sum(0)).ravel() > 0))

    def starts_of(one: _Sums) -> Starts:
        place, x, weight = (np.concatenate(parts) for parts in zip(*one.kept, strict=True))
        # Of a cell where none was kept one start stands for all, the scramble's own if it has any; its weight is alone.
        spare = one.representative.copy()
        for other in sums:
            spare = np.where(np.isnan(spare), other.representative, spare)
        missing = np.setdiff1d(used[~np.isnan(spare[used]).reshape(len(used), -1).any(1)], place)
        kept = np.isin(place, used)
        place, x = np.concatenate([place[kept], missing]), np.concatenate([x[kept], spare[missing]])
        weight = np.concatenate([weight[kept], np.ones(len(missing))])
        return Starts(np.searchsorted(used, place), place // (one.size // cells.n_index), x, weight)

    coarse = sums[0].coarse
    return Flux(
        dataclasses.replace(cells, used=used),
        tuple((matrix[used][:, used] / s.mass).tocsr() for matrix, s in zip(scrambles, sums, strict=True)),
        np.stack([s.by_kind.reshape(-1, coarse, coarse) / s.mass for s in sums]),
        kinds,
        tuple(starts_of(one) for one in sums),
    )
