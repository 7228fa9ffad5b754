"""The lazy primary-sample sampler: what a rejection restores, what is replayed, and that the law is the eager one's."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from experiments.support.pss_sampler_law import G, merged_draws, product, product_law, under_test
from experiments.support.pss_sampler_references import lazy_errors
from mcmc1d import lazy
from mcmc1d.lazy import LazySampler
from mcmc1d.verify import verify
from mcmc1d.verify.goodness import p_value

pytestmark = pytest.mark.slow

LAW = product_law()
SIZE: dict[str, Any] = {"sigma": 0.1, "large_step": 0.1}


def numbers(sampler, seed=0):
    return jnp.asarray(np.random.default_rng(seed).random(sampler.dim_w - 1), jnp.float32)


def read(sampler, state, count, stream=0):
    state, values = sampler.start_stream(state, stream), []
    for _ in range(count):
        value, state = sampler.get(state)
        values.append(float(value))
    return values, state


def test_streams_interleave_and_do_not_shift_each_other():
    sampler = LazySampler(3, streams=2)
    w = numbers(sampler)[:-1]
    short = read(sampler, read(sampler, sampler.init(w), 1)[1], 2, 1)
    long = read(sampler, read(sampler, sampler.init(w), 3)[1], 2, 1)
    assert short[0] == long[0] == [float(w[4 * k + 1]) for k in (1, 3)]
    assert [k for k in range(6) if short[1].stamp[k] == 0] == [0, 1, 3]


def test_a_rejection_restores_values_stamps_and_clock():
    sampler = LazySampler(2, large_step=0.0)
    state = sampler.accept(read(sampler, sampler.init(numbers(sampler)[:-1]), 2)[1])
    state = sampler.accept(read(sampler, sampler.start_iteration(state, numbers(sampler, 1)), 1)[1])
    proposed = read(sampler, sampler.start_iteration(state, numbers(sampler, 2)), 2)[1]
    assert np.all(proposed.value != state.value)
    after = sampler.reject(proposed)
    assert after.iteration == state.iteration == 1
    assert after.value[0] == state.value[0]
    # The second number missed an accepted step: that is not undone, and not drawn again.
    assert after.value[1] != state.value[1]
    assert after.stamp.tolist() == [1, 1]
    published = LazySampler(2, large_step=0.0, replay="merged")
    undone = published.reject(read(published, published.start_iteration(state, numbers(sampler, 2)), 2)[1])
    assert undone.value.tolist() == state.value.tolist()
    assert undone.stamp.tolist() == [1, 0]


def test_what_was_not_read_since_a_large_step_is_redrawn_and_a_rejected_one_does_not_count():
    sampler = LazySampler(2, large_step=1.0)
    start = sampler.accept(read(sampler, sampler.init(numbers(sampler)[:-1]), 2)[1])
    large = read(sampler, sampler.start_iteration(start, numbers(sampler, 1)), 1)[1]
    small = LazySampler(2, sigma=1e-6, large_step=0.0)
    w = numbers(sampler, 2)
    redrawn = read(small, small.start_iteration(sampler.accept(large), w), 2)[0]
    assert np.allclose(redrawn, [large.value[0], w[4]], atol=1e-5)
    kept = read(small, small.start_iteration(sampler.reject(large), w), 2)[0]
    assert np.allclose(kept, start.value, atol=1e-5)


def test_a_number_read_twice_is_moved_once():
    sampler = LazySampler(1)
    first, state = read(sampler, sampler.init(numbers(sampler)[:-1]), 1)
    assert read(sampler, state, 1)[0] == first


@pytest.mark.parametrize("n", [1, 9])
def test_missed_steps_are_one_of_sigma_root_n(n):
    """At level 1e-6; 2^15 draws show a CDF gap of 0.022. The twin, sigma n, is seen for n = 9."""
    w = jnp.asarray(np.random.default_rng(n).random((2**15, 4)), jnp.float32)
    edges, turns = np.linspace(0, 1, 33), np.arange(-4, 5)[:, None]
    counts = np.histogram(merged_draws(LazySampler(1, sigma=0.04), n, w), edges)[0]
    masses = [np.diff(ndtr((edges + turns - 0.3) / (0.04 * scale)), axis=1).sum(0) for scale in (np.sqrt(n), n)]
    assert p_value(counts, masses[0]) > 1e-6
    assert (p_value(counts, masses[1]) < 1e-6) == (n == 9)


def test_on_a_chain_written_down_the_published_replay_loses_the_law():
    assert lazy_errors("merged", 0.1)[0] > 0.01
    assert max(lazy_errors("apart", 0.1)) < 1e-13


class ClockLeftAdvanced(LazySampler):
    """A rejection does not turn the clock back."""

    def reject(self, state):
        return eqx.tree_at(lambda s: s.iteration, LazySampler.reject(self, state), state.iteration)


class StampsNotRestored(LazySampler):
    """A rejection restores the values alone."""

    def reject(self, state):
        return eqx.tree_at(lambda s: s.stamp, LazySampler.reject(self, state), state.stamp)


def test_the_law_is_kept():
    """At level 1e-5; 2^14 replicas show a CDF gap of 0.05 with probability 0.99."""
    assert verify(under_test(LazySampler(3, **SIZE)), LAW, replicas=2**14).passed


@pytest.mark.parametrize(
    ("sampler", "zeros"),
    [
        (LazySampler(3, replay="merged", **SIZE), False),
        (LazySampler(3, **SIZE), True),
        (ClockLeftAdvanced(3, **SIZE), False),
        (StampsNotRestored(3, **SIZE), False),
    ],
    ids=["published", "gaps zero", "clock", "stamps"],
)
def test_mistakes_lose_it(sampler, zeros):
    report = verify(under_test(sampler, zeros=zeros), LAW, replicas=2**15)
    assert {failure.layer for failure in report.failures} & {"joint", "marginal"}


def test_bootstrap_chooses_by_contribution():
    """G's quarters and the mean of f, 1, within five standard errors: a right one fails once in 1e5 runs."""
    chains, b = lazy.bootstrap(jax.random.key(0), LazySampler(3), product, chains=2**12, candidates=2**14)
    assert abs(b - 1) < 5 * np.sqrt(np.mean(G**2) ** 2 / 2**14)
    second = np.asarray(chains.sample[:, 1])
    share = np.histogram(second[second >= 0], 4, (0, 1))[0] / np.sum(second >= 0)
    assert np.abs(share - G / 4).max() < 5 * 0.5 / np.sqrt(0.7 * 2**12)


