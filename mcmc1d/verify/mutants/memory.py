"""Kernels that carry what they should not, or forget what they should carry; and estimators that lose weight."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from mcmc1d.types import Array, Key
from mcmc1d.verify.kernels import JaxKernel
from mcmc1d.verify.law import Law
from mcmc1d.verify.laws import correlated, two_modes, walls
from mcmc1d.verify.mutants import Mutant, Trap


def half_restored(law: Law, *, mistake: bool):
    """A walk of both coordinates; the mistake: a rejection restores the first one only."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        y = x + 0.8 * jax.random.normal(first, x.shape)
        accepted = jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x)
        return jnp.where(accepted, y, x.at[1].set(y[1]) if mistake else x)

    return kernel


def lazy(law: Law, correlation: float, *, mistake: bool) -> JaxKernel:
    """A walk in the plane of which only the first coordinate is looked at; the second starts when first touched.

    The right start is its law given the first; the mistake: it starts at 0.
    """
    log_f: Any = law.log_density

    def init(key: Key, x: Array) -> Array:
        rest = float(np.sqrt(1 - correlation**2)) * jax.random.normal(key)
        return jnp.stack([x, jnp.zeros_like(x) if mistake else correlation * x + rest])

    def step(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        y = x + 0.8 * jax.random.normal(first, (2,))
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x), y, x)

    return JaxKernel(step, init, lambda state: state[0], name="lazy walk")


