"""Laws whose cells, densities or numbers hid a mistake: what is looked at, and what a PASS says that it is not.

At level 1e-5 a right kernel fails with that probability; 2^15 replicas show a CDF gap of 0.02 to 0.04. In NumPy, where
nothing is compiled; in float32, where roundings are coarse.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from mcmc1d import Multiplexed
from mcmc1d.metropolis import Deposits, Info, Kernel, Step
from mcmc1d.state import State
from mcmc1d.targets import Target
from mcmc1d.techniques import Uniform
from mcmc1d.verify import Discrete, HostKernel, JaxKernel, Law, Verdict, verify
from mcmc1d.verify.ends import cell_ends
from mcmc1d.verify.law import multiplexed_law
from mcmc1d.verify.library import LibrarySubject
from mcmc1d.verify.sampler import Sampler

SIZE = {"replicas": 2**15}
N = 2**14


def single(sample):
    """A law in float32, and its own draws as a kernel."""

    def draws(rng, n):
        return np.asarray(sample(rng, n), np.float32)

    return Law(draws), HostKernel(lambda rng, x: draws(rng, len(x)))


def exactly(sample, **known):
    """A law, and its own draws as a kernel."""
    return Law(sample, **known), HostKernel(lambda rng, x: sample(rng, len(x)))


# --- cells ---

BROAD = {
    "Levy": lambda rng, n: 0.5 / rng.gamma(0.5, size=n),
    "inverse gamma 1/4": lambda rng, n: 0.25 / rng.gamma(0.25, size=n),
    "lognormal 7": lambda rng, n: np.exp(7 * rng.normal(size=n)),
    "horseshoe": lambda rng, n: rng.standard_cauchy(n) * rng.standard_cauchy(n) * rng.normal(size=n),
    "funnel": lambda rng, n: rng.normal(size=n) * np.exp(5 * rng.normal(size=n)),
    "spike": lambda rng, n: np.where(rng.random(n) < 0.5, 0, rng.normal(size=n)),
    "gamma 0.01": lambda rng, n: np.maximum(rng.gamma(0.01, size=n), 1e-45),
    "beta 0.02": lambda rng, n: rng.beta(0.02, 0.02, size=n),
    "far off": lambda rng, n: 1e4 + rng.normal(size=n),
    "Zipf": lambda rng, n: np.minimum(rng.zipf(1.5, n), 1e12),
    "integers": lambda rng, n: rng.integers(-(2**31), 2**31, n),
}


@pytest.mark.parametrize("name", BROAD)
def test_cells_are_narrow_in_any_law(name):
    """Of other draws, 16384, no cell has 1/32 but by a value or its roundings: 1/64 and 11 standard deviations."""
    rng = np.random.default_rng(3)
    draws, again = (
        np.asarray(BROAD[name](rng, N)).astype(np.int32 if name == "integers" else np.float32) for _ in "ab"
    )
    found = cell_ends(draws, 64)
    assert np.all(np.diff(found.inner) > 0)
    assert 1 / 65 <= found.widest < 1 / 32
    assert found.blurred == 0
    cell = np.searchsorted(found.inner, again.astype(np.float64), side="right")
    for k in np.flatnonzero(np.bincount(cell) > N / 32):
        inside = again[cell == k]
        values, counts = np.unique(np.where(np.abs(inside) < 1e-36, 0, inside), return_counts=True)
        near = np.abs(values - values[np.argmax(counts)]) <= 4e-6 * np.abs(values)
        assert counts[~near].sum() < N / 32


def test_cells_of_decimals_do_not_end_within_their_roundings():
    """Zero comes out of decimals in several ways; the differences of powers of ten are none, where that can be told."""
    rng = np.random.default_rng(4)
    values = (rng.integers(-50, 51, N) * 0.1 + 0.1 + 0.2 - 0.3).astype(np.float64)
    values[::2] = np.round(values[::2], 1)
    found = cell_ends(values, 256)
    assert len(found.inner) == 100
    assert np.abs(found.inner * 20 - np.round(found.inner * 20)).max() < 1e-9
    assert 0 < found.blurred < 1e-12
    powers = cell_ends((10.0 ** rng.integers(-3, 4, N)).astype(np.float32), 64)
    assert (len(powers.inner), powers.widest, powers.blurred) == (6, 0, 0)
    wide = cell_ends((10.0 ** rng.integers(-3, 13, N)).astype(np.float32), 64)
    assert wide.blurred > 1e3


def floored(sample, least):
    return HostKernel(lambda rng, x: np.maximum(sample(rng, len(x)), least).astype(x.dtype))


def test_a_mistake_in_the_body_of_a_law_with_a_heavy_tail_is_seen():
    """32 % of the law were below 1, and all of that in one cell, for the largest draw is 1e8."""
    law, right = single(BROAD["Levy"])
    report = verify(right, law, **SIZE)
    assert report.passed
    assert report.resolution < 0.02
    assert verify(floored(BROAD["Levy"], 1), law, **SIZE).verdict is Verdict.FAIL


def test_a_coupling_in_the_body_of_heavy_tails_is_seen():
    """A location that is drawn for another scale than its own: both marginals are right."""

    def sample(rng, n):
        scale = 0.15 / rng.gamma(0.15, size=n)
        return np.stack([scale, np.sqrt(scale) * rng.normal(size=n)], 1).clip(-3e38, 3e38).astype(np.float32)

    def stale(rng, x):
        return np.stack([sample(rng, len(x))[:, 0], sample(rng, len(x))[:, 1]], 1)

    law, right = exactly(sample)
    assert verify(right, law, reversible=True, **SIZE).passed
    report = verify(HostKernel(stale), law, reversible=True, **SIZE)
    assert {failure.layer for failure in report.failures} == {"joint"}


# --- what has no order ---

WEIGHTS = np.array([0.2, 0.3, 0.5])


def test_of_values_without_an_order_a_difference_in_probability_is_what_is_bought():
    kinds = {"x": Discrete(lambda x: x, WEIGHTS)}
    law, right = exactly(lambda rng, n: rng.choice(3, n, p=WEIGHTS), statistics=kinds)
    wrong = HostKernel(lambda rng, x: rng.integers(3, size=len(x)))
    for options in ({"replicas": 16}, {"replicas": 2**12, "gap": 0.005}):
        report = verify(right, law, **options)
        assert report.verdict is Verdict.INCONCLUSIVE
        assert "out of reach" in report.reasons[0]
    assert verify(wrong, law, replicas=16, gap=0.005).verdict is not Verdict.PASS
    report = verify(right, law, **SIZE)
    assert report.passed
    assert 0.01 < report.gap < 0.03
    assert "in a cell's probability" in str(report)
    failed = verify(wrong, law, **SIZE)
    assert failed.reasons[0].startswith("the law of x is wrong")


# --- the density ---


def comb(rng, n):
    """Density sin^2(5000 pi x), by its values over one period."""
    turns = np.linspace(0, 1, 4097)
    place = np.interp(rng.random(n), turns - np.sin(2 * np.pi * turns) / (2 * np.pi), turns)
    return (rng.integers(5000, size=n) + place) / 5000


def test_on_the_line_a_density_is_looked_at_where_no_cdf_is():
    law, right = exactly(comb, log_density=lambda x: 2 * jnp.log(jnp.abs(jnp.sin(5000 * jnp.pi * x))), support=(0, 1))
    assert verify(right, law, **SIZE).passed
    report = verify(HostKernel(lambda rng, x: rng.random(len(x))), law, **SIZE)
    assert {failure.layer for failure in report.failures} == {"density"}


def two_rooms(rng, n):
    return (x := rng.random(n)) + (x > 0.3)


ROOMS, ROOMMATE = exactly(
    two_rooms,
    cdf=lambda x: np.clip(np.where(x < 1, np.minimum(x, 0.3), x - 1), 0, 1),
    log_density=lambda x: jnp.where((x >= 0) & (x <= 0.3) | (x > 1.3) & (x <= 2), 0.0, -jnp.inf),
)


@pytest.mark.parametrize(("rate", "verdict"), [(0, Verdict.PASS), (3e-5, Verdict.INCONCLUSIVE), (2e-3, Verdict.FAIL)])
def test_replicas_where_the_density_is_zero_are_a_doubt_and_many_a_failure(rate, verdict):
    """Between the rooms, where the CDF is as flat as at their walls."""
    wrong = HostKernel(
        lambda rng, x: np.where(rng.random(len(x)) < rate, 0.3 + 0.1 * rng.random(len(x)), two_rooms(rng, len(x)))
    )
    report = verify(wrong, ROOMS, replicas=2**16)
    assert report.verdict is verdict
    assert report.passed or "where the density is zero" in report.reasons[0]


def test_draws_whose_density_rounds_to_zero_are_no_mistake():
    """One of 500: as many replicas come there as leave."""
    law, right = exactly(
        lambda rng, n: rng.normal(size=n),
        cdf=ndtr,
        log_density=lambda x: jnp.where(jnp.abs(x) > 3.09, -jnp.inf, -0.5 * x * x),
    )
    assert verify(right, law, **SIZE).passed


def test_a_number_that_is_rounded_onto_a_wall_is_inside():
    """Zero comes out of float32's uniform numbers once in 2^23, where the density of an open interval is zero."""
    law, _ = exactly(
        lambda rng, n: 1 - rng.random((n, 2)),
        cdf=lambda x: np.clip(x, 0, 1),
        log_density=lambda x: jnp.where(jnp.all((x > 0) & (x <= 1)), 0.0, -jnp.inf),
    )
    rounds = HostKernel(lambda rng, x: (y := 1 - rng.random(x.shape)) * (y > 1e-4 * (np.arange(2) == 0)))
    below = HostKernel(lambda rng, x: (y := 1 - rng.random(x.shape)) - (y < 1e-4) * y * 1.5)
    assert verify(rounds, law, **SIZE).passed
    assert verify(below, law, **SIZE).verdict is Verdict.INCONCLUSIVE


