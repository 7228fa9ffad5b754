"""Cells of a state space, and the scrambled Sobol net whose points fall on them."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from mcmc1d.checks import require, require_whole
from mcmc1d.compiling import wide_jit
from mcmc1d.numerics import below_one
from mcmc1d.types import Array, Float, Index, Int, UInt32

_BITS = 32


@dataclass(frozen=True)
class Cells:
    """Boxes of (index, coordinates): every coordinate lies in [0, 1) and is cut at its own `edges`.

    The coordinates may be redundant (a sample x besides the u that makes it): most of the boxes are then empty, and
    only the `used` ones count. A narrow interval about each atom of a coordinate (a number that the kernel sends
    states to again and again) is a cell of its own.
    """

    n_index: int
    edges: tuple[np.ndarray, ...]
    narrow: tuple[np.ndarray, ...]
    """Whether each interval of each coordinate is an atom's."""
    used: Int[np.ndarray, " n"]
    """The numbers, among all boxes, of those that count, rising."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The boxes along the index and each coordinate."""
        return (self.n_index, *(len(edges) - 1 for edges in self.edges))

    @property
    def places(self) -> tuple[np.ndarray, ...]:
        """The index of each used cell, and its interval along each coordinate."""
        return np.unravel_index(self.used, self.shape)

    @property
    def atomic(self) -> np.ndarray:
        """Whether each used cell is an atom's in any coordinate."""
        hits = [narrow[place] for narrow, place in zip(self.narrow, self.places[1:], strict=True)]
        return np.any(hits, axis=0)

    def coarser(self, factor: int = 2) -> np.ndarray:
        """The number of the coarser cell, `factor` intervals a side, that holds each used cell; atoms stay apart."""
        labels = self.places[0].astype(np.int64)
        for narrow, place in zip(self.narrow, self.places[1:], strict=True):
            wide = np.cumsum(~narrow) - 1  # the atoms left out of the count
            groups = np.where(narrow, np.arange(len(narrow)) + len(narrow), np.maximum(wide, 0) // factor)
            labels = labels * (2 * len(narrow)) + groups[place]
        return np.unique(labels, return_inverse=True)[1]


def regular(n_index: int, counts: tuple[int, ...], atoms: tuple[np.ndarray, ...], width: float) -> Cells:
    """`counts` equal intervals along each coordinate, cut again `width` to the left and right of every atom."""
    edges, narrow = [], []
    for count, values in zip(counts, atoms, strict=True):
        cuts = np.arange(count + 1) / count
        inside = np.concatenate([cuts, *([a - width, a + width] for a in values)])
        # Cuts inside an atom's interval would split it.
        split = np.zeros(inside.shape, bool)
        for a in values:
            split |= (np.abs(inside - a) < 0.99 * width) & (inside > 0) & (inside < 1)
        ends = np.unique(np.clip(inside[~split], 0, 1))
        edges.append(ends)
        middles = (ends[1:] + ends[:-1]) / 2
        narrow.append(np.array([bool(np.any(np.abs(values - m) < width)) for m in middles]))
    shape = (n_index, *(len(e) - 1 for e in edges))
    require(
        float(np.prod(np.array(shape, np.float64))) < 2**31, f"cells of shape {shape} can not be counted in 32 bits"
    )
    return Cells(n_index, tuple(edges), tuple(narrow), np.zeros(0, np.int64))


def number(
    edges: tuple[Float[Array, " _"], ...], counts: tuple[int, ...], index: Index, q: Float[Array, " k"]
) -> Index:
    """The number of the box that holds (index, q): one point; `counts`, of the equal intervals that were cut again."""
    k = jnp.asarray(index)
    for j, (ends, count) in enumerate(zip(edges, counts, strict=True)):
        n = len(ends) - 1
        if n == count:
            place = (q[j] * n).astype(jnp.int32)
        else:
            place = jnp.searchsorted(ends, q[j], side="right", method="compare_all").astype(jnp.int32) - 1
        k = k * n + jnp.clip(place, 0, n - 1)
    return k


def require_nets(points: int, scrambles: int) -> int:
    """log2 of the size of a net, or `ValueError` unless it is a power of two, and an error can be estimated."""
    log2 = require_whole(points, "points, a power of two,", 1024).bit_length() - 1
    require(points == 2**log2, f"points must be a power of two, 1024 at least, not {points}")
    require_whole(scrambles, "scrambles, for an error estimate,", 2)
    return log2


def sobol(dim: int, log2_points: int, rng: np.random.Generator) -> np.ndarray:
    """A scrambled Sobol sequence as its shift and direction numbers: (log2_points + 1, dim) words of 32 bits.

    A point of a digital net is the exclusive or of the direction numbers that its counter's bits name, so that any
    stretch of the net can be made anywhere, in any order; the scrambling is SciPy's (Matousek 1998).
    """
    engine = qmc.Sobol(dim, scramble=True, bits=_BITS, rng=rng)

    def pair(first: int) -> np.ndarray:
        engine.reset()
        if first > 0:
            engine.fast_forward(first)
        return np.round(engine.random(2) * 2.0**_BITS).astype(np.uint64)

    # In Gray-code order points 2^j - 1 and 2^j differ by direction number j alone.
    pairs = [pair(2**j - 1) for j in range(log2_points)]
    return np.stack([pairs[0][0], *(a ^ b for a, b in pairs)]).astype(np.uint32)


@wide_jit
def net_points(
    words: UInt32[Array, "b dim"], first: UInt32[Array, ""], count: int, dtype: Any
) -> Float[Array, "dim n"]:
    """`count` points of the net from number `first` on, strictly inside the unit cube.

    A program of its own: fused with a long one, a point's bits would be made anew wherever a number is used.
    """
    counters = first + jnp.arange(count, dtype=jnp.uint32)
    points = jnp.broadcast_to(words[0][:, None], (words.shape[1], count))
    for j in range(words.shape[0] - 1):
        bit = (counters >> j) & jnp.uint32(1)
        points = points ^ (words[j + 1][:, None] * bit[None, :])
    bits = 24 if jnp.dtype(dtype).itemsize == 4 else _BITS
    # Half a unit above each number's first bits: never 0, where a normal quantile is infinite.
    return below_one(
        ((points >> (_BITS - bits)).astype(dtype) + jnp.asarray(0.5, dtype)) * jnp.asarray(2.0**-bits, dtype)
    )
