"""Path tracing, light tracing and bidirectional path tracing: independent samples of paths."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators.base import Integrator, brightest, brightest_from_lamps, multiplexed
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.sampling import exposed
from mcmc1d.flatland.scene import Pinhole, Scene
from mcmc1d.numerics import cast
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Key
from mcmc1d.weights import Balance, Maximum, Power

_LOOKED_AT = 2**14


class PathTracing(Integrator):
    """Paths from the sensor, which hit a lamp or are joined to one (next event estimation), by multiple importance.

    Of one edge before a pinhole only those that hit.
    """

    weights: Balance | Power | Maximum = Balance()

    def target(self, paths: Paths) -> Multiplexed:
        k = paths.edges
        joined = () if k == 1 and paths.sensor.places == 0 else (k,)
        return multiplexed(paths, (*joined, k + 1), self.weights)

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        return independent(key, self, scene, edges, samples, brightest(scene, edges))


class LightTracing(Integrator):
    """Paths from the lamps, which hit a wall sensor or are joined to the sensor: particle tracing (Arvo 1986).

    What a pinhole sees by way of a mirror it can not make; that is an error unless it is asked to leave it out.
    """

    partial: bool = eqx.field(static=True, default=False)
    """Whether to leave out what it can not make."""

    def check(self, scene: Scene, edges: int) -> None:
        if self.partial or not isinstance(scene.sensor, Pinhole) or not scene.mirrors or edges == 1:
            return
        paths = Paths(scene, edges)
        all_of_it, unseen = np.asarray(_unseen(multiplexed(paths, None, None)), np.float64)
        require(
            unseen == 0,
            f"LightTracing: scene {scene.name}: of the light of {edges} edges, {unseen / max(all_of_it, 1e-300):.0%} "
            "is seen in a mirror, and no path from a lamp can be joined to a pinhole there; partial=True leaves it out",
        )

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, (1,) if paths.sensor.places == 0 else (0, 1), Balance())

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        self.check(scene, edges)
        return independent(key, self, scene, edges, samples, brightest_from_lamps(scene, edges))


class BidirectionalPathTracing(Integrator):
    """Every technique (s, t), one of them chosen at random for each path, with the weights of Veach and Guibas 1995."""

    weights: Balance | Power | Maximum = Balance()

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, None, self.weights)

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        return independent(key, self, scene, edges, samples, brightest(scene, edges))


def independent(key: Key, integrator: Integrator, scene: Scene, edges: int, samples: int, most: float) -> Layer:
    """`most`: what f / p of one of the techniques never exceeds, and so w_i f / p_i, for each of the weights."""
    paths = Paths(scene, edges)
    target = integrator.target(paths)
    sums = exposed(key, target, paths, samples, target.n_techniques * most)
    return Layer(edges, float(paths.sensor.pixels), sums, None, float(edges) * sums.size)


@eqx.filter_jit
def _unseen(target: Multiplexed) -> Array:
    """Mean light of paths by all techniques, and of those of them that light tracing can not make."""
    target = cast(target, jnp.zeros(()).dtype)
    family = target.family
    assert isinstance(family, Bidirectional)
    numbers = jax.random.uniform(jax.random.key(0), (_LOOKED_AT, target.dim_u))
    index = jnp.arange(_LOOKED_AT, dtype=jnp.int32) % target.n_techniques

    def one(i: Array, u: Array) -> Array:
        x, _, _, log_f, log_p, *_ = family.look(target.target, i, u)
        light = jnp.exp(target.log_c(i, x, log_f, log_p))
        return jnp.stack([light, jnp.where(jnp.isneginf(log_p[family.lengths.index(1)]), light, 0)])

    return jax.vmap(one)(index, numbers).mean(0)


__all__ = ["BidirectionalPathTracing", "LightTracing", "PathTracing", "independent"]
