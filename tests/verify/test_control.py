"""A law's log-density held to its draws by a walk of the library's own: a right law is doubted with 1e-9."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.verify import Law, Verdict, laws, verify
from mcmc1d.verify.adapters import as_subject
from mcmc1d.verify.control import doubts
from mcmc1d.verify.energy import Energy
from mcmc1d.verify.sampler import Sampler, slack

SPIKE = 0.5
RIGHT = {
    "ridge": laws.ridge(),
    "a circle, whose angles end": Law(
        lambda rng, n: rng.vonmises(0.5, 2, (n, 2)), log_density=lambda x: 2 * jnp.sum(jnp.cos(x - 0.5))
    ),
    "heavy tails": Law(lambda rng, n: rng.standard_cauchy((n, 3)), log_density=lambda x: -jnp.sum(jnp.log1p(x * x))),
    "poles at walls": Law(
        lambda rng, n: rng.beta(0.3, 0.6, (n, 2)),
        log_density=lambda x: -jnp.sum(0.7 * jnp.log(x) + 0.4 * jnp.log1p(-x)),
        support=(np.zeros(2), np.ones(2)),
    ),
    "a simplex, on which no step stays": Law(
        lambda rng, n: rng.dirichlet([2, 3, 4], n), log_density=lambda x: jnp.sum(jnp.array([1.0, 2, 3]) * jnp.log(x))
    ),
    "an atom beside a normal, at which no step has a density": Law(
        lambda rng, n: np.where(rng.random((n, 2)) < [SPIKE, 0], 0, rng.normal(size=(n, 2))),
        log_density=lambda x: -0.5 * jnp.sum(x * x),
    ),
    "whole numbers and a tree": Law(
        lambda rng, n: {"k": (k := rng.integers(0, 4, n)), "x": rng.normal(k, 1.0)},
        log_density=lambda p: -0.5 * (p["x"] - p["k"]) ** 2,
    ),
}


def sampler(law):
    subject = as_subject(lambda key, x: x, law, law, reversible=None, deposits=None, max_weight=1.0)
    made = Sampler(law, subject, (1, 2), (1,), 1.0)
    made.energy, made.slack = Energy(law), slack(made.draw("design", 0, 0, 2**10))
    return made


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_law_is_not_doubted(name):
    assert doubts(sampler(RIGHT[name])) == []


@pytest.mark.parametrize("name", ["ridge", "a circle, whose angles end", "poles at walls", "whole numbers and a tree"])
def test_a_density_of_another_temperature_is_told(name):
    law = RIGHT[name]
    assert "log_density or sample is wrong" in doubts(sampler(replace(law, log_density=hot(law))))[0]


def hot(law):
    return lambda x: 0.6 * law.log_density(x)


def test_a_walk_on_a_mistyped_density_fails_with_the_hint_and_a_wrong_one_on_the_right_density_without():
    right = RIGHT["ridge"]
    wrong = replace(right, log_density=hot(right))

    def walk(log_f):
        def step(key, x):
            first, second = jax.random.split(key)
            y = x + 0.8 * jax.random.normal(first, x.shape)
            return jnp.where(jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x), y, x)

        return step

    for law in (right, wrong):
        report = verify(walk(wrong.log_density), law, replicas=2**13)
        assert report.verdict is Verdict.FAIL
        assert any("log_density or sample" in line for line in report.diagnosis) == (law is wrong)
