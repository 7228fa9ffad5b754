"""Kernels on an index, alone or beside a real coordinate: edges, supports, periods, and sweeps that overwrite."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.types import Array, Key
from mcmc1d.verify.law import Law
from mcmc1d.verify.laws import correlated, switch
from mcmc1d.verify.mutants import Mutant, Trap
from mcmc1d.verify.statistic import Discrete

_STATES = 4


def _sizes() -> Law:
    """Model sizes 0 to 3 with masses 0.1, 0.4, 0.3, 0.2."""
    masses = np.array([0.1, 0.4, 0.3, 0.2])
    return Law(
        lambda rng, n: rng.choice(_STATES, size=n, p=masses).astype(np.int32),
        statistics={"size": Discrete(np.asarray, masses, ordered=True)},
        log_density=lambda x: jnp.log(jnp.asarray(masses))[x],
        support=lambda x: (np.asarray(x) >= 0) & (np.asarray(x) < _STATES),
        name="model sizes",
    )


def birth_death(law: Law, *, mistake: str = ""):
    """A birth with probability 0.7 and a death with 0.3; at the smallest and largest model the other is certain."""
    log_f: Any = law.log_density

    def birth(k: Array) -> Array:
        return jnp.where(k == 0, 1.0, jnp.where(k == _STATES - 1, 0.0, 0.7))

    def kernel(key: Key, k: Array) -> Array:
        first, second = jax.random.split(key)
        up = jax.random.uniform(first) < birth(k)
        j = jnp.where(up, k + 1, k - 1)
        # The way back is judged at the new model; the mistakes judge it at the old one, or leave out the edges.
        at = k if mistake == "before the move" else j
        back = jnp.where(up, 1 - birth(at), birth(at))
        forth = jnp.where(up, birth(k), 1 - birth(k))
        if mistake == "edge factors":
            back, forth = jnp.where(up, 0.3, 0.7), jnp.where(up, 0.7, 0.3)
        log_ratio = log_f(j) - log_f(k) + jnp.log(back) - jnp.log(forth)
        return jnp.where(jnp.log(jax.random.uniform(second)) < log_ratio, j, k).astype(k.dtype)

    return kernel


def flipping(*, mistake: bool):
    """A symmetric bit that is flipped, and a real number that is drawn afresh; the mistake: it always flips."""

    def kernel(key: Key, state: dict[str, Array]) -> dict[str, Array]:
        first, second = jax.random.split(key)
        flip = jnp.asarray(True) if mistake else jax.random.bernoulli(first)
        return {"bit": jnp.where(flip, 1 - state["bit"], state["bit"]), "x": jax.random.normal(second)}

    return kernel


def _bit() -> Law:
    half = np.array([0.5, 0.5])
    return Law(
        lambda rng, n: {"bit": rng.integers(0, 2, n).astype(np.int32), "x": rng.normal(size=n)},
        statistics={"bit": Discrete(lambda p: np.asarray(p["bit"]), half, ordered=True)},
        name="a bit",
    )


def switching(law: Law, *, mistake: str = ""):
    """A change of the index to a neighbour on a ring, and a step of x."""
    log_f: Any = law.log_density

    def kernel(key: Key, state: dict[str, Array]) -> dict[str, Array]:
        keys = jax.random.split(key, 4)
        jump = jax.random.choice(keys[0], jnp.array([-1, 1]))
        index = state["index"] + jump
        index = index if mistake == "outside" else jnp.clip(index, 0, 2) if mistake == "clipped" else index % 3
        proposal = {"index": index.astype(state["index"].dtype), "x": state["x"]}
        if mistake == "clipped":  # a step beyond the end becomes a step to the middle
            proposal["index"] = jnp.where(index == state["index"], 1, index).astype(state["index"].dtype)
        accepted = jnp.log(jax.random.uniform(keys[1])) < log_f(proposal) - log_f(state)
        state = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), proposal, state)
        moved = {"index": state["index"], "x": state["x"] + jax.random.normal(keys[2])}
        accepted = jnp.log(jax.random.uniform(keys[3])) < log_f(moved) - log_f(state)
        return jax.tree.map(lambda a, b: jnp.where(accepted, a, b), moved, state)

    return kernel


def gibbs(correlation: float, *, overwrites: bool = True):
    """Both coordinates of a normal law, each given the other; the mistake: the second is given the old first."""
    rest = float(np.sqrt(1 - correlation**2))

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.normal(key, (2,))
        a = correlation * x[1] + rest * first
        b = correlation * (a if overwrites else x[0]) + rest * second
        return jnp.stack([a, b])

    return kernel


_SIZES, _SWITCH, _CORRELATED = _sizes(), switch(), correlated(0.8)

MUTANTS = {
    "edge_factors": Mutant(
        birth_death(_SIZES, mistake="edge factors"),
        "edge factors at the smallest and largest model left out",
        "Eryn 184ca7e",
        layer="marginal",
        law=_SIZES,
        right=birth_death(_SIZES),
    ),
    "reverse_before_the_move": Mutant(
        birth_death(_SIZES, mistake="before the move"),
        "reverse move's probability computed before the move",
        "stochtree #426",
        layer="marginal",
        law=_SIZES,
        right=birth_death(_SIZES),
    ),
    "always_flips": Mutant(
        flipping(mistake=True),
        "flips always accepted: right law, periodic chain",
        "pymc-devs/pymc #2866",
        layer="motion",
        law=_bit(),
        right=flipping(mistake=False),
    ),
    "index_outside_the_support": Mutant(
        switching(_SWITCH, mistake="outside"),
        "discrete proposals outside the support",
        "pyro-ppl/numpyro #1834",
        layer="motion",
        law=_SWITCH,
        right=switching(_SWITCH),
    ),
    "index_clipped_at_the_ends": Mutant(
        switching(_SWITCH, mistake="clipped"),
        "a proposal of the next index taken for symmetric at the ends, where it is certain",
        "pyro-ppl/numpyro #1834: support assumed",
        layer="joint",
        law=_SWITCH,
        right=switching(_SWITCH),
    ),
    "sweep_given_the_old_state": Mutant(
        gibbs(0.8, overwrites=False),
        "a sweep whose second update is given the old first: the marginals are right",
        "planted: the synchronous Gibbs sweep",
        layer="joint",
        law=_CORRELATED,
        right=gibbs(0.8),
    ),
}

TRAPS = {
    "systematic_sweep": Trap(gibbs(0.8), correlated(0.8), "a sweep in a fixed order is not reversible"),
    "birth_death": Trap(birth_death(_sizes()), _sizes(), "two states have one way out", {"reversible": True}),
}