class Strips(Target):
    """On [0, 1], every second of 2^14 strips: too narrow for bins."""

    def log_f(self, x):
        return jnp.where((x >= 0) & (x < 1) & (jnp.floor(x * 2**14) % 2 == 0), 0.0, -jnp.inf)

    def bin_masses(self, edges):
        e = np.clip(np.asarray(edges, np.float64), 0, 1) * 2**14
        return np.diff(np.floor(e / 2) + np.minimum(e % 2, 1)) / 2**14


class Fresh(Kernel):
    """Goes to a fresh u, unless it looks and the density is zero there."""

    looks: jax.Array

    @property
    def kinds(self):
        return ("fresh",)

    def dim_w(self, target):
        return target.dim_u

    def check(self, target):
        pass

    def step(self, target, state, w):
        new = target.evaluate(State(state.index, w))
        goes = (new.seen.log_c > -jnp.inf) | ~self.looks
        new = jax.tree.map(partial(jnp.where, goes), new, state)
        deposits = Deposits(new.seen.x[None], jnp.asarray(new.index)[None], jnp.ones(1))
        return Step(new, deposits, Info(jnp.zeros(1, int), jnp.ones(1), jnp.ones(1, bool)))


@pytest.mark.parametrize("looks", [True, False])
def test_states_of_the_library_where_the_density_is_zero_are_counted(looks):
    """Of 8192, which all start where it is not, half and less than 10 standard deviations more, or none."""
    target = Multiplexed(Strips(), Uniform(), probes=0)
    sampler = Sampler(multiplexed_law(target), LibrarySubject(Fresh(jnp.asarray(looks)), target, False), (0,))
    u = np.float32((np.arange(2**13) * 2 + 0.5) / 2**14)
    start = {"index": np.zeros(2**13, np.int32), "x": u, "u": u[:, None]}
    (look,) = sampler.subject.walk((1, 2), start, (1,))
    count, example = sampler.outside(start, look, 1)
    assert (count == 0) if looks else (3700 < count < 4500)
    assert looks or example.endswith("where the density is zero")


