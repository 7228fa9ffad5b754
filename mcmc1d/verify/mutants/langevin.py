"""Gradient kernels gone wrong: MALA, Barker's proposal, Hamiltonian Monte Carlo and the guided walk."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from mcmc1d.types import Array, Key
from mcmc1d.verify.kernels import JaxKernel
from mcmc1d.verify.law import Law
from mcmc1d.verify.laws import banana, normal, skewed, two_modes
from mcmc1d.verify.mutants import Mutant, Trap

Step = Callable[[Key, Any], Any]


def mala(law: Law, step: float, correction: float = 1.0) -> Step:
    """Roberts and Tweedie 1996; `correction` multiplies log q(x given y) - log q(y given x)."""
    log_f: Any = law.log_density
    drift = jax.grad(log_f)

    def log_q(y: Array, x: Array) -> Array:
        return -jnp.sum((y - x - step * drift(x)) ** 2) / (4 * step)

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        y = x + step * drift(x) + jnp.sqrt(2 * step) * jax.random.normal(first, x.shape)
        log_ratio = log_f(y) - log_f(x) + correction * (log_q(x, y) - log_q(y, x))
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_ratio, y, x)

    return kernel


def barker(law: Law, step: float, *, corrected: bool = True) -> Step:
    """Livingstone and Zanella 2022: a step z keeps its sign with probability 1 / (1 + exp(-z drift))."""
    log_f: Any = law.log_density
    drift = jax.grad(log_f)

    def kernel(key: Key, x: Array) -> Array:
        first, second, third = jax.random.split(key, 3)
        z = step * jax.random.normal(first, x.shape)
        up = jax.random.uniform(second, x.shape) < jax.nn.sigmoid(z * drift(x))
        y = x + jnp.where(up, z, -z)
        log_ratio = log_f(y) - log_f(x)
        if corrected:
            softplus = jax.nn.softplus
            log_ratio += jnp.sum(softplus(-(y - x) * drift(x)) - softplus(-(x - y) * drift(y)))
        return jnp.where(jnp.log(jax.random.uniform(third)) < log_ratio, y, x)

    return kernel


def hmc(law: Law, step: float, leaps: int, *, mistake: str = "") -> Step:
    """Duane et al. 1987: a fresh momentum, so many leapfrog steps, accept by the change of energy."""
    log_f: Any = law.log_density
    drift = jax.grad(log_f)

    def energy(x: Array, p: Array) -> Array:
        kinetic = x if mistake == "kinetic energy of the position" else p
        return -log_f(x) + 0.5 * jnp.sum(kinetic * kinetic)

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        p = jax.random.normal(first, x.shape)
        half = 1.0 if mistake == "full first kick" else 0.5
        y, q = x, p + half * step * drift(x)
        for k in range(leaps):
            y = y + step * q
            q = q + (0.5 if k == leaps - 1 else 1.0) * step * drift(y)
        log_ratio = energy(x, p) - energy(y, q)
        if mistake == "a missing minus":
            log_ratio = -energy(y, q) - energy(x, p) + 2 * energy(x, 0 * p)
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_ratio, y, x)

    return kernel


def guided_walk(law: Law, scale: float, *, flips: bool = True) -> JaxKernel:
    """Gustafson 1998: a step in the direction of the last one, which turns round where it is rejected."""
    log_f: Any = law.log_density

    def step(key: Key, state: tuple[Array, Array]) -> tuple[Array, Array]:
        x, direction = state
        first, second = jax.random.split(key)
        y = x + direction * scale * jnp.abs(jax.random.normal(first))
        accepted = jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x)
        return jnp.where(accepted, y, x), jnp.where(accepted | (not flips), direction, -direction)

    def init(key: Key, x: Array) -> tuple[Array, Array]:
        return x, jax.random.rademacher(key, dtype=x.dtype)

    return JaxKernel(step, init, lambda state: state[0], name="guided walk")


def persistent_hmc(law: Law, step: float, keep: float) -> JaxKernel:
    """Horowitz 1991: momentum is refreshed in part, one leapfrog step, and negated where it is rejected."""
    log_f: Any = law.log_density
    drift = jax.grad(log_f)

    def advance(key: Key, state: tuple[Array, Array]) -> tuple[Array, Array]:
        x, p = state
        first, second = jax.random.split(key)
        p = keep * p + jnp.sqrt(1 - keep**2) * jax.random.normal(first, x.shape)
        half = p + 0.5 * step * drift(x)
        y = x + step * half
        q = half + 0.5 * step * drift(y)
        log_ratio = log_f(y) - log_f(x) - 0.5 * jnp.sum(q * q) + 0.5 * jnp.sum(p * p)
        accepted = jnp.log(jax.random.uniform(second)) < log_ratio
        return jnp.where(accepted, y, x), jnp.where(accepted, q, -p)

    def init(key: Key, x: Array) -> tuple[Array, Array]:
        return x, jax.random.normal(key, x.shape)

    return JaxKernel(advance, init, lambda state: state[0], name="persistent HMC")


_MODES, _BANANA = two_modes(), banana()

MUTANTS = {
    "mala_reversed": Mutant(
        mala(_MODES, 0.1, -1.0),
        "the transition energy reversed: sign of the correction",
        "blackjax-devs/blackjax #653",
        layer="marginal",
        law=_MODES,
        right=mala(_MODES, 0.1),
    ),
    "mala_minus_half": Mutant(
        mala(_BANANA, 0.05, -0.5),
        "the correction off by a factor -0.5",
        "tensorflow/probability 17af734f8",
        layer="marginal",
        law=_BANANA,
        right=mala(_BANANA, 0.05),
    ),
    "mala_uncorrected": Mutant(
        mala(_BANANA, 0.05, 0.0),
        "a drifting proposal treated as symmetric",
        "CES.jl #447: preconditioned proposal",
        layer="marginal",
        law=_BANANA,
        right=mala(_BANANA, 0.05),
    ),
    "barker_uncorrected": Mutant(
        barker(_MODES, 0.8, corrected=False),
        "Barker's proposal treated as symmetric",
        "CES.jl #447: Barker proposal",
        layer="marginal",
        law=_MODES,
        right=barker(_MODES, 0.8),
    ),
    "hmc_kinetic_energy_of_the_position": Mutant(
        hmc(_MODES, 0.3, 4, mistake="kinetic energy of the position"),
        "kinetic energy of the position instead of the momentum",
        "blackjax-devs/blackjax #46",
        layer="marginal",
        law=_MODES,
        right=hmc(_MODES, 0.3, 4),
    ),
    "hmc_full_first_kick": Mutant(
        hmc(_BANANA, 0.2, 3, mistake="full first kick"),
        "leapfrog begins with a full kick: not reversible, accepted as if it were",
        "planted; as in pyro-ppl/numpyro #826 the accept test is not that of the map that ran",
        layer="marginal",
        law=_BANANA,
        right=hmc(_BANANA, 0.2, 3),
    ),
    "hmc_missing_minus": Mutant(
        hmc(_MODES, 0.5, 3, mistake="a missing minus"),
        "a missing minus: the initial kinetic energy enters with the wrong sign",
        "fab-jax #14",
        layer="marginal",
        law=_MODES,
        right=hmc(_MODES, 0.5, 3),
    ),
    "guided_walk_without_flip": Mutant(
        guided_walk(_MODES, 0.8, flips=False),
        "the direction does not turn round on rejection",
        "planted: Gustafson 1998, section 2, with the flip left out",
        layer="marginal",
        law=_MODES,
        right=guided_walk(_MODES, 0.8),
    ),
}

TRAPS = {
    "guided_walk": Trap(guided_walk(two_modes(), 0.8), two_modes(), "it is not reversible, and says so"),
    "persistent_hmc": Trap(persistent_hmc(banana(), 0.2, 0.8), banana(), "not reversible, and turns back"),
    "mala": Trap(mala(normal(2), 0.5), normal(2), "its proposal is far from symmetric", {"reversible": True}),
    "wall_of_the_support": Trap(
        mala(skewed(), 0.05),
        skewed(),
        "its drift is infinite at the wall and its ratio NaN beyond it",
        {"reversible": True},
    ),
}
