"""The primary-sample sampler of Pharr, Jakob, Humphreys, section 16.4, claim by claim; its replay loses the law."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table
from scipy.special import ndtr
from scipy.stats import multinomial, norm

from experiments.support.framework import Claim
from experiments.support.sweep import Sweep
from mcmc1d import lazy, verify
from mcmc1d.lazy import LazyChain, LazySampler, LazyState
from mcmc1d.types import Array, Key
from mcmc1d.verify.goodness import p_value, smallest_gap, total_variation

BOOK = "Pharr, Jakob, Humphreys, sec. 16.4"


@dataclass(frozen=True)
class Config:
    """The experiment's numbers."""

    replicas: int = 2**15
    """Of each verification of the sampler."""
    draws: int = 2**17
    """Of merged small steps."""
    chains: int = 2**12
    """Of the simulations on streams and on holes."""
    steps: int = 128


PROFILES = {"quick": Config(), "paper": Config(replicas=2**18, draws=2**21, chains=2**16, steps=1024)}


# --- the sampler itself, on a law whose number of dimensions is part of it -------------------------------------------

G = np.array([0.05, 0.2, 2.5, 1.25])
"""The density of every number but the first, on quarters of the unit interval."""
SHARES = np.array([0.3, 0.3, 0.4])
"""Of the states that read 0, 1 and 2 further numbers."""
UNREAD = -1.0
_CELLS = 16


def on_quarters(u: Array) -> Array:
    """Log g(u)."""
    return jnp.asarray(np.log(G), u.dtype)[jnp.minimum((4 * u).astype(jnp.int32), 3)]


def product(sampler: LazySampler, state: LazyState) -> tuple[Array, Array, LazyState]:
    """The first number says how many further ones are read; f is the product of their densities."""
    first, state = sampler.get(state)
    further = jnp.minimum((3 * first).astype(jnp.int32), 2)
    log_f, sample = jnp.asarray(np.log(3 * SHARES), first.dtype)[further], [first]
    for j in (1, 2):
        u, state = sampler.get(state, further >= j)
        log_f = log_f + jnp.where(further >= j, on_quarters(u), 0)
        sample.append(jnp.where(further >= j, u, UNREAD))
    return log_f, jnp.stack(sample), state


def product_law() -> verify.Law:
    """The law of the numbers that are read, exactly."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        further = rng.choice(3, size=n, p=SHARES)
        rest = (rng.choice(4, size=(n, 2), p=G / 4) + rng.random((n, 2))) / 4
        rest = np.where(further[:, None] >= (1, 2), rest, UNREAD)
        return np.concatenate([((further + rng.random(n)) / 3)[:, None], rest], axis=1)

    def cell(j: int) -> Callable[[np.ndarray], np.ndarray]:
        def of(x: np.ndarray) -> np.ndarray:
            further = np.minimum((3 * np.asarray(x[:, 0], np.float64)).astype(int), 2)
            place = np.clip((_CELLS * x[:, j]).astype(int), 0, _CELLS - 1)
            return np.where(further < j, 0, 1 + (further - j) * _CELLS + place)

        return of

    masses = np.repeat(G / 4, _CELLS // 4) / (_CELLS // 4)
    statistics: dict[str, Any] = {
        "u0": verify.Continuous(lambda x: x[:, 0], lambda u: np.interp(u, np.arange(4) / 3, np.cumsum([0, *SHARES])))
    }
    for j in (1, 2):
        cells = np.concatenate([[SHARES[:j].sum()], *(SHARES[k] * masses for k in range(j, 3))])
        statistics[f"reads, u{j}"] = verify.Discrete(cell(j), cells, cut=True)
    return verify.Law(sample, statistics=statistics, name="product")


class _Begin(eqx.Module):
    """From an exact draw, at a random hour; the numbers not read so far have never been.

    `zeros`: they are 0 with a time stamp of 0, as the book fills gaps; then the hour is 0.
    """

    sampler: LazySampler
    zeros: Array

    def __call__(self, key: Key, position: Array) -> LazyChain:
        further = jnp.minimum((3 * position[0]).astype(jnp.int32), 2)
        read = jnp.arange(3) <= further
        hour = jnp.where(self.zeros, 0, jax.random.randint(key, (), 0, 8))
        samples = self.sampler.init(jnp.zeros(4 * self.sampler.size, position.dtype))
        samples = eqx.tree_at(
            lambda s: (s.value, s.stamp, s.iteration),
            samples,
            (jnp.where(read, position, 0), jnp.where(read, hour, jnp.where(self.zeros, 0, lazy.NEVER)), hour),
        )
        log_g = jnp.where(read[1:], on_quarters(position[1:]), 0).sum()
        return LazyChain(samples, jnp.asarray(np.log(3 * SHARES), position.dtype)[further] + log_g, position)


class _Step(eqx.Module):
    sampler: LazySampler

    def __call__(self, key: Key, chain: LazyChain) -> LazyChain:
        w = jax.random.uniform(key, (self.sampler.dim_w,), chain.log_f.dtype)
        return lazy.step(self.sampler, product, chain, w)[0]


def sample_of(chain: LazyChain) -> Array:
    """The numbers that the chain's state reads."""
    return chain.sample


