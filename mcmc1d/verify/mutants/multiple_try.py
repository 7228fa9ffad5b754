"""Multiple-try Metropolis (Liu, Liang and Wong 2000) with its ratio written as R_g = W / W*."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from mcmc1d.types import Array, Key
from mcmc1d.verify.law import Law
from mcmc1d.verify.laws import two_modes
from mcmc1d.verify.mutants import Mutant, Trap

Lambda = Callable[[Array, Array], Array]


def _scale(x: Array) -> Array:
    return 0.6 + 0.3 * jnp.abs(x)


def _log_q(y: Array, x: Array) -> Array:
    """Log density of the proposal of y from x, whose width depends on x."""
    return -0.5 * ((y - x) / _scale(x)) ** 2 - jnp.log(_scale(x))


def multiple_try(law: Law, tries: int, log_lambda: Lambda, *, mistake: str = ""):
    """Weights w(y, x) = f(y) q(x given y) lambda(x, y); candidates from x, competitors from the chosen one and x."""
    log_f: Any = jax.vmap(law.log_density)  # pyright: ignore[reportArgumentType]

    def log_weight(y: Array, x: Array) -> Array:
        """Of going from x to y."""
        if mistake == "argument order":
            return log_f(y) + _log_q(y, x) + log_lambda(x, y)
        return log_f(y) + _log_q(x, y) + log_lambda(x, y)

    def kernel(key: Key, x: Array) -> Array:
        keys = jax.random.split(key, 4)
        candidates = x + _scale(x) * jax.random.normal(keys[0], (tries,))
        forth = log_weight(candidates, jnp.broadcast_to(x, (tries,)))
        chosen = jax.random.categorical(keys[1], 0 * forth if mistake == "equal choice" else forth)
        y = candidates[chosen]
        competitors = y + _scale(y) * jax.random.normal(keys[2], (tries,))
        if mistake != "without the current state":
            competitors = competitors.at[-1].set(x)
        back = log_weight(competitors, jnp.broadcast_to(y, (tries,)))
        log_ratio = jax.nn.logsumexp(forth) - jax.nn.logsumexp(back)
        return jnp.where(jnp.log(jax.random.uniform(keys[3])) < log_ratio, y, x)

    return kernel


def equal_weights(law: Law, tries: int):
    """A candidate chosen uniformly, accepted with its own Hastings ratio: right, whatever the others are."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        keys = jax.random.split(key, 3)
        candidates = x + _scale(x) * jax.random.normal(keys[0], (tries,))
        y = candidates[jax.random.randint(keys[1], (), 0, tries)]
        log_ratio = log_f(y) - log_f(x) + _log_q(x, y) - _log_q(y, x)
        return jnp.where(jnp.log(jax.random.uniform(keys[2])) < log_ratio, y, x)

    return kernel


def one(x: Array, y: Array) -> Array:
    """Log lambda of lambda = 1."""
    return jnp.zeros_like(y)


def symmetric(x: Array, y: Array) -> Array:
    """Log lambda of 1 / (q(x, y) q(y, x)): the weights are f(y) / q(y given x)."""
    return -_log_q(y, x) - _log_q(x, y)


def lopsided(x: Array, y: Array) -> Array:
    """Log lambda of a function that is not symmetric."""
    return -_log_q(y, x) - 0.5 * _log_q(x, y) - 0.3 * y


_MODES = two_modes()
_RIGHT = multiple_try(_MODES, 3, one)
_ORIGIN = "Liu, Liang and Wong 2000, section 3; Segovia et al. 2007, section 5.1"

MUTANTS = {
    f"multiple_try_{name}": Mutant(
        kernel, mistake, f"{_ORIGIN}: planted, no released one is known", layer="marginal", law=_MODES, right=_RIGHT
    )
    for name, (kernel, mistake) in {
        "without_the_current_state": (
            multiple_try(_MODES, 3, one, mistake="without the current state"),
            "the current state is not among the competitors",
        ),
        "lopsided_lambda": (multiple_try(_MODES, 3, lopsided), "lambda is not symmetric"),
        "argument_order": (
            multiple_try(_MODES, 3, one, mistake="argument order"),
            "the weights' proposal density with its arguments exchanged",
        ),
        "equal_choice": (
            multiple_try(_MODES, 3, one, mistake="equal choice"),
            "a candidate is chosen with equal weights, the ratio left as W / W*",
        ),
    }.items()
}

TRAPS = {
    "multiple_try": Trap(multiple_try(two_modes(), 3, one), two_modes(), "three candidates", {"reversible": True}),
    "multiple_try_symmetric_lambda": Trap(
        multiple_try(two_modes(), 4, symmetric), two_modes(), "any symmetric lambda will do", {"reversible": True}
    ),
    "multiple_try_equal_weights": Trap(
        equal_weights(two_modes(), 3), two_modes(), "the other candidates are ignored", {"reversible": True}
    ),
}