# --- joint laws ---


def board(rng, n):
    """Every second of 20 x 20 squares."""
    i = rng.integers(20, size=n)
    return (np.stack([i, 2 * rng.integers(10, size=n) + i % 2], 1) + rng.random((n, 2))) / 20


def log_board(x):
    return jnp.where(jnp.sum(jnp.floor(20 * x)) % 2 == 0, 0.0, -jnp.inf)


def test_a_pass_says_how_finely_joint_laws_are_looked_at():
    law, _ = exactly(board, cdf=lambda x: np.clip(x, 0, 1))
    wrong = HostKernel(lambda rng, x: rng.random(x.shape))
    said = "the joint law of x[0], x[1] within 10 x 10 cells; a log_density in the law shows much of it"
    assert said in verify(wrong, law, **SIZE).untested
    law, right = exactly(board, cdf=law.cdf, log_density=log_board)
    assert verify(wrong, law, **SIZE).verdict is Verdict.FAIL
    assert not any("joint" in what for what in verify(right, law, **SIZE).untested)
    law, right = exactly(lambda rng, n: rng.integers(3, size=(n, 2)))
    assert not any("joint" in what for what in verify(right, law, **SIZE).untested)


# --- integers ---


def test_integers_over_their_whole_range_vary():
    """Their largest less their smallest does not fit their own type."""

    def words(rng, n):
        return rng.integers(-(2**31), 2**31, n).astype(np.int32)

    law, right = exactly(words)
    report = verify(right, law, **SIZE)
    assert report.passed
    assert report.gap < 0.05
    low = HostKernel(lambda rng, x: x ^ rng.integers(2**31, size=len(x)).astype(np.int32))
    assert "not forgotten a bad start" in verify(low, law, replicas=2**10, gap=0.5).reasons[0]
    half = HostKernel(lambda rng, x: words(rng, len(x)) & np.int32(2**31 - 1))
    assert verify(half, law, **SIZE).verdict is Verdict.FAIL
    wide, _ = exactly(lambda rng, n: rng.integers(2**32, size=n, dtype=np.uint32))
    with pytest.raises(ValueError, match="do not fit int32"):
        verify(JaxKernel(lambda key, x: x), wide)