def under_test(sampler: LazySampler, *, zeros: bool = False) -> verify.JaxKernel:
    """The sampler's chain as a kernel; modules, so that those that differ in `zeros` alone compile once."""
    return verify.JaxKernel(_Step(sampler), _Begin(sampler, jnp.asarray(zeros)), sample_of, name="lazy sampler")


# --- exact references ------------------------------------------------------------------------------------------------


def steps_on_ring(n: int) -> np.ndarray:
    """Stay with probability 1/2, or go to either neighbour."""
    return 0.5 * np.eye(n) + 0.25 * (np.roll(np.eye(n), 1, axis=1) + np.roll(np.eye(n), -1, axis=1))


def lazy_chain(replay: str, large_step: float) -> tuple[np.ndarray, np.ndarray]:
    """(matrix, view): the lazy sampler on a space small enough to write down; a view says what is read in each state.

    A switch proposes, with probability 1/2 each, a state A that reads nothing (f = 1) or B that reads one number on a
    ring of four (f = G). States: (A, number, small steps missed: 0 to 63, when the number is uniform to 1e-18), and
    (B, number).
    """
    n, most = len(G), 64
    ring = steps_on_ring(n)
    powers = [np.linalg.matrix_power(ring, k) for k in range(most + 1)]
    hidden = lambda d, missed: d * most + missed  # noqa: E731
    lit = n * most + np.arange(n)
    matrix, uniform, enter = np.zeros((n * most + n,) * 2), np.full(n, 1 / n), np.minimum(1, G)
    for d in range(n):
        for missed in range(most):
            here = hidden(d, missed)
            matrix[here, hidden(d, min(missed + 1, most - 1))] += (1 - large_step) / 2
            matrix[here, hidden(0, most - 1)] += large_step / 2
            for share, jump in ((1 - large_step, ring), (large_step, uniform + 0 * ring)):
                # Where the number is before the step that is proposed: a rejection leaves it there, or undoes it all.
                for now in range(n):
                    chance = share / 2 * powers[missed][d, now]
                    matrix[here, lit] += chance * jump[now] * enter
                    back = hidden(now, 0) if replay == "apart" else here
                    matrix[here, back] += chance * (1 - jump[now] @ enter)
        leave = min(1, 1 / G[d])
        matrix[lit[d], hidden(d, 1)] += (1 - large_step) / 2 * leave
        matrix[lit[d], hidden(0, most - 1)] += large_step / 2 * leave
        matrix[lit[d], lit[d]] += (1 - leave) / 2
        for share, jump in ((1 - large_step, ring[d]), (large_step, uniform)):
            taken = share / 2 * jump * np.minimum(1, G / G[d])
            matrix[lit[d], lit] += taken
            matrix[lit[d], lit[d]] += share / 2 - taken.sum()
    view = np.zeros((len(matrix), n + 1))
    view[: n * most, 0], view[lit, np.arange(1, n + 1)] = 1, 1
    return matrix, view


def eager_chain(large_step: float) -> tuple[np.ndarray, np.ndarray]:
    """The same with a sampler that moves the number in every step, read or not: states (A, number) and (B, number)."""
    n = len(G)
    ring = steps_on_ring(n)
    q = np.tile((1 - large_step) * ring + large_step / n, (2, 2)) / 2
    f = np.concatenate([np.ones(n), G])
    matrix = q * np.minimum(1, f / f[:, None])
    matrix[np.diag_indices(2 * n)] += 1 - matrix.sum(1)
    return matrix, np.concatenate([np.eye(1, n + 1).repeat(n, axis=0), np.eye(n, n + 1, 1)])


def lazy_errors(replay: str, large_step: float) -> tuple[float, float]:
    """TV from the exact law of the law that the lazy sampler keeps, and from the eager one's of the first 64 steps."""
    (matrix, view), (eager, eager_view) = lazy_chain(replay, large_step), eager_chain(large_step)
    exact = np.concatenate([[1.0], G / len(G)])
    law, apart = total_variation(stationary(matrix) @ view, exact / exact.sum()), 0.0
    here, there = matrix[-len(G) :], eager[-len(G) :]
    for _ in range(64):
        apart = max(apart, *(total_variation(*pair) for pair in zip(here @ view, there @ eager_view, strict=True)))
        here, there = here @ matrix, there @ eager
    return law, apart


