"""Exact draws by rejection, of several densities at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import rendering, starts
from mcmc1d.pixels import Pixels
from mcmc1d.rendering import Scene
from mcmc1d.starts import StartError, accepted
from mcmc1d.state import State

OWNER = np.arange(512) % 4


def batches(densities, seed=0):
    """Candidates that are uniform on [0, 1), of which each row accepts a part."""

    def candidates(batch):
        rng = np.random.default_rng([seed, batch])
        u = rng.random((OWNER.size, 1))
        density = np.array([densities[r](x) for r, x in zip(OWNER, u[:, 0], strict=True)])
        return State(OWNER, u), density, rng.random(OWNER.size)

    return candidates


def test_rows_have_their_own_laws():
    """Means of 4096 draws, each to 6 standard errors (8e-9 in four); begun under a bound of a tenth."""
    densities = [lambda x: 2 * x, lambda x: 2 - 2 * x, lambda x: 3 * x * x, lambda x: 1.0]
    found = accepted("draws", batches(densities), OWNER, np.full(4, 0.3), 4096, "none")
    assert np.array_equal(np.asarray(found.index), np.repeat(np.arange(4), 4096))
    means = np.asarray(found.u).reshape(4, 4096).mean(1)
    assert np.all(np.abs(means - [2 / 3, 1 / 3, 3 / 4, 1 / 2]) < 6 * 0.29 / 64)


def test_what_was_kept_under_a_bound_that_is_passed_is_drawn_again():
    """Of the row whose bound it was; the other keeps its first, and none takes more from the batch that told."""

    def candidates(batch):
        density = np.ones(4)
        if batch == 1:
            density[0] = 10.0  # of row 0, and seen only now
        return State(np.arange(4) % 2, np.full((4, 1), float(batch))), density, np.full(4, 0.05)

    found = accepted("draws", candidates, np.arange(4) % 2, np.full(2, 1.25), 5, "none")
    assert np.array_equal(np.asarray(found.u)[:, 0], [2, 2, 3, 3, 4, 0, 0, 1, 1, 2])


def dim_half():
    """1, and beyond 1/2 half of float32's grain: a function of its own each time, so that it is traced each time."""
    return mcmc1d.targets.FromFunction(lambda x: jnp.where(x < 0.5, 1.0, 2.0**-24), breaks=(0.5,))


def drawn(key, f):
    return mcmc1d.exact_start(key, mcmc1d.Multiplexed(f, mcmc1d.techniques.Uniform()), 4096).u[:, 0]


def begun(key, f):
    scene = Scene(f, mcmc1d.techniques.Uniform(), Pixels(2))
    return rendering._start(jax.random.split(key, 4), scene, jnp.ones((4, 2)), jnp.asarray(1), 1024)[0].u.ravel()


@pytest.mark.parametrize("start", [drawn, begun])
def test_a_dim_half_gets_its_share_and_no_grain_of_float32(start, monkeypatch):
    """Of draws whose number to reject by is under 2^-23: 0.4 of those in the dim half are right, and it kept all.

    6 standard errors of 4096 draws, 2e-9 by the normal law; detects 0.05.
    """

    def lowest(key, step, shape, dtype):
        numbers = mcmc1d.random.uniforms(key, step, shape, dtype)
        return numbers.at[1].set(0) if shape[0] == 3 else numbers

    monkeypatch.setattr(starts, "uniforms", lowest)
    share = 0.4 / 1.4
    found = np.mean(np.asarray(start(jax.random.key(0), dim_half())) >= 0.5)
    assert abs(found - share) < 6 * np.sqrt(share * (1 - share) / 4096)


def test_few_that_are_rare_are_waited_for():
    """Three of a density that one candidate in 30,000 has: none in the first 64 batches was said to be hopeless."""
    rare = [lambda x: float(x < 1 / 30_000)] * 4
    found = accepted("draws", batches(rare, 3), OWNER, np.ones(4), 3, "none")
    assert np.all(np.asarray(found.u) < 1 / 30_000)


def test_few_in_a_batch_are_waited_for_as_long():
    """One candidate a batch, and the first that is lit in batch 10,000, where it was said that there are none."""

    def candidates(batch):
        return State(np.zeros(1, int), np.zeros((1, 1))), np.full(1, float(batch >= 10_000)), np.full(1, 0.5)

    assert accepted("draws", candidates, np.zeros(1, int), np.ones(1), 1, "none").u.shape == (1, 1)


def test_a_density_without_candidates_is_refused():
    """They were waited for, and were told as those of a narrow peak."""
    with pytest.raises(ValueError, match="draws: 5 densities, and a batch of 512 has no candidates for some"):
        accepted("draws", batches([lambda x: 1.0] * 4), OWNER, np.ones(5), 1, "none")


def test_what_is_never_accepted_is_told_before_the_last_candidate():
    def candidates(batch):
        return State(np.zeros(2**16, int), np.zeros((2**16, 1))), np.zeros(2**16), np.ones(2**16)

    with pytest.raises(StartError, match=r"draws: 0 of 5 states after 4194304 candidates.*narrow peak.*give a lamp"):
        accepted("draws", candidates, np.zeros(2**16, int), np.ones(1), 5, "a lamp")


def test_no_more_candidates_are_taken_than_were_allowed():
    """Of four rows with 128 of a batch each, of which one takes a thousand candidates a state: not 1024, but 2^20."""
    rare = [lambda x: float(x < 0.001)] + [lambda x: 1.0] * 3
    with pytest.raises(StartError, match=r"draws: [0-3] of 512 states after 1024 candidates"):
        accepted("draws", batches(rare, 3), OWNER, np.ones(4), 512, "none", most=1024)
    assert accepted("draws", batches(rare, 3), OWNER, np.ones(4), 512, "none", most=2**20).u.shape == (2048, 1)


def test_no_light_to_start_from_has_an_error_of_its_own():
    narrow = mcmc1d.targets.FromFunction(lambda x: jnp.where(jnp.abs(x - 0.3) < 1e-7, 1.0, 0.0))
    target = mcmc1d.Multiplexed(narrow, mcmc1d.techniques.Uniform(), probes=0)
    with pytest.raises(StartError, match="nothing to start from"):
        mcmc1d.exact_start(jax.random.key(0), target, 4)
