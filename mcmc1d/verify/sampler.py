"""Independent replicas of a kernel that start as exact draws, run and counted chunk by chunk."""

import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require
from mcmc1d.parallel import cores
from mcmc1d.verify.battery import OneSample, Replicas, Test, TwoSample, coordinates
from mcmc1d.verify.ends import varies
from mcmc1d.verify.energy import Energy
from mcmc1d.verify.forgetting import point
from mcmc1d.verify.law import Law, LawError
from mcmc1d.verify.statistic import Position
from mcmc1d.verify.subject import Look, Subject

_CHUNK = 2**16  # the most replicas that are drawn, run and counted at once
_ROUNDINGS = 8  # of a float, by which a few operations may pass a wall
_PURPOSES = ("design", "pilot", "start", "fresh", "choice", "steps", "forget", "walk", "diagnosis", "one step", "law")


@dataclass
class Tally:
    """Counts of all tests over some replicas."""

    n: int = 0
    counts: dict[tuple[int, int], tuple[np.ndarray, ...]] = field(default_factory=dict)
    """By (steps, test); steps 0 is the law's own sampler."""
    moved: int = 0
    still: set[str] = field(default_factory=set)
    """Coordinates that no replica has moved, though the law varies in them."""
    wrong: list[str] = field(default_factory=list)
    """States that no kernel may return."""
    outside: dict[int, np.ndarray] = field(default_factory=dict)
    """By steps, how many replicas have come to where the law has no probability, and how many have left it.

    That is outside of its support, where none starts, or where its density is zero, where one may start that rounds so.
    """
    example: str = ""
    """One of them, in words."""

    def add(self, other: "Tally") -> None:
        """Take in another tally."""
        for key, counts in other.counts.items():
            own = self.counts.get(key)
            self.counts[key] = counts if own is None else tuple(a + b for a, b in zip(own, counts, strict=True))
        self.still = other.still if self.n == 0 else self.still & other.still
        self.n += other.n
        self.moved += other.moved
        self.wrong += other.wrong
        for t, counts in other.outside.items():
            self.outside[t] = self.outside.get(t, 0) + counts
        self.example = self.example or other.example


