"""Exact draws by rejection, of several densities at once."""

import numpy as np
import pytest

from mcmc1d.starts import accepted
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


def test_rows_have_their_own_laws_and_a_bound_that_is_passed_is_raised():
    """Means of 128 times 32 draws, each to 6 standard errors (8e-9 in four); begun under a bound of a tenth.

    Of few draws: what was kept from before the bound was raised would be most of them.
    """
    densities = [lambda x: 2 * x, lambda x: 2 - 2 * x, lambda x: 3 * x * x, lambda x: 1.0]
    means = []
    for seed in range(128):
        found = accepted("draws", batches(densities, seed), OWNER, np.full(4, 0.3), 32, "none")
        assert np.array_equal(np.asarray(found.index), np.repeat(np.arange(4), 32))
        means.append(np.asarray(found.u).reshape(4, 32).mean(1))
    assert np.all(np.abs(np.mean(means, 0) - [2 / 3, 1 / 3, 3 / 4, 1 / 2]) < 6 * 0.29 / 64)


def test_few_that_are_rare_are_waited_for():
    """Three of a density that one candidate in 30,000 has: none in the first 64 batches was said to be hopeless."""
    rare = [lambda x: float(x < 1 / 30_000)] * 4
    found = accepted("draws", batches(rare, 3), OWNER, np.ones(4), 3, "none")
    assert np.all(np.asarray(found.u) < 1 / 30_000)


def test_what_is_never_accepted_is_told_before_the_last_candidate():
    def candidates(batch):
        return State(np.zeros(2**16, int), np.zeros((2**16, 1))), np.zeros(2**16), np.ones(2**16)

    with pytest.raises(ValueError, match=r"draws: 0 of 5 states after 4194304 candidates.*narrow peak.*give a lamp"):
        accepted("draws", candidates, np.zeros(2**16, int), np.ones(1), 5, "a lamp")
