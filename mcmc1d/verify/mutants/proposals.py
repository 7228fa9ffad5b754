"""Random walks whose proposal is not what the accept test takes it for: walls, scales, Jacobians, logarithms."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import gamma

from mcmc1d.types import Array, Key
from mcmc1d.verify.law import Law
from mcmc1d.verify.laws import normal, ridge, skewed, two_modes, walls
from mcmc1d.verify.mutants import Mutant, Trap

Step = Callable[[Key, Any], Any]


def walk(law: Law, scale: float, *, log: Callable = jnp.log) -> Step:
    """A symmetric random walk; `log` of the uniform number is compared with the log-ratio."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        y = x + scale * jax.random.normal(first, x.shape)
        return jnp.where(log(jax.random.uniform(second)) < log_f(y) - log_f(x), y, x)

    return kernel


def boxed_walk(law: Law, scale: float, how: str) -> Step:
    """A walk on [0, 1] that is kept inside: by "reject", "wrap", "reflect" (right), "clamp" or "redraw" (wrong)."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        y = x + scale * jax.random.normal(first, x.shape)
        if how == "redraw":
            # Until inside: a normal cut to [0, 1], whose normaliser depends on x and is left out.
            cdf = jax.scipy.stats.norm.cdf
            lower, upper = cdf((0 - x) / scale), cdf((1 - x) / scale)
            place = lower + (upper - lower) * jax.random.uniform(first, x.shape)
            y = x + scale * jax.scipy.stats.norm.ppf(jnp.clip(place, 1e-7, 1 - 1e-7))
        elif how == "clamp":
            y = jnp.clip(y, 0.0, 1.0)
        elif how == "wrap":
            y = y - jnp.floor(y)
        elif how == "reflect":
            y = jnp.abs(y)
            y = 1 - jnp.abs(1 - y % 2)
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x), y, x)

    return kernel


def scaled_walk(law: Law, *, corrected: bool = True) -> Step:
    """A step whose size is that of the place it starts from, with or without its Hastings ratio."""
    log_f: Any = law.log_density

    def size(x: Array) -> Array:
        return 0.3 + 0.5 * jnp.abs(x)

    def log_q(y: Array, x: Array) -> Array:
        return jnp.sum(-0.5 * ((y - x) / size(x)) ** 2 - jnp.log(size(x)))

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        y = x + size(x) * jax.random.normal(first, x.shape)
        log_ratio = log_f(y) - log_f(x) + (log_q(x, y) - log_q(y, x) if corrected else 0)
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_ratio, y, x)

    return kernel


def multiplicative_walk(law: Law, scale: float, jacobian: Callable[[Array], Array]) -> Step:
    """A walk of log x, y = x exp(scale z); `jacobian` of log(y / x) is the log-Jacobian that is used."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        z = scale * jax.random.normal(first, x.shape)
        y = x * jnp.exp(z)
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_f(y) - log_f(x) + jacobian(z), y, x)

    return kernel