@dataclass
class Sampler:
    """Where the replicas of one verification come from: everything random in it derives from `seed`."""

    law: Law
    subject: Subject
    seed: tuple[int, ...]
    steps: tuple[int, ...] = (1,)
    max_weight: float = 1.0
    tests: list[Test] = field(default_factory=list)
    slack: np.ndarray | float = 0.0
    """How far beyond a wall of the support each coordinate is still at it; of itself, not of its rounding."""
    energy: Energy | None = None
    """The law's log-density, where it has one."""

    def words(self, purpose: str, stage: int = 0, chunk: int = 0) -> tuple[int, ...]:
        """What seeds one purpose, and no other: the law's draws and the kernel's steps must share no numbers."""
        return (_PURPOSES.index(purpose) + 1, stage + 1, chunk + 1, *self.seed)

    def draw(self, purpose: str, stage: int, chunk: int, n: int) -> Position:
        """`n` exact draws, in the kernel's precision."""
        rng = np.random.default_rng(self.words(purpose, stage, chunk))
        try:
            drawn = self.law.sample(rng, n)
        except (TypeError, AttributeError) as error:
            raise ValueError(
                f"{self.law.name}: sample(rng, n) failed ({error}); it is given a numpy.random.Generator and a number"
            ) from error
        lengths = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(drawn)}
        require(
            lengths == {(n,)},
            f"{self.law.name}: sample(rng, {n}) must return {n} positions along the leading axis; it returned "
            + ", ".join(str(length[0]) if length else "a single number" for length in lengths),
        )
        drawn = jax.tree.map(np.asarray, drawn)
        for leaf in jax.tree.leaves(drawn):
            require(
                leaf.dtype.kind in "biu" or jnp.issubdtype(leaf.dtype, jnp.floating),
                f"{self.law.name}: sample returned {leaf.dtype}, and positions are made of real numbers; give the real "
                "and imaginary parts of complex ones as two arrays, {'real': z.real, 'imag': z.imag}",
            )
        finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(drawn) if leaf.dtype.kind not in "biu")
        require(finite, f"{self.law.name}: sample returned NaN or an infinity")
        return self.subject.prepare(drawn)

    def own(self, test: Test) -> bool:
        """Whether the law's own draws can be put to a test: before the first step."""
        return isinstance(test, OneSample) and not test.deposits

    @property
    def workers(self) -> int:
        """How many chunks run side by side."""
        if not self.subject.threads:
            return 1
        return cores()

    def seconds_a_replica(self) -> float:
        """All told: drawn, run and counted; compiled before."""
        n = self.subject.unit
        self.chunk(0, 0, n)
        begin = time.perf_counter()
        self.chunk(0, 0, n)
        return (time.perf_counter() - begin) / n

    def stage(self, stage: int, n: int, looks: int) -> Iterable[Tally]:
        """The tallies of a stage's chunks, in their order, as they come in; `looks` of them or more, if n is large."""
        unit = self.subject.unit
        # Two chunks a look, for two workers; few enough replicas are not worth one.
        half = -(-n // (2 * looks * unit)) * unit
        size = min(max(_CHUNK // unit, 1) * unit, max(half, min(n, 4 * unit)))
        chunks = [(k, min(size, n - k * size)) for k in range(-(-n // size))]
        wide = jnp.zeros(()).dtype == jnp.float64

        def work(chunk: tuple[int, int]) -> Tally:
            with jax.enable_x64(wide):  # a worker thread does not inherit a context
                return self.chunk(stage, *chunk)

        if self.workers == 1:
            yield from map(work, chunks)
            return
        with ThreadPoolExecutor(self.workers) as pool:
            pending = [pool.submit(work, chunk) for chunk in chunks]
            try:
                for future in pending:
                    yield future.result()
            finally:
                for future in pending:
                    future.cancel()

    def of_the_law(self, stage: int, n: int) -> Tally:
        """What the law's own draws show, of which n are drawn for this alone."""
        total = Tally()
        for chunk, first in enumerate(range(0, n, _CHUNK)):
            draws = self.draw("law", stage, chunk, min(_CHUNK, n - first))
            size = len(jax.tree.leaves(draws)[0])
            replicas = Replicas(draws, Look(draws), draws, np.zeros(size))
            own = {(0, k): test.count(replicas) for k, test in enumerate(self.tests) if self.own(test)}
            total.add(Tally(size, own))
        return total

    def chunk(self, stage: int, chunk: int, n: int) -> Tally:
        """Draw, run and count."""
        start = self.draw("start", stage, chunk, n)
        self.require_inside(start)
        compared = any(isinstance(test, TwoSample) for test in self.tests)
        fresh = self.draw("fresh", stage, chunk, n) if compared else start
        uniform = np.random.default_rng(self.words("choice", stage, chunk)).random(n)
        replicas = Replicas(start, Look(start), fresh, uniform)
        tally = Tally(n)
        for k, test in enumerate(self.tests):
            if self.own(test):
                tally.counts[0, k] = test.count(replicas)
        before = coordinates(start)
        changed = {name: np.zeros(n, bool) for name in before}
        walk = self.subject.walk(self.words("steps", stage, chunk), start, self.steps)
        for t, look in zip(self.steps, walk, strict=True):
            tally.wrong += self.inspect(start, look, t)
            if tally.wrong:
                return tally
            change, example = self.astray(start, look, t)
            tally.outside[t] = np.array([np.sum(change > 0), np.sum(change < 0)])
            tally.example = tally.example or example
            for k, test in enumerate(self.tests):
                tally.counts[t, k] = test.count(replicas.at(look))
            after = coordinates(look.positions)
            for name in before:
                changed[name] |= before[name] != after[name]
        tally.moved = int(np.any(list(changed.values()), axis=0).sum())
        tally.still = {name for name, change in changed.items() if not change.any() and varies(before[name])}
        return tally

    def inspect(self, start: Position, look: Look, t: int) -> list[str]:
        """What no kernel may return, in words with an example."""
        if look.wrong:
            return [f"{look.wrong}, after {t} step{'s' * (t > 1)}"]
        before, after = coordinates(start), coordinates(look.positions)
        for name, values in after.items():
            bad = np.zeros(len(values), bool) if values.dtype.kind in "biu" else ~np.isfinite(values)
            if bad.any():
                k = int(np.argmax(bad))
                return [
                    f"it returns {values[k]} for {name} in {bad.sum()} of {len(bad)} replicas within "
                    f"{t} steps, for one from {point(before, k)}; guard the arithmetic at such points"
                ]
        picked = look.picked
        if picked is not None:
            within = picked.least >= -1e-6 and picked.most <= self.max_weight * (1 + 1e-4)
            found = f"the least is {picked.least:.6g} and the largest total {picked.most:.6g}"
            must = f"must not be negative and sum to {self.max_weight:g} at most"
            # A kernel of this library declares the bound itself; else who gave it may be wrong.
            if not within and (self.subject.most is not None or np.isnan([picked.least, picked.most]).any()):
                return [f"the weights of a step's deposits {must}; {found}, within {t} steps"]
            require(within, f"the deposits' weights {must}; {found}: give max_weight= their bound")
        return []

    def outside(self, start: Position, look: Look, t: int, dark: bool = True) -> tuple[int, str]:
        """How many replicas have come to where the law has no probability, and one of them in words."""
        change, example = self.astray(start, look, t, dark)
        return int(np.sum(change > 0)), example

    def astray(self, start: Position, look: Look, t: int, dark: bool = True) -> tuple[np.ndarray, str]:
        """1 for each replica that has come to where the law has no probability, -1 for one that has left it, else 0.

        And one that has come there in words. `dark`: whether that is where the density is zero, too.
        """
        left = ~inside(self.law, look.positions, self.slack)
        change = np.zeros(len(left), np.int8)
        if dark and look.dark is not None:
            change = look.dark
        elif dark and self.energy is not None:
            now, before = (self.energy.zero(where) for where in (look.positions, start))
            change = now.astype(np.int8) - before
        change = np.where(left, 1, change)
        if not (change > 0).any():
            return change, ""
        k = int(np.argmax(change > 0))
        before, after = coordinates(start), coordinates(look.positions)
        why = "" if left[k] else ", where the density is zero"
        return change, f"one within {t} steps from {point(before, k)} to {point(after, k)}{why}"

    def require_inside(self, draws: Position) -> None:
        """Raise `LawError` unless the law's own draws are in its support."""
        within = inside(self.law, draws, self.slack)
        if not within.all():
            at = point(coordinates(draws), int(np.argmin(within)))
            raise LawError(f"{self.law.name}: its own draw {at} lies outside its support; mend the one or the other")


def slack(draws: Position) -> np.ndarray | float:
    """1e-6 of the breadth of each coordinate of positions that are one array, of which a box may be the support.

    1e-6 at most: a few operations on numbers about 1 may end so far beyond a wall.
    """
    if not isinstance(draws, np.ndarray) or draws.dtype.kind in "biu":
        return 0.0
    columns = draws.reshape(len(draws), -1).astype(np.float64)
    middle = np.ptp(np.quantile(columns, [0.05, 0.95], axis=0), axis=0)
    return 1e-6 * np.minimum(1.0, np.where(middle > 0, middle, np.ptp(columns, axis=0)))


def inside(law: Law, where: Position, slack: np.ndarray | float) -> np.ndarray:
    """Whether each position lies in the law's support; closed, and as wide as `slack` or a float's rounding."""
    n = len(jax.tree.leaves(where)[0])
    if law.support is None:
        return np.ones(n, bool)
    if callable(law.support):
        within = np.asarray(law.support(where))
        require(
            within.shape == (n,) and within.dtype.kind in "biu",
            f"{law.name}: support must return one boolean a position, shape {(n,)}, not {within.dtype} of shape "
            f"{within.shape}; of positions (n, d), (...).all(axis=1)",
        )
        return within.astype(bool)
    lower, upper = law.support
    require(
        not isinstance(where, dict | tuple | list),
        f"{law.name}: support=(lower, upper) is for positions that are one array; give a function of n positions",
    )
    array = np.asarray(where)
    x = array.astype(np.float64).reshape(n, -1)
    rounding = 0.0 if array.dtype.kind in "biu" else _ROUNDINGS * float(jnp.finfo(array.dtype).eps)
    slack = np.maximum(slack, rounding * np.abs(x))
    return np.all((x >= np.ravel(lower) - slack) & (x <= np.ravel(upper) + slack), axis=1)


def entropy(seed: int, name: str) -> tuple[int, ...]:
    """Integers from the run's seed and the test's name."""
    require(seed >= 0, f"a seed is not negative, unlike {seed}")
    return (seed, *np.frombuffer(name.encode().ljust(-(-len(name.encode()) // 4) * 4), np.uint32).tolist())