def noisy(law: Law, *, mistake: bool):
    """A walk that sees f through an unbiased estimate, by a number the chain does not keep; or f itself."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        keys = jax.random.split(key, 3)
        y = x + jax.random.normal(keys[0])
        noise = jnp.log(0.2 + 1.6 * jax.random.uniform(keys[1], (2,))) if mistake else jnp.zeros(2)
        # The noise at x is drawn again each time, with a variance that depends on where it is.
        log_ratio = log_f(y) - log_f(x) + jnp.where(y > 0, noise[0], 0) - jnp.where(x > 0, noise[1], 0)
        return jnp.where(jnp.log(jax.random.uniform(keys[2])) < log_ratio, y, x)

    return kernel


def adaptive(law: Law, *, mistake: bool) -> JaxKernel:
    """A walk whose size follows its own acceptance for ever; or one of a fixed size."""
    log_f: Any = law.log_density

    def step(key: Key, state: tuple[Array, Array]) -> tuple[Array, Array]:
        x, log_size = state
        first, second = jax.random.split(key)
        y = x + jnp.exp(log_size) * jax.random.normal(first)
        accepted = jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x)
        rate = 0.5 if mistake else 0.0
        return jnp.where(accepted, y, x), jnp.clip(log_size + rate * (accepted - 0.5), -4.0, 2.0)

    return JaxKernel(step, lambda key, x: (x, jnp.zeros_like(x)), lambda state: state[0], name="adaptive walk")


def late(law: Law, *, mistake: bool) -> JaxKernel:
    """A walk with a clock; the mistake: a rejected step leaves the clock advanced, and each eighth hour is wrong.

    The clock starts at a random hour, as a chain's that has run for long.
    """
    log_f: Any = law.log_density

    def init(key: Key, x: Array) -> tuple[Array, Array]:
        return x, jax.random.randint(key, (), 0, 8)

    def step(key: Key, state: tuple[Array, Array]) -> tuple[Array, Array]:
        x, hour = state
        first, second = jax.random.split(key)
        y = x + jax.random.normal(first)
        log_ratio = log_f(y) - log_f(x)
        if mistake:
            log_ratio = jnp.where(hour == 7, 0.5 * log_ratio, log_ratio)
        accepted = jnp.log(jax.random.uniform(second)) < log_ratio
        return jnp.where(accepted, y, x), (hour + 1) % 8

    return JaxKernel(step, init, lambda state: state[0], name="walk with a clock")


def depositing(law: Law, *, mistake: str = "") -> JaxKernel:
    """A walk that deposits 1 - a on the current and a on the proposed point, or something else."""
    log_f: Any = law.log_density

    def step(key: Key, x: Array) -> tuple[Array, Any]:
        first, second = jax.random.split(key)
        y = x + 0.6 * jax.random.normal(first)
        a = jnp.exp(jnp.minimum(log_f(y) - log_f(x), 0.0))
        return jnp.where(jax.random.uniform(second) < a, y, x), (x, y, a)

    def deposits(state: Array, info: Any) -> tuple[Array, Array]:
        x, y, a = info
        points, weights = jnp.stack([x, y]), jnp.stack([1 - a, a])
        if mistake == "a factor":
            weights = weights / 3
        elif mistake == "another norm":
            # The accept test compares f; the weights a ratio of another function of it.
            b = jnp.exp(jnp.minimum(0.5 * (log_f(y) - log_f(x)), 0.0))
            weights = jnp.stack([1 - b, b])
        elif mistake == "dark proposals":
            weights = jnp.where(log_f(y) > -jnp.inf, weights, jnp.array([0.5, 0.0]))
        elif mistake == "vanishing importance":
            # f / I with an importance that is zero on x < 0.3: what lies there is never deposited.
            weights = jnp.where(points < 0.3, 0.0, weights)
        elif mistake == "proposal only":
            points, weights = points[1:], jnp.ones(1)
        return points, weights

    return JaxKernel(step, deposits=deposits, name="walk with deposits")


_MODES, _WALLS, _CORRELATED = two_modes(), walls(), correlated(0.8)


def _first(law: Law) -> Law:
    """The first of two standard normal coordinates."""
    return Law(lambda rng, n: law.sample(rng, n)[:, 0], cdf=ndtr, name="first of two")


_FIRST = _first(_CORRELATED)

MUTANTS = {
    "half_restored": Mutant(
        half_restored(_CORRELATED, mistake=True),
        "reject that restores only part",
        "pbrt 16.4.3, backup and restore, by reading",
        layer="marginal",
        law=_CORRELATED,
        right=half_restored(_CORRELATED, mistake=False),
    ),
    "lazy_dimension_at_zero": Mutant(
        lazy(_CORRELATED, 0.8, mistake=True),
        "a lazily touched dimension starts at 0 instead of its law",
        "pbrt, by reading",
        layer="marginal",
        law=_FIRST,
        right=lazy(_CORRELATED, 0.8, mistake=False),
    ),
    "untracked_noise": Mutant(
        noisy(_MODES, mistake=True),
        "a fresh random number the chain does not track",
        "bptmlt: fresh numbers for the film position",
        layer="marginal",
        law=_MODES,
        right=noisy(_MODES, mistake=False),
    ),
    "adaptation_never_fades": Mutant(
        adaptive(_MODES, mistake=True),
        "adaptation that never fades",
        "Roberts and Rosenthal 2007, section 3, on what fading is for",
        layer="marginal",
        law=_MODES,
        right=adaptive(_MODES, mistake=False),
    ),
    "clock_advanced": Mutant(
        late(_MODES, mistake=True),
        "a clock that a rejection leaves advanced makes every eighth step wrong",
        "pbrt 16.4.3, its currentIteration after a reject, by reading",
        layer="marginal",
        law=_MODES,
        right=late(_MODES, mistake=False),
    ),
    "deposit_factor": Mutant(
        depositing(_WALLS, mistake="a factor"),
        "the number of techniques missing from the contribution",
        "mmp/pbrt-v4, smallmmlt",
        layer="deposits",
        law=_WALLS,
        right=depositing(_WALLS),
    ),
    "deposit_of_another_norm": Mutant(
        depositing(_WALLS, mistake="another norm"),
        "expectation weight without the norm ratio that the accept test has",
        "Tungsten KelemenMltTracer: weights divided by the luminance twice",
        layer="deposits",
        law=_WALLS,
        right=depositing(_WALLS),
    ),
    "deposit_of_dark_proposals": Mutant(
        depositing(_WALLS, mistake="dark proposals"),
        "a zero proposal deposited with the other weighting",
        "Mitsuba 0.6 pssmlt_proc, two-stage mode",
        layer="deposits",
        law=_WALLS,
        right=depositing(_WALLS),
    ),
    "deposit_of_the_proposal": Mutant(
        depositing(_WALLS, mistake="proposal only"),
        "the proposal is deposited whether it is accepted or not",
        "Segovia et al. 2007, section 5.2: candidates deposited as if they were states",
        layer="deposits",
        law=_WALLS,
        right=depositing(_WALLS),
    ),
    "importance_that_vanishes": Mutant(
        depositing(_WALLS, mistake="vanishing importance"),
        "importance function that vanishes where f does not",
        "Hoberock and Hart 2010, algorithm 1, its condition ignored",
        layer="deposits",
        law=_WALLS,
        right=depositing(_WALLS),
    ),
}

TRAPS = {
    "clock": Trap(late(two_modes(), mistake=False), two_modes(), "it carries a clock"),
    "deposits": Trap(depositing(walls()), walls(), "weights that are not 0 or 1", {"reversible": True}),
    "hidden_coordinate": Trap(
        lazy(correlated(0.8), 0.8, mistake=False), _first(correlated(0.8)), "half of it is hidden"
    ),
}