def tempered_walk(law: Law, inverse_temperature: float, *, mistake: bool) -> Step:
    """`multiplicative_walk` on f^(1/T); the mistake: its correction is multiplied by 1/T as well."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        z = 0.5 * jax.random.normal(first, x.shape)
        y = x * jnp.exp(z)
        log_ratio = inverse_temperature * (log_f(y) - log_f(x) + (z if mistake else z / inverse_temperature))
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_ratio, y, x)

    return kernel


def delayed_rejection(law: Law, *, corrected: bool = True) -> Step:
    """Tierney and Mira 1999, symmetric proposals: a bold step, then a timid one with log (1 - a1') / (1 - a1)."""
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        keys = jax.random.split(key, 4)
        bold = x + 3.0 * jax.random.normal(keys[0], x.shape)
        a = jnp.minimum(1.0, jnp.exp(log_f(bold) - log_f(x)))
        timid = x + 0.5 * jax.random.normal(keys[1], x.shape)
        back = jnp.minimum(1.0, jnp.exp(log_f(bold) - log_f(timid)))
        log_ratio = log_f(timid) - log_f(x)
        if corrected:  # the bold proposal was as likely from here as from there, but for its distance
            log_q = -0.5 * jnp.sum((bold - timid) ** 2 - (bold - x) ** 2) / 9.0
            log_ratio += log_q + jnp.log1p(-back) - jnp.log1p(-jnp.minimum(a, 1 - 1e-7))
        first = jax.random.uniform(keys[2]) < a
        second = jnp.log(jax.random.uniform(keys[3])) < log_ratio
        return jnp.where(first, bold, jnp.where(second, timid, x))

    return kernel


def slice_walk(law: Law, width: float, *, shrinks: bool = True) -> Step:
    """Neal 2003 with a bracket placed at random and no stepping out: stays where it is if the shrinking ends.

    The mistake: of a fixed bracket around x, the first point that lies on the slice, drawn without shrinking, from a
    bracket that is not centred at random.
    """
    log_f: Any = law.log_density

    def kernel(key: Key, x: Array) -> Array:
        keys = jax.random.split(key, 3)
        level = log_f(x) + jnp.log(jax.random.uniform(keys[0]))
        left = x - width * (jax.random.uniform(keys[1]) if shrinks else 0.25)
        right = left + width

        def body(k: Array, carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            left, right, y, found = carry
            candidate = left + (right - left) * jax.random.uniform(jax.random.fold_in(keys[2], k))
            inside = log_f(candidate) > level
            y = jnp.where(~found & inside, candidate, y)
            if shrinks:
                left = jnp.where(candidate < x, candidate, left)
                right = jnp.where(candidate >= x, candidate, right)
            return left, right, y, found | inside

        return jax.lax.fori_loop(0, 8, body, (left, right, x, jnp.asarray(False)))[2]

    return kernel


def _positive_pair() -> Law:
    """Two independent gamma variables of shape 2."""
    return Law(
        lambda rng, n: rng.gamma(2.0, size=(n, 2)),
        cdf=gamma(2).cdf,
        log_density=lambda x: jnp.sum(jnp.log(x) - x),
        support=(np.zeros(2), np.full(2, np.inf)),
        name="positive pair",
    )


_TEMPERED = Law(
    lambda rng, n: rng.gamma(1.5, 2.0, size=n),
    cdf=gamma(1.5, scale=2).cdf,
    log_density=lambda x: 0.5 * (jnp.log(x) - x),
    support=(0.0, np.inf),
    name="skewed at temperature 2",
)

_MODES, _WALLS, _SKEWED, _PAIR, _RIDGE = two_modes(), walls(), skewed(), _positive_pair(), ridge()

MUTANTS = {
    "log10_of_the_uniform": Mutant(
        walk(_RIDGE, 1.0, log=jnp.log10),
        "log10 of the uniform number against a natural-log ratio",
        "PyBNF #353",
        layer="marginal",
        law=_RIDGE,
        right=walk(_RIDGE, 1.0),
    ),
    "redrawn_until_inside": Mutant(
        boxed_walk(_WALLS, 0.2, "redraw"),
        "proposal redrawn until inside the box, its normaliser missing",
        "PyBNF #766",
        layer="marginal",
        law=_WALLS,
        right=boxed_walk(_WALLS, 0.2, "reject"),
    ),
    "clamped_at_the_walls": Mutant(
        boxed_walk(_WALLS, 0.2, "clamp"),
        "clamped instead of wrapped",
        "Segovia et al. 2007, section 6.1: clamped Gaussians; pbrt 16.4 on wrapping",
        layer="marginal",
        law=_WALLS,
        right=boxed_walk(_WALLS, 0.2, "wrap"),
    ),
    "scale_of_the_place": Mutant(
        scaled_walk(_MODES, corrected=False),
        "asymmetric proposal treated as symmetric",
        "CES.jl #447",
        layer="marginal",
        law=_MODES,
        right=scaled_walk(_MODES),
    ),
    "log_walk_without_jacobian": Mutant(
        multiplicative_walk(_SKEWED, 0.7, jnp.zeros_like),
        "Jacobian dropped",
        "Fermat: Jacobian, reciprocal or none, all stand in the source",
        layer="marginal",
        law=_SKEWED,
        right=multiplicative_walk(_SKEWED, 0.7, lambda z: z),
    ),
    "log_walk_wrong_sign": Mutant(
        multiplicative_walk(_SKEWED, 0.7, jnp.negative),
        "log-Jacobian of the inverse with the wrong sign",
        "danielward27/flowjax #208",
        layer="marginal",
        law=_SKEWED,
        right=multiplicative_walk(_SKEWED, 0.7, lambda z: z),
    ),
    "log_jacobian_counted_per_element": Mutant(
        multiplicative_walk(_PAIR, 0.5, lambda z: 2 * jnp.sum(z)),
        "log-Jacobian summed, then added to every element",
        "pymc-devs/pymc #800",
        layer="marginal",
        law=_PAIR,
        right=multiplicative_walk(_PAIR, 0.5, jnp.sum),
    ),
    "correction_tempered": Mutant(
        tempered_walk(_SKEWED, 0.5, mistake=True),
        "Hastings correction also multiplied by the inverse temperature",
        "a parallel-tempering code; which one is not on record",
        layer="marginal",
        law=_TEMPERED,
        right=tempered_walk(_SKEWED, 0.5, mistake=False),
    ),
    "delayed_rejection_uncorrected": Mutant(
        delayed_rejection(_MODES, corrected=False),
        "the second stage's ratio without log (1 - a1') / (1 - a1)",
        "Tierney and Mira 1999, the naive form that they warn of",
        layer="marginal",
        law=_MODES,
        right=delayed_rejection(_MODES),
    ),
    "slice_bracket_not_random": Mutant(
        slice_walk(_MODES, 3.0, shrinks=False),
        "the bracket is not placed at random",
        "Neal 2003, section 4.1, with the random offset left out",
        layer="marginal",
        law=_MODES,
        right=slice_walk(_MODES, 3.0),
    ),
}

TRAPS = {
    "slice_that_may_stay": Trap(
        slice_walk(two_modes(), 3.0),
        two_modes(),
        "ends with the current point when eight shrinkings find no other",
        {"reversible": True},
    ),
    "delayed_rejection": Trap(delayed_rejection(two_modes()), two_modes(), "two tries a step", {"reversible": True}),
    "reflecting_walk": Trap(boxed_walk(walls(), 0.4, "reflect"), walls(), "folds at both walls", {"reversible": True}),
    "wrapping_walk": Trap(boxed_walk(walls(), 0.4, "wrap"), walls(), "goes round the ends", {"reversible": True}),
    "tiny_steps": Trap(walk(normal(1), 0.5), normal(1), "most of its steps are short"),
}
