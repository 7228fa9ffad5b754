"""What the figures of flatland compute apart from chains: proposals of techniques, and shadow rays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.support.flatland_chains import MOVES, close, mixes, others
from experiments.support.flatland_shadow import shadow_ray
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import BidirectionalPathTracing
from mcmc1d.flatland.scenes import scene
from mcmc1d.state import State


@pytest.mark.parametrize(("n", "sigma"), [(2, 0.05), (5, 0.05), (6, 0.01), (12, 0.05), (4, 0.7)])
def test_a_small_step_proposes_techniques_as_often_as_its_floor_does(n, sigma):
    """Against a million numbers that step: 1e-8 false alarms in n entries (6 s.e.), which see 0.3 / sqrt(size / n)."""
    rng, size = np.random.default_rng(1), 10**6
    v = rng.random(size)
    there = (v + sigma * rng.standard_normal(size)) % 1
    first = np.floor(n * v).astype(int) == 0
    measured = np.bincount(np.floor(n * there[first]).astype(int), minlength=n) / first.sum()
    matrix = close(n, sigma)
    assert np.all(np.abs(matrix[0] - measured) < 6 * np.sqrt(matrix[0] * (1 - matrix[0]) / first.sum()) + 1e-9)
    assert np.array_equal(matrix, matrix.T)
    assert matrix.min() >= 0
    assert np.allclose(matrix.sum(1), 1, atol=1e-12)
    # A twin that must fail: all techniques alike.
    if sigma < 0.5:
        assert np.abs(1 / n - measured).max() > 0.05


def test_each_method_is_a_mixture_and_a_change_changes():
    for mix, matrix in mixes(5, 0.05, 0.1, 0.05).values():
        assert set(mix) <= set(MOVES)
        assert sum(mix.values()) == pytest.approx(1)
        assert not np.diag(matrix).any()
        assert np.array_equal(matrix, matrix.T)
        assert np.allclose(matrix.sum(1), 1)


def test_keeping_and_changing_together_are_the_small_step_of_mmlt():
    mix, matrix = mixes(5, 0.05, 0.1, 0.05)["MMLT"]
    together = (mix["keep"] * np.eye(5) + mix["change"] * matrix) / 0.9
    assert np.allclose(together, close(5, 0.05), atol=1e-12)
    assert not np.allclose(others(close(5, 0.05)), close(5, 0.05), atol=0.1)


def test_a_joined_path_of_lambert_walls_is_dark_where_its_shadow_ray_is_blocked_or_not_cast():
    """And nowhere else: light is worked out without geometry's look at all edges, which the shadow ray is read from."""
    paths = Paths(scene("box"), 2)
    target = BidirectionalPathTracing().target(paths)
    u = jnp.asarray(np.random.default_rng(0).random((2000, target.dim_u)))
    index = jnp.arange(2000, dtype=jnp.int32) % target.n_techniques

    def look(index, u):
        seen = target.evaluate(State(index, u)).seen
        return seen.log_f > -jnp.inf, *shadow_ray(target, paths, index, seen.x)

    lit, cast, blocked = (np.asarray(a) for a in jax.jit(jax.vmap(look))(index, u))
    joined = np.asarray(target.family.lengths)[np.asarray(index)] <= 2
    assert np.array_equal(lit[joined], (cast & ~blocked)[joined])
    assert not cast[~joined].any()
    assert min(blocked.mean(), (joined & ~cast).mean()) > 0.005
