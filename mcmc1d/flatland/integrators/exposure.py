"""Films of many chains at once, each with an importance function over the pixels of its own: starts and steps."""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.compiling import wide_jit
from mcmc1d.estimators import Estimator, added, empty
from mcmc1d.examples import Examples
from mcmc1d.flatland.importance import OverPixels, Shader
from mcmc1d.flatland.integrators.chains import EachChain
from mcmc1d.flatland.paths import EXAMPLES as LIT
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.sampling import undefined_light
from mcmc1d.image import reciprocal
from mcmc1d.metropolis import Kernel, Step
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.rendering import STEPS_AT_ONCE
from mcmc1d.starts import MOST_CANDIDATES, StartError, accepted, independent_states
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Int, Key

ROWS = ("density", "value", "squares", "area", "contribution")
_CANDIDATES = 2**13
"""For exact starts, at once."""
_PROBES = 2**16


class Moments(Estimator):
    """Sums of each chain in each pixel, (rows, pixels, chains), for an I that is f times a number and a shader s.

    The deposits' weights (the sample density); the same over s; C / s^2, and 1 / C, of the state after each step, C
    being the density of the state; the deposits' weights over s^2. The number in each pixel is left out: whoever knows
    it divides.
    """

    paths: Paths
    chains: int = eqx.field(static=True)
    shader: Shader | None = None

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, "5 n c"]:
        return jnp.zeros((len(ROWS), self.paths.sensor.pixels, self.chains), dtype)

    def update(self, sums: Float[Array, "5 n c"], steps: Step) -> Float[Array, "5 n c"]:
        film, seen, deposits = EachChain(self.paths, self.chains), steps.state.seen, steps.deposits
        moved, here = deposits.x, seen.x[None]
        log_s, log_here = self._log_shader(moved), self._log_shader(here)
        per = reciprocal(seen.log_c)[None]
        rows = (
            (moved, deposits.weight),
            (moved, deposits.weight * jnp.exp(-log_s)),
            (here, jnp.exp(seen.log_c[None] - 2 * log_here)),
            (here, per),
        )

        def added(k: int, x: Array, weight: Array) -> Array:
            step = eqx.tree_at(lambda s: (s.deposits.x, s.deposits.weight), steps, (x, weight))
            return film.update(sums[k], step)

        made = [added(k, x, weight) for k, (x, weight) in enumerate(rows)]
        plain = self.shader is None  # then s is 1, and the last row the second
        return jnp.stack([*made, made[1] if plain else added(4, moved, deposits.weight * jnp.exp(-2 * log_s))])

    def _log_shader(self, x: Float[Array, "n ... c"]) -> Float[Array, "n c"]:
        if self.shader is None:
            return jnp.zeros((x.shape[0], x.shape[-1]), x.dtype)
        paths = cast(self.paths, x.dtype)
        return jax.vmap(jax.vmap(partial(self.shader.log_factor, paths), in_axes=-1))(x)


class Exposed(NamedTuple):
    """What chains left on their films."""

    rows: np.ndarray
    """Sums over the steps, (replicas, chains, rows, pixels); see `Moments`."""
    acceptance: np.ndarray
    """The mean of each chain, (replicas, chains)."""


