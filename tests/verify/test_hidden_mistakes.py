"""Mistakes that no single coordinate shows: parts never reached, rotations, couplings; laws that contradict themselves.

Each beside a right kernel that passes; at level 1e-5 a right one fails with that probability.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from mcmc1d.verify import Law, LawError, Verdict, verify


def normal(d):
    shape = () if d == 1 else (d,)
    return Law(
        sample=lambda rng, n: rng.normal(size=(n, *shape)), cdf=ndtr, log_density=lambda x: -0.5 * jnp.sum(x * x)
    )


def autoregressive(key, x):
    return 0.5 * x + np.sqrt(0.75) * jax.random.normal(key, x.shape)


def keeps_a_sign(key, x):
    """The sign of the product of all coordinates never changes."""
    y = jax.random.normal(key, x.shape)
    return jnp.where(jnp.prod(y) * jnp.prod(x) > 0, y, x)


def keeps_a_fifth_apart(key, x):
    y = jax.random.normal(key, x.shape)
    return jnp.where((abs(x) < 0.2533) == (abs(y) < 0.2533), y, x)


def rotates(key, x):
    turn = jnp.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]], x.dtype)
    return 0.9 * (turn @ x) + np.sqrt(1 - 0.81) * jax.random.normal(key, x.shape)


def couples(key, x):
    y = autoregressive(key, x)
    return y.at[9].set(jnp.abs(y[9]) * jnp.sign(y[0]))


@pytest.mark.parametrize(
    ("kernel", "d"),
    [*(pytest.param(keeps_a_sign, n, marks=pytest.mark.slow) for n in (2, 3)), (keeps_a_fifth_apart, 1)],
)
def test_a_kernel_that_never_gets_everywhere_does_not_pass(kernel, d):
    report = verify(kernel, normal(d), replicas=2**15)
    assert report.verdict is Verdict.INCONCLUSIVE
    assert "has not forgotten a bad start" in report.reasons[0]
    assert verify(autoregressive, normal(d), replicas=2**15, reversible=True).passed


def test_a_rotation_is_not_reversible_though_each_coordinate_is():
    assert verify(rotates, normal(2), replicas=2**15).passed
    report = verify(rotates, normal(2), replicas=2**15, reversible=True)
    assert report.reasons == ["it is declared reversible and is not: x[0] with x[1] after 1 step"]


@pytest.mark.slow
def test_of_many_coordinates_others_than_neighbours_are_looked_at_together():
    """In 2^15 replicas; of twelve coordinates 64 of the 66 pairs are."""
    assert verify(couples, normal(12), replicas=2**15, ergodic=False).verdict is Verdict.FAIL
    assert verify(autoregressive, normal(12), replicas=2**15).passed


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (Law(sample=lambda rng, n: rng.normal(size=n), cdf=ndtr, support=(0, 1)), "lies outside its support"),
        (
            Law(sample=lambda rng, n: rng.normal(size=(n, 2)), cdf=ndtr, log_density=lambda x: jnp.nan * x[0]),
            "its log_density is nan at its own draw",
        ),
        (
            Law(sample=lambda rng, n: np.maximum(rng.normal(size=n), 0), cdf=lambda x: np.where(x >= 0, ndtr(x), 0)),
            "of 16384 draws are x = 0: .* say so by `statistics`",
        ),
    ],
)
def test_a_law_that_contradicts_itself_is_named_and_not_the_kernel(law, said):
    with pytest.raises(LawError, match=said):
        verify(autoregressive, law)


def takes_a_magnitude(of, to):
    """Independent draws, but that one coordinate has the other's magnitude: each alone, and all signs, are right."""

    def step(key, x):
        y = jax.random.normal(key, x.shape)
        return y.at[to].set(jnp.sign(y[to]) * jnp.abs(y[of]))

    return step


def takes_a_magnitude_of_two(key, x):
    """Of three coordinates, whose magnitudes are large once or three times together: every two of them are right."""
    y = jax.random.normal(key, x.shape)
    large = jnp.abs(y) > 0.6745
    turned = jnp.sign(y) * jnp.abs(normal_tail(y))
    return jnp.where((large[0] ^ large[2] ^ large[4]) | (jnp.arange(5) != 4), y, turned)


def normal_tail(y):
    """The number of the other half of the magnitudes, so that a normal y stays normal."""
    p = 2 * jax.scipy.stats.norm.cdf(-jnp.abs(y))
    return jax.scipy.stats.norm.ppf(((p + 0.5) % 1) / 2)


@pytest.mark.parametrize(
    ("kernel", "d"),
    [
        (takes_a_magnitude(0, 2), 4),
        (takes_a_magnitude(0, 3), 4),
        pytest.param(takes_a_magnitude(0, 4), 8, marks=pytest.mark.slow),
        pytest.param(takes_a_magnitude_of_two, 5, marks=pytest.mark.slow),
    ],
)
def test_a_coupling_through_magnitudes_is_seen_without_a_density(kernel, d):
    law = Law(sample=lambda rng, n: rng.normal(size=(n, d)), cdf=ndtr)
    report = verify(kernel, law, replicas=2**15)
    assert report.verdict is Verdict.FAIL
    assert {failure.layer for failure in report.failures} == {"joint"}
    right = verify(autoregressive, law, replicas=2**15)
    assert right.passed
    assert ("three coordinates" in right.untested[1]) == (d > 5)
