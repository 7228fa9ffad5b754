"""The rays that Metropolis light transport, its coherent kind and instant radiosity trace, in their order."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.flatland import Paths
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators import MLT
from mcmc1d.flatland.mutations import VEACH, BidirectionalMutation, LensPerturbation
from mcmc1d.metropolis import accept
from mcmc1d.moves import Move, MultipleTry, SmallStep
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key


def target(paths: Paths) -> Multiplexed:
    """What the chains sample."""
    return MLT().target(paths)


def mlt(key: Key, paths: Paths, start: State, mutations: int) -> np.ndarray:
    """The rays of a chain's proposals, one path after the other from the sensor on: (rays, 2, 2)."""
    return np.asarray(_proposed(key, target(paths), paths, VEACH, start, mutations)).reshape(-1, 2, 2)


def _traced(paths: Paths, old: Array, new: Array, possible: Array) -> Array:
    """The edges of a new path that a mutation traces, (edges, 2, 2); NaN in place of those that it keeps."""
    before, after = paths.vertices(old), paths.vertices(new)
    kept = jnp.all(jnp.abs(before - after) < _SAME, axis=1)
    edges = jnp.stack([after[:-1], after[1:]], axis=1)
    return jnp.where(((kept[:-1] & kept[1:]) | ~possible)[:, None, None], jnp.nan, edges)


_SAME = 1e-4
"""Vertices nearer to each other than that, in scenes some units wide, are one that was kept: float32 rounds it."""


@eqx.filter_jit
def _proposed(key: Key, target: Multiplexed, paths: Paths, move: Move, start: State, steps: int) -> Array:
    """The edges traced for every proposal, (steps, edges, 2, 2)."""

    def step(state: State, key: Key) -> tuple[State, Array]:
        w = jax.random.uniform(key, (move.dim_w(target) + 1,), state.u.dtype)
        proposal = move.propose(target, state, w[:-1])
        there = target.evaluate(proposal.state).seen.x
        # A mutation that does not apply to the path traces nothing.
        rays = _traced(paths, state.seen.x, there, proposal.log_det > -jnp.inf)
        return accept(target, state, proposal, w[-1], "plain").state, rays

    return jax.lax.scan(step, start, jax.random.split(key, steps))[1]


def coherent(key: Key, paths: Paths, start: State, count: int, tries: int, length: int, sigma: float) -> np.ndarray:
    """The rays of sub-chains of multiple-try: a packet's first edges in the order of the film, then its second ones."""
    mains = -(-count // ((2 * tries - 1) * length))
    inner = MultipleTry(LensPerturbation(SmallStep(sigma)), tries)
    moves = _Moves(BidirectionalMutation(), inner, length)
    # (mains, packets, families, tries, edges, 2, 2): edge by edge within a family.
    rays = np.asarray(_packed(key, target(paths), paths, moves, start, mains))
    return np.moveaxis(rays, 4, 3).reshape(-1, 2, 2)


class _Moves(NamedTuple):
    main: Move
    inner: MultipleTry
    length: int


@eqx.filter_jit
def _packed(key: Key, target: Multiplexed, paths: Paths, moves: _Moves, start: State, mains: int) -> Array:
    """The edges traced for candidates and competitors, (mains, length, 2, tries, edges, 2, 2)."""
    main, inner, length = moves

    def packet(state: State, key: Key) -> tuple[State, Array]:
        w = jax.random.uniform(key, (inner.dim_w(target) + 1,), state.u.dtype)
        proposal, looked_at = inner.propose_packet(target, state, w[:-1])
        families = []
        for family in (looked_at.candidates, looked_at.competitors):
            order = jnp.argsort(jax.vmap(paths.film)(family.seen.x))
            # All keep the same end of the path; what lies under a horizon, or in a shadow, is traced as well.
            possible = jnp.isfinite(family.seen.x).all(-1)
            rays = jax.vmap(partial(_traced, paths, state.seen.x))(family.seen.x, possible)
            families.append(rays[order])
        return accept(target, state, proposal, w[-1], "plain").state, jnp.stack(families)

    def step(state: State, key: Key) -> tuple[State, Array]:
        own, rest = jax.random.split(key)
        w = jax.random.uniform(own, (main.dim_w(target) + 1,), state.u.dtype)
        state = accept(target, state, main.propose(target, state, w[:-1]), w[-1], "plain").state
        return state, jax.lax.scan(packet, state, jax.random.split(rest, length))[1]

    return jax.lax.scan(step, start, jax.random.split(key, mains))[1]


def radiosity(key: Key, paths: Paths, count: int, films: int, camera: int, virtual: int) -> np.ndarray:
    """The rays of instant radiosity: a tile's camera rays, then those to each of its virtual lamps; the next tile.

    Virtual lamps are the last vertices before the camera's own of light paths, whose rays come before all tiles.
    """
    shared, tile = jax.random.split(key)
    technique = Bidirectional(paths, (2,))
    lights = jax.random.uniform(shared, (virtual, technique.dim_u - 1))
    passes = -(-count // (camera * virtual))
    places = jax.random.randint(tile, (passes,), 0, films)
    film = (places[:, None] + (jnp.arange(camera) + 0.5) / camera) / films
    points = np.asarray(_joined(technique, paths, film, lights))  # passes, camera, virtual, vertices, 2
    to_lamps = points[0, 0, :, 2:]
    rays = [np.stack([to_lamps[:, 1:], to_lamps[:, :-1]], axis=2).reshape(-1, 2, 2)[::-1]]
    for one in points:
        rays.append(one[:, 0, :2])
        rays += [one[:, k, 1:3] for k in range(virtual)]
    return np.concatenate(rays)


@eqx.filter_jit
def _joined(technique: Bidirectional, paths: Paths, film: Array, lights: Array) -> Array:
    def one(film: Array, light: Array) -> Array:
        return paths.vertices(technique.forward(jnp.zeros((), jnp.int32), jnp.concatenate([film[None], light]))[0])

    return jax.vmap(jax.vmap(jax.vmap(one, (None, 0)), (0, None)), (0, None))(film, lights)


__all__ = ["coherent", "mlt", "radiosity", "target"]