def expose(
    key: Key, kernel: Kernel, target: Multiplexed, values: Float[np.ndarray, "r n"], start: State, steps: int
) -> Exposed:
    """Step chains, of which each replica has as many, with its row of `values` in the target's `OverPixels`."""
    light = _light(target)
    lanes = start.u.shape[0]
    each = jnp.asarray(np.repeat(values, lanes // len(values), 0).T)
    film = Moments(light.light.paths, lanes, light.shader)
    state, rows, accepted = State(start.index, jnp.asarray(start.u).T), 0.0, 0.0
    for first in range(0, steps, STEPS_AT_ONCE):
        count = min(STEPS_AT_ONCE, steps - first)
        state, sums, rate = _exposed(key, kernel, target, film, each, state, jnp.asarray(first), jnp.asarray(count))
        rows, accepted = rows + np.asarray(sums, np.float64), accepted + np.asarray(rate, np.float64)
    dealt = np.moveaxis(np.asarray(rows), -1, 0).reshape(len(values), -1, len(ROWS), values.shape[1])
    return Exposed(dealt, np.reshape(accepted, (len(values), -1)) / steps)


def unexposed(replicas: int, chains: int, pixels: int) -> Exposed:
    """The films of chains that were not run."""
    return Exposed(np.zeros((replicas, chains, len(ROWS), pixels)), np.zeros((replicas, chains)))


@wide_jit
def _exposed(
    key: Key,
    kernel: Kernel,
    target: Multiplexed,
    film: Moments,
    values: Float[Array, "n c"],
    state: State,
    first: Int[Array, ""],
    count: Int[Array, ""],
) -> tuple[State, Float[Array, "5 n c"], Float[Array, " c"]]:
    dtype = jnp.zeros(()).dtype
    kernel, target, film, values = cast((kernel, target, film, values), dtype)

    def own(values: Float[Array, " n"]) -> Multiplexed:
        return eqx.tree_at(lambda t: t.target.values, target, values)

    def one(values: Array, state: State, w: Array) -> Step:
        return kernel.step(own(values), state, w)

    def body(k: Array, carry: tuple[State, Array, Array]) -> tuple[State, Array, Array]:
        state, sums, accepted = carry
        w = uniforms(key, first + k, (kernel.dim_w(target), values.shape[1]), dtype)
        step = jax.vmap(one, in_axes=-1, out_axes=-1)(values, state, w)
        return step.state, added(film, sums, step), accepted + step.info.acceptance.mean(0)

    begun = jax.vmap(lambda v, s: own(v).evaluate(s), in_axes=-1, out_axes=-1)(values, State(state.index, state.u))
    nothing = empty(film, target, kernel, dtype), jnp.zeros_like(values[0])
    last, sums, accepted = jax.lax.fori_loop(0, count, body, (begun, *nothing))
    return State(last.index, last.u), sums, accepted


def highest_seen(key: Key, target: Multiplexed) -> Float[np.ndarray, " n"]:
    """The largest density of f, times a shader, among independent probes, in each pixel."""
    found = np.zeros(_light(target).light.paths.sensor.pixels)
    for k in range(_PROBES // _CANDIDATES):
        _, density, pixel, _ = _candidates(key, target, k)
        np.maximum.at(found, pixel, density)
    return found


def exact_starts(
    key: Key,
    target: Multiplexed,
    values: Float[np.ndarray, "r n"],
    chains: int,
    highest: Float[np.ndarray, " n"],
    most: int = MOST_CANDIDATES,
) -> State:
    """`chains` exact states for each row of `values`, (rows chains), by rejection: see `starts.accepted`.

    The first bound is 1.25 times what `highest` of `highest_seen` allows. Each row has candidates of its own, so that
    replicas stay independent. `StartError` where it would take more than `most` of them for a row.
    """
    owner = np.arange(_CANDIDATES) % len(values)
    bound = 1.25 * (values * highest).max(1)
    if not bound.min() > 0:
        raise StartError(
            f"exact_starts: no light in {_PROBES} probes; give techniques that find it, or a lamp that can be seen"
        )

    def candidates(batch: int) -> tuple[State, np.ndarray, np.ndarray]:
        state, density, pixel, uniform = _candidates(key, target, batch)
        return State(state.index, state.u.T), density * values[owner, pixel], uniform

    return accepted(
        "exact_starts", candidates, owner, bound, chains, "techniques that follow it, or more candidates", most
    )


def _light(target: Multiplexed) -> OverPixels:
    light = target.target
    assert isinstance(light, OverPixels)
    return light


def _candidates(key: Key, target: Multiplexed, attempt: int) -> tuple[State, np.ndarray, np.ndarray, np.ndarray]:
    """Of f, times a shader; see `_drawn`."""
    plain = eqx.tree_at(lambda t: t.target.values, target, np.ones_like(_light(target).values))
    state, density, pixel, uniform = jax.tree.map(np.asarray, _drawn(key, plain, jnp.asarray(attempt)))
    if not np.isfinite(density).all():
        raise undefined_light(target)
    return state, density.astype(np.float64), pixel, uniform


@wide_jit
def _drawn(
    key: Key, target: Multiplexed, attempt: Int[Array, ""]
) -> tuple[State, Float[Array, " m"], Int[Array, " m"], Float[Array, " m"]]:
    """Independent (index, u), the density of each, its pixel, and a uniform number."""
    dtype = jnp.zeros(()).dtype
    target = cast(target, dtype)
    state, uniform = independent_states(key, attempt, target, _CANDIDATES, dtype)
    pixel = jax.vmap(_light(target).light.paths.pixel, in_axes=-1)(state.seen.x)
    return State(state.index, state.u), jnp.exp(state.seen.log_c), pixel, uniform


EXAMPLES = Examples(lambda: {"moments": Moments(LIT["light"].paths, 64)})

__all__ = ["EXAMPLES", "ROWS", "Exposed", "Moments", "exact_starts", "expose", "highest_seen", "unexposed"]
