"""What is under test, brought to one form: independent replicas, started at given positions and looked at later."""

import abc
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.types import Array, Key
from mcmc1d.verify.statistic import Position, Statistic

PICK = 2**30
"""The counter from which on a replica's random numbers pick deposits, not steps."""


@dataclass(frozen=True)
class Picked:
    """One of each replica's deposits, drawn in proportion to its weight."""

    points: Position
    """Like positions; what a right estimator puts here has the target's law."""
    none: np.ndarray
    """(n,), where nothing was drawn: the weights' total is the probability, times `max_weight`, that something is."""
    least: float
    """The smallest weight met."""
    most: float
    """The largest total of one step's weights."""


@dataclass(frozen=True)
class Look:
    """What a subject looks like after some steps."""

    positions: Position
    picked: Picked | None = None
    wrong: str = ""
    """What no kernel may leave behind, in words."""
    dark: np.ndarray | None = None
    """(n,): 1 where the density is zero and was not at the start, -1 for the reverse, else 0; None if not known here.
    """


class Subject(abc.ABC):
    """A kernel under test."""

    name: str
    reversible: bool | None = None
    """Whether it is declared to satisfy detailed balance; None where nothing has been said."""
    unit: int = 2048
    """How many replicas one call advances."""
    least_unit: int = 256
    """To how few that may be lowered for a slow kernel."""
    together: int = 1
    """How many replicas in a row move by each other: at any one time they are independent, their ways are not."""
    threads: bool = False
    """Whether calls may run side by side."""
    deposited: Mapping[str, Statistic] | None = None
    """What is known exactly of the deposits, by name, where their law is not the positions'."""
    total: float = 1.0
    """The expected total weight of the deposits in a step."""
    most: float | None = None
    """The largest; None leaves it to who asks for the verification."""

    @abc.abstractmethod
    def check(self, start: Position) -> None:
        """Raise `ValueError` where the kernel can not be run from such positions, with the words to mend it."""

    @abc.abstractmethod
    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        """The replicas `first`, `first` + 1, ... from `start`, after each of the rising numbers of steps.

        What comes out is a function of the arguments alone.
        """

    def walk(self, seed: Sequence[int], start: Position, times: Sequence[int]) -> Iterator[Look]:
        """All replicas after each of the times, watched `unit` at a time.

        The last slice is filled up with the first replicas, which are then left out: of every new size a program would
        be compiled.
        """
        n, unit = len(jax.tree.leaves(start)[0]), self.unit
        if n > unit:
            rows = np.arange(-(-n // unit) * unit) % n
            start = jax.tree.map(lambda s: np.asarray(s)[rows], start)
        parts = [
            self.watch(seed, a, jax.tree.map(lambda s, a=a: s[a : a + unit], start), times) for a in range(0, n, unit)
        ]
        return (head(n, joined(looks)) for looks in zip(*parts, strict=True))

    def prepare(self, start: Position) -> Position:
        """Exact draws in the precision in which the kernel runs."""
        return start

    def drawn(self, start: Position) -> bool:
        """Whether a part of the state, beside the position, is drawn at random by who gave the kernel."""
        return False

    def alike(self, start: Position) -> bool:
        """Whether chains at one place all move to one other, and with other random numbers to another."""
        return False

    def crowd(self, points: Position, unlikely: Position, n: int) -> list[Position]:
        """`n` replicas at each of a few bad points; `unlikely` are exact draws, the least likely first."""
        count = len(jax.tree.leaves(points)[0])
        return [jax.tree.map(lambda a, k=k: np.repeat(np.asarray(a)[k : k + 1], n, 0), points) for k in range(count)]


def head(n: int, look: Look) -> Look:
    """The look at the first n replicas."""

    def cut(tree: Position) -> Position:
        return jax.tree.map(lambda a: a[:n], tree)

    picked = look.picked
    if picked is not None:
        picked = Picked(cut(picked.points), picked.none[:n], picked.least, picked.most)
    return Look(cut(look.positions), picked, look.wrong, cut(look.dark))


def joined(looks: Sequence[Look]) -> Look:
    """The looks at several slices of replicas as one."""
    positions = jax.tree.map(lambda *parts: np.concatenate(parts), *(look.positions for look in looks))
    picked = [look.picked for look in looks if look.picked is not None]
    wrong = next((look.wrong for look in looks if look.wrong), "")
    dark = None if looks[0].dark is None else np.concatenate([np.asarray(look.dark) for look in looks])
    if not picked:
        return Look(positions, wrong=wrong, dark=dark)
    points = jax.tree.map(lambda *parts: np.concatenate(parts), *(p.points for p in picked))
    none = np.concatenate([p.none for p in picked])
    least, most = np.min([p.least for p in picked]), np.max([p.most for p in picked])  # NaN if any is
    return Look(positions, Picked(points, none, float(least), float(most)), wrong, dark)


def pick(points: Any, weights: Array, uniform: Array, limit: Array) -> tuple[Any, Array, Array, Array]:
    """One of the points, with probability weight / limit; whether none was; the least weight and the total."""
    ends = jnp.cumsum(weights)
    total = ends[-1]
    # A total that falls short of the limit by rounding alone is the limit.
    scale = jnp.where(jnp.abs(total - limit) <= 1e-5 * limit, total, limit)
    chosen = jnp.sum(uniform * scale >= ends)
    none = chosen >= weights.shape[0]
    index = jnp.minimum(chosen, weights.shape[0] - 1)
    return jax.tree.map(lambda p: p[index], points), none, jnp.min(weights), total


def drawn(raw: Any) -> Picked:
    """Deposits picked by replica, brought to the host."""
    points, none, least, total = jax.tree.map(np.asarray, raw)
    return Picked(points, none, float(least.min()), float(total.max()))


def key_of(seed: Sequence[int]) -> Key:
    """A key from any integers, by NumPy's mixing of seeds; of threefry, whatever JAX's default is."""
    word = np.random.SeedSequence(list(seed)).generate_state(2, np.uint32)
    return jax.random.wrap_key_data(jnp.asarray(word), impl="threefry2x32")
