"""Shadow rays of paths in the plane: how many are cast, and how many of those are blocked."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.flatland import Paths
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.moves import Move
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Int, Key


def looked_at(key: Key, move: Move, target: Multiplexed, paths: Paths, start: State, tries: int) -> np.ndarray:
    """Of `tries` proposals from each start, u of shape (starts, m): how many cast a ray, how many of those are blocked.

    (2, starts).
    """
    state = State(jnp.asarray(start.index), jnp.asarray(start.u).T)
    looks = [_proposed(key, move, target, paths, state, jnp.asarray(k)) for k in range(tries)]
    return np.sum([np.asarray(look) for look in looks], axis=0)


def blocked_share(counts: np.ndarray) -> np.ndarray:
    """Of (2, runs), rays cast and blocked: the share that is blocked; NaN where none was cast."""
    cast_, blocked = counts
    return np.divide(blocked, cast_, out=np.full(cast_.shape, np.nan), where=cast_ > 0)


@eqx.filter_jit
def _proposed(
    key: Key, move: Move, target: Multiplexed, paths: Paths, state: State, step: Int[Array, ""]
) -> tuple[Bool[Array, " c"], Bool[Array, " c"]]:
    """Of a proposal from each state: whether it has a shadow ray, and whether that is blocked."""
    dtype = jnp.zeros(()).dtype
    move, target, paths = cast((move, target, paths), dtype)
    w = uniforms(key, step, (move.dim_w(target), state.u.shape[-1]), dtype)

    def one(state: State, w: Array) -> tuple[Array, Array]:
        proposed = target.evaluate(move.propose(target, state, w).state)
        return shadow_ray(target, paths, proposed.index, proposed.seen.x)

    return jax.vmap(one, in_axes=-1, out_axes=-1)(state, w)


def shadow_rays(
    target: Multiplexed, paths: Paths, index: Index, x: Float[Array, "d n"]
) -> tuple[Bool[Array, " n"], Bool[Array, " n"]]:
    """`shadow_ray` of many paths, n of them."""
    return jax.vmap(partial(shadow_ray, target, paths), in_axes=(0, -1))(index, x)


def shadow_ray(
    target: Multiplexed, paths: Paths, index: Index, x: Float[Array, " d"]
) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    """Whether the two walks of a path are joined by a ray, and whether something stands in its way.

    None is cast where one walk made all of the path, where an end of it is looked at from behind, and at a mirror.
    """
    family = target.family
    assert isinstance(family, Bidirectional)
    t, k = jnp.asarray(family.lengths)[index], paths.edges
    edge, g = jnp.clip(t - 1, 0, k - 1), paths.geometry(x)
    first = jax.tree.map(lambda a: a[0], g.out)
    seen = (edge > 0) | (paths.sensor.log_response(first) > -jnp.inf)
    joined = (t >= 1) & (t <= k) & ~g.mirror[edge] & ~g.mirror[edge + 1]
    cast_ = joined & (g.out.up[edge] > 0) & (g.coming.up[edge] > 0) & seen
    return cast_, cast_ & ~g.clear[edge]


__all__ = ["blocked_share", "looked_at", "shadow_ray", "shadow_rays"]
