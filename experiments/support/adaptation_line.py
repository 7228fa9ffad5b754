"""The chains of `adaptation` on the line, whose step size follows their acceptance: simulated, and by the operator."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import mcmc1d
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import SmallStep
from mcmc1d.numerics import cast, limit
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import GaussianMixture
from mcmc1d.techniques import Uniform
from mcmc1d.verify import step_operator

LINE = GaussianMixture([0.2, 0.65], [0.05, 0.15], [0.5, 0.5])
"""A narrow mode and a broad one, which want different steps."""
WANTED = 0.5
"""The acceptance rate that is steered to."""
BOUNDS = (float(np.log(0.02)), float(np.log(0.5)))
"""Of the logarithm of the step size: without bounds, containment would have to be shown."""
GAINS = {"none": (0.0, 0.0), "fading": (2.0, 1.0), "not fading": (2.0, 0.0)}
"""The gain of step n is c / n^e."""


def simulate(
    chains: int, steps: int, gain: tuple[float, float], key: jax.Array
) -> tuple[np.ndarray, np.ndarray, float]:
    """The last x and log step size of independent adaptive chains, started exactly; the last step's acceptance."""
    target = Multiplexed(LINE, Uniform())
    first, second = jax.random.split(key)
    start = mcmc1d.exact_start(first, target, chains)
    log_sigma = jnp.full(chains, np.log(0.1), start.u.dtype)
    factor, exponent = (jnp.asarray(part, start.u.dtype) for part in gain)
    found = _walk(second, cast(target, start.u.dtype), start, log_sigma, factor, exponent, jnp.asarray(steps))
    x, sizes, rate = (np.asarray(part) for part in found)
    return x, sizes, float(rate)


def _adapt(
    target: Multiplexed, state: State, log_sigma: Any, w: jax.Array, gain: jax.Array
) -> tuple[State, jax.Array, jax.Array]:
    """One step of the library's kernel, and the step size after it: up where the proposal was good, else down."""
    step = Metropolis(SmallStep(jnp.exp(log_sigma)), "plain").step(target, state, w)
    a = step.info.acceptance[0]
    return step.state, limit(log_sigma + gain * (a - WANTED), *BOUNDS), a


@eqx.filter_jit
def _walk(
    key: jax.Array, target: Multiplexed, start: State, log_sigma: Any, factor: Any, exponent: Any, steps: Any
) -> tuple[jax.Array, jax.Array, jax.Array]:
    def body(n: jax.Array, carry: Any) -> Any:
        state, size, _ = carry
        gain = factor / (n + 1.0) ** exponent
        w = uniforms(key, n, (2, size.shape[0]), size.dtype).T
        state, size, a = jax.vmap(lambda s, z, w: _adapt(target, s, z, w, gain.astype(z.dtype)))(state, size, w)
        return state, size, a.mean()

    first = (jax.vmap(target.evaluate)(State(start.index, start.u)), log_sigma, jnp.zeros((), log_sigma.dtype))
    state, size, rate = jax.lax.fori_loop(0, steps, body, first)
    return state.seen.x, size, rate


def predicted(points: int, edges: np.ndarray, seed: int) -> np.ndarray:
    """The law of x that adaptation without fading keeps: (x, log sigma) is a Markov chain, and has an operator."""
    target, gain = Multiplexed(LINE, Uniform()), GAINS["not fading"][0]

    def step(key: jax.Array, z: jax.Array) -> jax.Array:
        own = cast(target, z.dtype)
        state = own.evaluate(State(jnp.zeros((), jnp.int32), z[:1]))
        w = jax.random.uniform(key, (2,), z.dtype)
        after, size, _ = _adapt(own, state, z[1], w, jnp.asarray(gain, z.dtype))
        return jnp.stack([after.seen.x, size])

    def log_density(z: jax.Array) -> jax.Array:
        return cast(LINE, z.dtype).log_f(z[0])

    lower, upper = [0.0, BOUNDS[0]], [1.0, BOUNDS[1]]
    operator = step_operator(
        step, log_density=log_density, lower=lower, upper=upper, cells=64, points=points, seed=seed
    )
    return operator.law_of(edges, lambda z: z[..., 0]).masses[0]