@pytest.mark.parametrize(("total", "chains"), [(7, 5), (10, 3), (3, 8), (0, 2)])
def test_step_counts_are_exact(total, chains):
    lengths = lazy.chain_lengths(total, chains)
    assert sum(lengths) == total
    assert max(lengths) - min(lengths) <= 1


def dark(sampler, state):
    u, state = sampler.get(state)
    return jnp.where(u < 2, -jnp.inf, 0.0), u, state


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LazySampler(0), "LazySampler: dims must be a whole number, 1 at least, not 0"),
        (lambda: LazySampler(1, large_step=1.5), "a probability"),
        (lambda: LazySampler(1, sigma=0.0), "sigma must be positive"),
        (lambda: LazySampler(1, replay="late"), '"apart" or "merged"'),
        (
            lambda: lazy.bootstrap(jax.random.key(0), LazySampler(1), dark, chains=4, candidates=64),
            "zero at all of 64 candidates",
        ),
        (
            lambda: lazy.bootstrap(jax.random.key(0), LazySampler(1), undefined, chains=4, candidates=64),
            r"bootstrap: f is nan at candidate \d+, of the sample .*: let the contribution be 0 there, or define it",
        ),
        (lambda: lazy.chain_lengths(5, 0), "chain_lengths: chains must be a whole number, 1 at least, not 0"),
        (lambda: LazySampler(1, streams=2).start_stream(LazySampler(1).init(jnp.zeros(4)), 2), "no stream 2"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def undefined(sampler, state):
    u, state = sampler.get(state)
    return jnp.where(u < 0.2, jnp.nan, jnp.log1p(u)), u, state


def test_a_chain_stays_where_no_law_is_defined():
    """It was rejected silently, and what the others made looked like a picture."""
    sampler = LazySampler(1, large_step=0.5)
    w = np.random.default_rng(0).random((64, sampler.dim_w), np.float32)
    chain = lazy.start(sampler, undefined, jnp.full(4, 0.5, jnp.float32))
    for row in jnp.asarray(w):
        chain, _ = lazy.step(sampler, undefined, chain, row)
    assert np.isposinf(chain.log_f)


def test_reading_beyond_the_capacity_is_an_error():
    sampler = LazySampler(1)
    with pytest.raises(Exception, match="more than dims=1"):
        read(sampler, sampler.init(jnp.zeros(4)), 2)