def stationary(matrix: np.ndarray) -> np.ndarray:
    """The law that a transition matrix keeps."""
    n = len(matrix)
    system = np.concatenate([matrix.T - np.eye(n), np.ones((1, n))])
    return np.linalg.lstsq(system, np.concatenate([np.zeros(n), [1.0]]), rcond=None)[0]


def wrapped(sigma: float, x: np.ndarray) -> np.ndarray:
    """The density of a normal number of standard deviation sigma, around the ends of [0, 1)."""
    return norm.pdf(x[:, None] + np.arange(-30, 31), scale=sigma).sum(1)


def merging(sigma: float, n: int, scale: float) -> float:
    """The largest difference of the densities of n steps, by n-fold convolution, and of one that is `scale` as wide."""
    points = 512  # the trapezoidal rule is exact for the frequencies that a wrapped normal of this width has
    x = np.arange(points) / points
    steps = np.fft.ifft((np.fft.fft(wrapped(sigma, x)) / points) ** n).real * points
    return float(np.abs(steps - wrapped(sigma * scale, x)).max())


def walls(clamp: bool, sigma: float = 0.1, cells: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """(law, exact): of a walk on f = 0.2 + 1.6 x by cells of [0, 1], and the atom at either wall first and last.

    By the midpoint rule, a clamped proposal's mass beyond a wall on the wall itself.
    """
    x = np.concatenate([[0], (np.arange(cells) + 0.5) / cells, [1]]) if clamp else (np.arange(cells) + 0.5) / cells
    f = 0.2 + 1.6 * x
    if clamp:
        edges = np.arange(cells + 1) / cells
        below = ndtr((edges - x[:, None]) / sigma)
        q = np.concatenate([below[:, :1], np.diff(below, axis=1), 1 - below[:, -1:]], axis=1)
    else:
        q = wrapped(sigma, (x[:, None] - x).ravel()).reshape(cells, cells) / cells
        q /= q.sum(1, keepdims=True)
    matrix = q * np.minimum(1, f / f[:, None])
    matrix[np.diag_indices(len(x))] += 1 - matrix.sum(1)
    exact = f / f.sum() if not clamp else np.concatenate([[0], f[1:-1] / f[1:-1].sum(), [0]])
    return stationary(matrix), exact


def deposit_variances(pi: np.ndarray, q: np.ndarray, phi: np.ndarray) -> tuple[float, float]:
    """The asymptotic variances of the mean of phi: deposits on the state after the step, and expected-value ones.

    Both by the fundamental matrix Z = (I - P + 1 pi)^-1; the deposit h(x, y) = (1 - a) phi(x) + a phi(y) is a function
    of the state and the proposal.
    """
    a = np.minimum(1, pi / pi[:, None])
    p = q * a
    p[np.diag_indices(len(pi))] += 1 - p.sum(1)
    z = np.linalg.inv(np.eye(len(pi)) - p + pi)
    phi = phi - pi @ phi
    h = (1 - a) * phi[:, None] + a * phi
    later = z @ (q * h).sum(1)
    joint = pi[:, None] * q
    expected = (joint * h * (h + 2 * (a * later + (1 - a) * later[:, None]))).sum()
    return float(pi @ (phi * (2 * (z @ phi) - phi))), float(expected)


CHAIN = np.array([0.9, 0.05, 0.05]), np.array([[0.95, 0.05, 0], [0.05, 0, 0.95], [0, 0.95, 0.05]]), np.array([0, -1, 1])
"""A rare pair of states that the proposal alternates between, and phi odd on it: alternation cancels, and expected-
value deposits, which smear, cancel less."""


def random_ratios(seed: int, count: int = 4000) -> np.ndarray:
    """Expected over plain variance, of random three-state chains with symmetric proposals."""
    rng = np.random.default_rng(seed)
    ratios = []
    for _ in range(count):
        pi, (a, b, c) = rng.dirichlet(np.full(3, 0.5)) + 1e-3, rng.dirichlet(np.ones(3))
        q = np.array([[0, a, b], [a, 0, c], [b, c, 0]])
        q[np.diag_indices(3)] = 1 - q.sum(1)
        plain, expected = deposit_variances(pi / pi.sum(), q, rng.normal(size=3))
        ratios.append(expected / plain)
    return np.array(ratios)


F = np.array([0.2, 3.0, 0.5, 2.0])
"""Of the ring on which start-up bias is computed; seen through a uniform start, b is its mean."""
STARTS = ("bootstrap, same b", "bootstrap, exact b", "uniform start")
TIMES = np.arange(0, 25)


def startup(candidates: int) -> np.ndarray:
    """E[b phi(X_n)] / E[phi f] - 1 after n steps, phi the first state: by (start, n), all candidates enumerated."""
    n = len(F)
    q = steps_on_ring(n)
    p = q * np.minimum(1, F / F[:, None])
    p[np.diag_indices(n)] += 1 - p.sum(1)
    phi = np.eye(n)[0]
    later = np.stack([np.linalg.matrix_power(p, t) @ phi for t in TIMES])
    truth, b = F @ phi / n, F.mean()
    total = np.zeros((3, len(TIMES)))
    for counts in np.ndindex(*(candidates + 1,) * n):
        if sum(counts) != candidates:
            continue
        chance = multinomial.pmf(counts, candidates, np.full(n, 1 / n))
        weights: np.ndarray = np.array(counts) * F
        value = later @ (weights / weights.sum())
        total[0] += chance * weights.sum() / candidates * value
        total[1] += chance * b * value
    total[2] = b * later.mean(1)
    return total / truth - 1


def lengths() -> tuple[float, float]:
    """Relative errors of E[b phi], b the sum and b the mean of the lengths' averages: two lengths, two candidates each.

    The chain is the one that stays where it starts: what the start's law is, remains.
    """
    fs = np.array([[0.2, 3.0, 0.5], [2.0, 0.1, 1.0]])
    phi = np.array([1.0, 0.3, -0.5])  # what a sample adds to the image, at either length
    estimate = np.zeros(2)
    for states in np.ndindex(3, 3, 3, 3):
        f = np.array([fs[0][states[0]], fs[0][states[1]], fs[1][states[2]], fs[1][states[3]]])
        values = phi[list(states)]
        estimate += np.array([f.sum() / 2, f.mean()]) * (f @ values / f.sum()) / 81
    truth = (fs @ phi).sum() / 3
    return float(estimate[0] / truth - 1), float(estimate[1] / truth - 1)


# --- simulations -----------------------------------------------------------------------------------------------------

KAPPA = 20.0


def paths(sampler: LazySampler, state: LazyState) -> tuple[Array, Array, LazyState]:
    """A camera path of one to three numbers beside the one that says how many, and a light path of two.

    The light's numbers are peaked; with one stream they stand after the camera's, wherever those end.
    """
    first, state = sampler.get(state)
    count = jnp.minimum((3 * first).astype(jnp.int32), 2) + 1
    log_f = jnp.zeros_like(first)
    for j in (1, 2, 3):
        u, state = sampler.get(state, count >= j)
        log_f = log_f + jnp.where(count >= j, jnp.log(0.5 + u), 0)
    if sampler.streams == 2:
        state = sampler.start_stream(state, 1)
    for centre in (0.3, 0.8):
        u, state = sampler.get(state)
        log_f = log_f + KAPPA * (jnp.cos(2 * jnp.pi * (u - centre)) - 1)
    return log_f, count, state


HOLES = np.array([0, 0, 3.0, 0, 0, 0, 1.0, 0, 0, 0])
"""A target on the line that is dark on eight tenths of it."""


def holes(sampler: LazySampler, state: LazyState) -> tuple[Array, Array, LazyState]:
    """One number, and a density with holes."""
    u, state = sampler.get(state)
    cell = jnp.minimum((len(HOLES) * u).astype(jnp.int32), len(HOLES) - 1)
    with np.errstate(divide="ignore"):
        return jnp.asarray(np.log(HOLES), u.dtype)[cell], cell, state


@eqx.filter_jit
def simulate(contribution: Callable, sampler: LazySampler, key: Key, chains: LazyChain, steps: int) -> Array:
    """Sums over the steps, by chain: small steps, their acceptance; those that change the sample, theirs; dark ones."""

    def one(key: Key, chain: LazyChain) -> tuple[LazyChain, Array]:
        after, info = lazy.step(sampler, contribution, chain, jax.random.uniform(key, (sampler.dim_w,)))
        small, other = ~info.large, chain.sample != info.sample
        gained = jnp.stack(
            [small, small * info.acceptance, small & other, (small & other) * info.acceptance, jnp.isneginf(info.log_f)]
        )
        return after, gained.astype(jnp.float32)

    def body(t: Array, carry: tuple[LazyChain, Array]) -> tuple[LazyChain, Array]:
        keys = jax.random.split(jax.random.fold_in(key, t), len(carry[1]))
        after, gained = jax.vmap(one)(keys, carry[0])
        return after, carry[1] + gained

    return jax.lax.fori_loop(0, steps, body, (chains, jnp.zeros((len(chains.log_f), 5))))[1]


def ratio(above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """A ratio of sums over independent chains, and its standard error."""
    value = above.sum() / below.sum()
    return float(value), float(np.sqrt(np.square(above - value * below).sum()) / below.sum())


def dark_share(sigma: float, large_step: float) -> float:
    """The share of dark proposals of the stationary chain on `HOLES`, by Gauss-Legendre quadrature on lit cells."""
    n, (nodes, weights) = len(HOLES), np.polynomial.legendre.leggauss(40)
    pi, lit = HOLES / HOLES.sum(), np.flatnonzero(HOLES)
    reach = 0.0
    for k in lit:
        x = (k + (nodes + 1) / 2) / n
        for j in lit:
            ends = np.array([j, j + 1]) / n + np.arange(-3, 4)[:, None]
            inside = np.diff(ndtr((ends[None] - x[:, None, None]) / sigma), axis=2).sum((1, 2))
            reach += pi[k] * (weights / 2) @ inside
    return float((1 - large_step) * (1 - reach) + large_step * np.mean(HOLES == 0))


def merged_draws(sampler: LazySampler, iteration: int, w: Array) -> Array:
    """A number that stood at 0.3 in iteration 0 and is next read in `iteration`."""
    state = eqx.tree_at(
        lambda s: (s.value, s.stamp, s.iteration, s.large),
        sampler.init(w[0]),
        (jnp.full(1, 0.3), jnp.zeros(1, jnp.int32), jnp.asarray(iteration, jnp.int32), jnp.zeros((), bool)),
    )
    return _read(sampler, state, w)


@eqx.filter_jit
def _read(sampler: LazySampler, state: LazyState, w: Array) -> Array:
    return jax.vmap(lambda numbers: sampler.get(eqx.tree_at(lambda s: s.w, state, numbers[None]))[0])(w)


MERGED = (1, 4, 25)
LARGE = np.array([0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9])
STEP = 0.05
LARGE_STEP = 0.1


def run(config: Config, seed: int, progress: Sweep) -> xr.Dataset:
    """The exact references, then the simulations."""
    errors = np.array([[lazy_errors(replay, p) for p in LARGE] for replay in ("merged", "apart")])
    progress("sampler", 1, 8)
    key, law, reports = jax.random.key(seed), product_law(), []
    for name, replay, zeros in (
        ("missed steps apart", "apart", False),
        ("as published", "merged", False),
        ("gaps zero", "apart", True),
    ):
        kernel = under_test(LazySampler(3, sigma=0.1, large_step=LARGE_STEP, replay=replay), zeros=zeros)
        reports.append(verify.verify(kernel, law, replicas=config.replicas, seed=seed, name=name))
        progress("sampler", 1 + len(reports), 8)
    edges, p_values = np.linspace(0, 1, 65), []
    for k, n in enumerate(MERGED):
        w = jax.random.uniform(jax.random.fold_in(key, k), (config.draws, 4))
        value = merged_draws(LazySampler(1, sigma=STEP), n, w)
        turns = np.arange(-4, 5)[:, None]
        masses = np.diff(ndtr((edges + turns - 0.3) / (STEP * np.sqrt(n))), axis=1).sum(0)
        p_values.append(p_value(np.histogram(np.asarray(value), edges)[0], masses))
    progress("sampler", 5, 8)
    rates = np.zeros((2, 2, 2))
    for k, streams in enumerate((1, 2)):
        sampler = LazySampler(6 if streams == 1 else 4, sigma=STEP, large_step=LARGE_STEP, streams=streams)
        one, two = jax.random.split(jax.random.fold_in(key, 10 + k))
        chains, _ = lazy.bootstrap(sampler, paths, one, config.chains, 32 * config.chains)
        sums = np.asarray(simulate(paths, sampler, two, chains, config.steps), np.float64)
        rates[k] = ratio(sums[:, 1], sums[:, 0]), ratio(sums[:, 3], sums[:, 2])
        progress("sampler", 6 + k, 8)
    sampler = LazySampler(1, sigma=STEP, large_step=LARGE_STEP)
    one, two = jax.random.split(jax.random.fold_in(key, 20))
    chains, _ = lazy.bootstrap(sampler, holes, one, config.chains, 32 * config.chains)
    sums = np.asarray(simulate(holes, sampler, two, chains, config.steps), np.float64)
    dark = ratio(sums[:, 4], np.full(config.chains, config.steps))
    progress("sampler", 8, 8)
    clamped, exact = walls(True)
    plain, expected = deposit_variances(*CHAIN)
    around, _ = walls(False)
    short = [(t, c) for t in range(1, 200) for c in range(1, 50)]
    return xr.Dataset(
        {
            "lazy_tv": (("replay", "large_step"), errors[..., 0]),
            "path_tv": (("replay", "large_step"), errors[..., 1]),
            "verdict": ("kernel", [r.verdict.value for r in reports]),
            "p": ("kernel", [r.p_value for r in reports]),
            "gap": ("kernel", [r.gap for r in reports]),
            "merge_error": ("n", [merging(STEP, n, np.sqrt(n)) for n in MERGED]),
            "merge_wrong": ("n", [merging(STEP, n, n) for n in MERGED]),
            "merge_p": ("n", p_values),
            "draws": config.draws,
            "clamped": ("wall_cell", clamped),
            "around": ("cell", around),
            "wall_exact": ("wall_cell", exact),
            "ratios": ("random", random_ratios(seed)),
            "deposit_bias": deposit_bias(),
            "chain_ratio": expected / plain,
            "startup": (("candidates", "start", "time"), np.stack([startup(m) for m in (1, 4, 16)])),
            "lengths": ("b", list(lengths())),
            "rate": (("streams", "of", "moment"), rates),
            "dark": ("moment", list(dark)),
            "dark_exact": dark_share(STEP, LARGE_STEP),
            "count_error": max(abs(sum(lazy.chain_lengths(t, c)) - t) for t, c in short),
            "count_short": max(t - t // c * c for t, c in short),
        },
        {
            "replay": ["merged", "apart"],
            "large_step": LARGE,
            "n": list(MERGED),
            "start": list(STARTS),
            "candidates": [1, 4, 16],
            "time": TIMES,
            "streams": [1, 2],
            "of": ["all", "camera changed"],
            "moment": ["mean", "error"],
            "b": ["sum", "mean"],
        },
    )


def deposit_bias() -> float:
    """The bias (TV) of expected-value deposits on a ring, every outcome of the library's own kernel enumerated."""
    target, states = verify.ring([1.0, 3.0, 0.5, 2.0, 4.0])
    return verify.enumerate_kernel(verify.RingStep(5, {1: 0.75, -1: 0.25}), target, states).deposit_residual


def draw(data: xr.Dataset) -> Figure:
    """Six panels, a claim each."""
    figure, axes = plt.subplots(2, 3, figsize=(7.0, 4.0))
    a, b, c, d, e, f = axes.ravel()
    for replay, label in (("merged", "as published"), ("apart", "missed steps apart")):
        a.plot(data.large_step, data.lazy_tv.sel(replay=replay), "o-", markersize=3, label=label)
    a.set(xlabel="large-step probability", ylabel="total variation", title="lazy sampler: error of its law")
    a.legend()
    n = data.sizes["cell"]
    x = (np.arange(n) + 0.5) / n
    b.plot(x, n * data.clamped[1:-1], label="clamped")
    b.plot(x, n * data.around, "--", label="wrapped")
    b.plot(x, n * data.wall_exact[1:-1], color="black", linewidth=0.6, label="exact")
    atoms = [float(data.clamped[k]) for k in (0, -1)]
    b.vlines([0, 1], 0, [20 * atom for atom in atoms], color="C0")
    b.plot([0, 1], [20 * atom for atom in atoms], "o", color="C0", markersize=3)
    b.text(0.96, 20 * atoms[1], f"{atoms[1]:.1%} of the law on the wall", ha="right", va="center", fontsize=6)
    b.set(xlabel="u", ylabel="density", ylim=(0, 2.5), title="steps at a wall")
    b.legend(loc="center left", bbox_to_anchor=(0, 0.7))
    c.hist(data.ratios, np.linspace(0, 1.5, 61), color="C0", density=True)
    c.axvline(1, color="black", linewidth=0.6)
    ratio = float(data.chain_ratio)
    c.plot([ratio], [0.05], "v", color="C1", markersize=4)
    c.text(ratio, 0.2, f"the chain\nwith {ratio:.2f}", ha="center", fontsize=6)
    c.set(
        xlabel="variance, expected-value over plain",
        ylabel="random chains",
        title="deposits of three-state chains",
        xlim=(0, 1.65),
    )
    for start, colour in zip(STARTS, ("C2", "C0", "C1"), strict=True):
        bias = np.abs(data.startup.sel(start=start, candidates=4))
        d.plot(data.time, np.maximum(bias, 1e-16), color=colour, label=start)
    d.set(xlabel="steps", ylabel="relative bias", yscale="log", ylim=(1e-17, 100), title="start-up bias, 4 candidates")
    d.set_yticks([1e-15, 1e-10, 1e-5, 1])
    d.legend(loc="center right", bbox_to_anchor=(1, 0.42))
    width = 0.35
    for k, (streams, label) in enumerate(((1, "single counter"), (2, "separate streams"))):
        here = data.rate.sel(streams=streams)
        e.bar(
            np.arange(2) + (k - 0.5) * width, here.sel(moment="mean"), width, yerr=here.sel(moment="error"), label=label
        )
    e.set_xticks([0, 1], ["all small steps", "that change\nthe camera's length"])
    e.set(ylabel="acceptance rate", ylim=(0, 0.6), title="streams")
    e.legend(loc="upper left", ncols=2)
    shares = [float(np.mean(HOLES == 0)), float(data.dark.sel(moment="mean"))]
    f.bar(["independent", "Metropolis"], shares, 0.5, color=["C1", "C0"])
    f.plot([1], [float(data.dark_exact)], "k_", markersize=14, label="exact")
    f.set(ylabel="share of proposals", title="zero contribution, a target with holes")
    f.legend()
    return figure


def table(data: xr.Dataset) -> Table:
    """The claims' numbers."""
    result = Table("claim", "verdict", "measured", box=SIMPLE, padding=0, title="pss_sampler")
    for claim in judge(data):
        result.add_row(claim.id, claim.verdict, claim.number)
    return result


def judge(data: xr.Dataset) -> list[Claim]:
    """Each claim of the section; where one fails, its repair after it."""
    says = lambda true: "holds" if true else "fails"  # noqa: E731
    merged, apart = (data.lazy_tv.sel(replay=r).to_numpy() for r in ("merged", "apart"))
    steps = data.path_tv.max("large_step").to_numpy()
    verdicts, p, gap = (data[name].to_numpy() for name in ("verdict", "p", "gap"))
    tested = f"level 1e-5; detects a CDF gap of {gap[0]:.3f} with probability 0.99"
    wall = data.clamped.to_numpy()
    exact = data.wall_exact.to_numpy()
    n = data.sizes["cell"]
    flow = [total_variation(wall, exact), total_variation(data.around.to_numpy(), exact[1:-1])]
    bias = data.startup
    same, other, uniform = (np.abs(bias.sel(start=s)) for s in STARTS)
    (all_one, all_two), (changed_one, changed_two) = (
        [(float(r[0]), float(r[1])) for r in data.rate.sel(of=of).to_numpy()] for of in ("all", "camera changed")
    )
    z = (changed_two[0] - changed_one[0]) / np.hypot(changed_two[1], changed_one[1])
    dark, dark_error = (float(v) for v in data.dark)
    share = float(np.mean(HOLES == 0))
    off = abs(dark - float(data.dark_exact)) / dark_error
    worse = float((data.ratios > 1).mean())
    return [
        Claim(
            "pss.lazy-equals-eager",
            "The lazy sampler, which backs a number up before the steps it has missed, has the eager one's law",
            f"{BOOK}.4",
            says(max(merged) < 1e-12 and verdicts[1] == "PASS"),
            "fails",
            f"TV {max(merged):.3f} without large steps, {merged[2]:.3f} at 10 %; {verdicts[1]}, p {p[1]:.1e}",
            f"a chain written down, 1e-12; {tested}",
        ),
        Claim(
            "pss.lazy-apart",
            "It has, if the missed steps are taken before the backup and a rejection undoes the last one only",
            "ours",
            says(max(apart) < 1e-12 and float(steps[1]) < 1e-12 and verdicts[0] == "PASS"),
            "holds",
            f"TV {max(apart):.1e}, of the first 64 steps' laws {steps[1]:.1e} (as published {steps[0]:.2g}); "
            f"{verdicts[0]}, p {p[0]:.2g}",
            f"a chain written down, 1e-12; {tested}",
        ),
        Claim(
            "pss.gaps-zero",
            "Gaps may be filled with zeros of time stamp 0: iteration 0 counts as a large step",
            f"{BOOK}.4",
            says(verdicts[2] == "PASS"),
            "fails",
            f"{verdicts[2]}, p {p[2]:.1e}; the repair is a stamp before iteration 0, as in the row above",
            tested,
        ),
        Claim(
            "pss.merged-steps",
            "n missed small steps are one of sigma sqrt(n), around the ends",
            f"{BOOK}.4, eq. 16.23",
            says(float(data.merge_error.max()) < 1e-12 and float(data.merge_p.min()) > 1e-6),
            "holds",
            f"densities differ by {float(data.merge_error.max()):.1e}; the sampler's draws, p "
            f"{float(data.merge_p.min()):.2g}; sigma n would be off by {float(data.merge_wrong[1]):.2g} at n = 4",
            f"convolution, 1e-12; level 1e-6 each, detects a CDF gap of {smallest_gap(int(data.draws), 1e-6):.4f}",
        ),
        Claim(
            "pss.wrap",
            "Wrapping around the ends is symmetric",
            f"{BOOK}.4",
            says(flow[1] < 1e-9),
            "holds",
            f"TV {flow[1]:.1e}",
            f"transition matrix of {n} cells, 1e-9",
        ),
        Claim(
            "pss.clamp",
            "Clamping to the ends would do as well",
            f"{BOOK}.4, which wraps",
            says(flow[0] < 1e-3),
            "fails",
            f"TV {flow[0]:.3f}; {wall[0]:.1%} and {wall[-1]:.1%} of the law stand on the walls",
            f"transition matrix of {n} cells and two walls, 1e-3; sigma 0.1, f = 0.2 + 1.6 u",
        ),
        Claim(
            "pss.expected-deposits",
            "Expected-value deposits are unbiased",
            f"{BOOK}.5",
            says(float(data.deposit_bias) < 1e-12),
            "holds",
            f"TV {float(data.deposit_bias):.1e}",
            "enumeration of the library's kernel on a ring, 1e-12",
        ),
        Claim(
            "pss.deposit-variance",
            "Expected-value deposits always lower the variance",
            f"{BOOK}.5",
            says(float(data.chain_ratio) <= 1 and worse == 0),
            "fails",
            f"one chain has {float(data.chain_ratio):.3f} of the plain one's; {worse:.1%} of random ones are over 1, "
            f"their median {float(data.ratios.median()):.2f}",
            "asymptotic variances by fundamental matrices, exact",
        ),
        Claim(
            "pss.bootstrap",
            "A start chosen by weight removes start-up bias, if the same estimate of b multiplies",
            f"{BOOK}.5; Veach and Guibas 1997",
            says(float(same.max()) < 1e-12),
            "holds",
            f"relative bias {float(same.max()):.1e}: any number of steps, 1 to 16 candidates",
            "all candidates enumerated, 1e-12",
        ),
        Claim(
            "pss.bootstrap-exact-b",
            "The exact b, or one estimated apart, would do as well",
            "ours",
            says(float(other.max()) < 1e-12),
            "fails",
            f"relative bias at the start {', '.join(f'{v:.0%}' for v in other[:, 0].to_numpy())} "
            "with 1, 4, 16 candidates",
            "all candidates enumerated, 1e-12",
        ),
        Claim(
            "pss.uniform-start",
            "A uniform start without weights would do as well",
            f"{BOOK}.5",
            says(float(uniform.max()) < 1e-12),
            "fails",
            f"relative bias {', '.join(f'{float(uniform[0, t]):.1%}' for t in (0, 8, 24))} after 0, 8, 24 steps",
            "transition matrix, 1e-12",
        ),
        Claim(
            "pss.b-sums-lengths",
            "b is the sum over the lengths of the average contribution of each",
            f"{BOOK}.5",
            says(abs(float(data.lengths[0])) < 1e-12),
            "holds",
            f"relative error {float(data.lengths[0]):.1e}; {float(data.lengths[1]):.0%} with the average over all",
            "all candidates enumerated, two lengths, 1e-12",
        ),
        Claim(
            "pss.streams",
            "Separate streams keep a camera change from shifting the light path's numbers",
            f"{BOOK}.4",
            says(z > 5),
            "holds",
            f"small steps that change the camera's length: accepted {changed_two[0]:.3f}, single counter "
            f"{changed_one[0]:.3f}; all: {all_two[0]:.3f}, {all_one[0]:.3f}",
            f"{z:.0f} standard errors, held to 5",
        ),
        Claim(
            "pss.step-count",
            "The step count is exact where it does not divide by the chains",
            f"{BOOK}.5",
            says(int(data.count_error) == 0),
            "holds",
            f"floors that telescope are never off; one rounded-down length for all is short by up to "
            f"{int(data.count_short)} steps",
            "all totals under 200 and chains under 50, exact",
        ),
        Claim(
            "pss.zero-contribution",
            "Metropolis makes fewer samples of zero contribution than independent sampling",
            f"{BOOK}.2, table 16.1",
            says(dark < share and off < 5),
            "holds",
            f"{dark:.1%} against {share:.0%}; exactly {float(data.dark_exact):.2%}, {off:.1f} standard errors off",
            "quadrature; 5 standard errors",
        ),
    ]
