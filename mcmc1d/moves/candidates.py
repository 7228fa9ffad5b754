"""How the numbers of several candidates are drawn together, and how those of their competitors follow.

A way of drawing is a bijection: (numbers w, the chosen candidate k, the number b that leads back from it) to (w', k',
the chosen one's own number), under which the family of w' has b at its place k'.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require
from mcmc1d.numerics import below_one, stratum, wrap
from mcmc1d.quadrature import r_sequence
from mcmc1d.types import Array, Float, Index


class Reverse(NamedTuple):
    """The family around the chosen candidate."""

    family: Float[Array, "p r"]
    """The numbers of its p members; the one that leads back stands at `place`."""
    place: Index
    w: Float[Array, " s"]
    """What would draw that family, and find the first one again."""


class Candidates(eqx.Module):
    """A way of drawing p vectors of r uniform numbers, each uniform by itself."""

    @abc.abstractmethod
    def dim(self, p: int, r: int) -> int:
        """How many uniform numbers it consumes, competitors included."""

    @abc.abstractmethod
    def forth(self, p: int, r: int, w: Float[Array, " s"]) -> Float[Array, "p r"]:
        """The numbers of the p candidates."""

    @abc.abstractmethod
    def back(self, p: int, r: int, w: Float[Array, " s"], k: Index, number: Float[Array, " r"]) -> Reverse:
        """The family around candidate k, whose way back is `number`."""

    def check(self, p: int) -> None:
        """Raise `ValueError` unless p candidates can be drawn so."""


class Independent(Candidates):
    """Independent candidates, and independent competitors."""

    def dim(self, p: int, r: int) -> int:
        return (2 * p - 1) * r

    def forth(self, p: int, r: int, w: Float[Array, " s"]) -> Float[Array, "p r"]:
        return w[: p * r].reshape(p, r)

    def back(self, p: int, r: int, w: Float[Array, " s"], k: Index, number: Float[Array, " r"]) -> Reverse:
        rows = w.reshape(2 * p - 1, r)
        family = insert(rows[p:], number, k)
        return Reverse(family, k, jnp.concatenate([family, without(rows[:p], k)]).ravel())


class Stratified(Candidates):
    """One candidate in each of p strata of the step's first number (jittered, Segovia et al. 2007, section 6.2).

    The competitors stand in the strata that the way back leaves free: drawn in all of them but the chosen one's, they
    would be the wrong ones.
    """

    def dim(self, p: int, r: int) -> int:
        return (2 * p - 1) * r

    def forth(self, p: int, r: int, w: Float[Array, " s"]) -> Float[Array, "p r"]:
        return _in_strata(w[: p * r].reshape(p, r))

    def back(self, p: int, r: int, w: Float[Array, " s"], k: Index, number: Float[Array, " r"]) -> Reverse:
        rows = w.reshape(2 * p - 1, r)
        scaled = number[0] * p
        place = stratum(number[0], p)
        within = number.at[0].set(below_one(scaled - place))
        family = insert(rows[p:], within, place)
        w_back = jnp.concatenate([family, without(rows[:p], k)]).ravel()
        return Reverse(_in_strata(family), place, w_back)


class Antithetic(Candidates):
    """Pairs of opposite candidates, with the numbers w and 1 - w; the way back has its opposite beside it too."""

    def dim(self, p: int, r: int) -> int:
        return (p - 1) * r

    def check(self, p: int) -> None:
        require(p % 2 == 0, f"antithetic candidates come in pairs: p must be even, not {p}")

    def forth(self, p: int, r: int, w: Float[Array, " s"]) -> Float[Array, "p r"]:
        return _pairs(w[: p // 2 * r].reshape(p // 2, r))

    def back(self, p: int, r: int, w: Float[Array, " s"], k: Index, number: Float[Array, " r"]) -> Reverse:
        rows, pair = w.reshape(p - 1, r), k // 2
        first = jnp.where(k % 2 == 0, number, 1 - number)
        family = insert(rows[p // 2 :], first, pair)
        w_back = jnp.concatenate([family, without(rows[: p // 2], pair)]).ravel()
        return Reverse(_pairs(family), k, w_back)


class Rotated(Candidates):
    """Quasi-random candidates: a Kronecker sequence, rotated by one vector of numbers (Cranley and Patterson 1976).

    The sequence is the R sequence: multiples of the powers of 1 / g, g^(r + 1) = g + 1. The rotation that leads back
    fixes every competitor, so that no further numbers are drawn.
    """

    def dim(self, p: int, r: int) -> int:
        return r

    def forth(self, p: int, r: int, w: Float[Array, " s"]) -> Float[Array, "p r"]:
        return wrap(w[None] + _sequence(p, r, w))

    def back(self, p: int, r: int, w: Float[Array, " s"], k: Index, number: Float[Array, " r"]) -> Reverse:
        rotation = wrap(number - _sequence(p, r, w)[k])
        return Reverse(self.forth(p, r, rotation), k, rotation)


def insert(rows: Array, row: Array, k: Index) -> Array:
    """`rows`, of shape (n, ...), with `row`, of shape (...), at place k."""
    n = rows.shape[0]
    j = jnp.arange(n + 1)
    return jnp.concatenate([rows, row[None]])[jnp.where(j < k, j, jnp.where(j == k, n, j - 1))]


def without(rows: Array, k: Index) -> Array:
    """`rows` but for the one at place k."""
    j = jnp.arange(rows.shape[0] - 1)
    return rows[j + (j >= k)]


def _in_strata(rows: Float[Array, "p r"]) -> Float[Array, "p r"]:
    p = rows.shape[0]
    return rows.at[:, 0].set(below_one((rows[:, 0] + jnp.arange(p)) / p))


def _pairs(rows: Float[Array, "q r"]) -> Float[Array, "p r"]:
    return jnp.stack([rows, 1 - rows], axis=1).reshape(-1, rows.shape[1])


def _sequence(p: int, r: int, like: Array) -> Float[Array, "p r"]:
    return jnp.asarray(r_sequence(p, r), like.dtype)
