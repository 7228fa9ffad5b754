"""Instant radiosity: the vertices of a light path as virtual lamps, which light every camera path (Keller 1997)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, require_whole
from mcmc1d.examples import Examples
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.evaluation import reads
from mcmc1d.flatland.integrators.base import brightest, multiplexed
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.integrators.passes import Passes
from mcmc1d.flatland.paths import EXAMPLES as LIT
from mcmc1d.flatland.paths import Geometry, Light, LightTimes, Paths
from mcmc1d.flatland.sampling import bootstrap, exposed
from mcmc1d.flatland.scene import Pinhole, Scene
from mcmc1d.numerics import parameter
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Key, Scalar
from mcmc1d.weights import Balance, Weights

_LOOKED_AT = 2**14


def gathered_at(paths: Paths, x: Float[Array, " d"]) -> Index:
    """The vertex that virtual lamps are joined to: the first wall that the camera sees which is no mirror's bounce.

    Of a wall sensor the place on it, vertex 0.
    """
    if paths.sensor.places:
        return jnp.zeros((), jnp.int32)
    if not paths.walls.mirrors:
        return jnp.ones((), jnp.int32)
    return 1 + jnp.argmin(x >= paths.walls.total).astype(jnp.int32)  # the last vertex is on a lamp


def unreachable(paths: Paths, x: Float[Array, " d"]) -> Bool[Array, ""]:
    """Whether the vertex after that one is a mirror's bounce, where no virtual lamp lies."""
    after = jnp.minimum(gathered_at(paths, x) + 1, paths.edges)
    return x[after - 1 + paths.sensor.places] >= paths.walls.total


def share(paths: Paths, x: Float[Array, " d"], g: Geometry, clamp: Scalar) -> Scalar:
    """min(1, clamp / G) of the edge that joins; 1 where the camera path comes upon the lamp by itself."""
    m = gathered_at(paths, x)
    edge = jnp.minimum(m, paths.edges - 1)
    cosines = jnp.maximum(g.out.up[edge], 0) * jnp.maximum(g.coming.up[edge], 0)
    joint = jnp.where(m < paths.edges, cosines / g.from_eye[edge], 0)
    return jnp.where(joint > clamp, clamp / jnp.where(joint > clamp, joint, 1), 1)


class BehindFirstWall(Weights):
    """All to the technique that joins a light path to the first wall which the camera sees and which is no mirror.

    That technique has density zero where the next vertex is a mirror's bounce: light that instant radiosity loses.
    """

    paths: Paths
    lengths: tuple[int, ...] = eqx.field(static=True)
    """t of each technique."""

    def log_weights(self, x: Float[Array, "..."], log_p: Sequence[Scalar]) -> list[Scalar]:
        t = gathered_at(self.paths, x) + 1
        return [
            jnp.where(t == length, jnp.zeros_like(p), -jnp.inf) for length, p in zip(self.lengths, log_p, strict=True)
        ]


class LeftOut(LightTimes):
    """The light that instant radiosity leaves out: f max(0, 1 - clamp / G), and all of f where it can not join."""

    light: Light
    clamp: Scalar = eqx.field(converter=parameter)

    def log_factor(self, x: Float[Array, " d"]) -> Scalar:
        paths = self.light.paths
        kept = share(paths, x, paths.geometry(x), jnp.asarray(self.clamp))
        return jnp.log1p(-jnp.where(unreachable(paths, x), 0, kept))


class InstantRadiosity(Passes):
    """Keller 1997: one light path a pass, its vertices virtual lamps, joined to `cameras` stratified camera paths.

    A camera path ends at the first wall that is no mirror's bounce; of a wall sensor it is a place on the wall. Paths
    of k edges all use the one technique that joins there, without multiple importance: a virtual lamp next to a wall
    counts as 1 / r. Unbiased; but where two walls meet the second moment is the integral of dr / r, infinite: the
    standard error is not to be trusted, and there is no bound for `compare`.

    `clamp` limits G = cos cos / r of the joint, which makes all that finite and the image too dark, by `bias`: the two
    together are exact. What a wall sends to a mirror's bounce and on to a lamp, a caustic, no virtual lamp can make;
    that is an error unless it is asked to leave it out, and then it is part of `bias`.
    """

    cameras: int = eqx.field(static=True, default=64)
    """Camera paths that each light path is joined to."""
    clamp: Scalar = eqx.field(converter=parameter, default=np.inf)
    """The largest G that counts in full."""
    partial: bool = eqx.field(static=True, default=False)
    """Whether to leave out what it can not make."""

    def __check_init__(self):
        require_whole(self.cameras, "InstantRadiosity: cameras")
        require(bool(self.clamp > 0), f"InstantRadiosity: clamp must be positive, not {self.clamp}; inf clamps nothing")

    def check(self, scene: Scene, edges: int) -> None:
        if self.partial or not scene.mirrors or (edges == 1 and isinstance(scene.sensor, Pinhole)):
            return
        paths, key = Paths(scene, edges), jax.random.key(0)
        lost = bootstrap(key, _left_out(paths, np.inf), _LOOKED_AT, np.inf).mean.item()
        whole = bootstrap(key, multiplexed(paths, None, Balance()), _LOOKED_AT, np.inf).mean.item()
        require(
            lost == 0,
            f"InstantRadiosity: scene {scene.name}: of the light of {edges} edges, {lost / max(whole, 1e-300):.0%} "
            "comes by way of a mirror to where virtual lamps are joined, and no virtual lamp lies on a mirror; "
            "partial=True leaves it out",
        )

    def target(self, paths: Paths) -> Multiplexed:
        lengths = _lengths(paths)
        return Multiplexed(Light(paths), Bidirectional(paths, lengths), BehindFirstWall(paths, lengths), probes=0)

    def bias(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        """What is left out, by bidirectional path tracing of just that: the bias, but for its sign."""
        target, paths = _left_out(Paths(scene, edges), self.clamp), Paths(scene, edges)
        sums = exposed(key, target, paths, samples, target.n_techniques * brightest(scene, edges))
        return Layer(edges, float(paths.sensor.pixels), sums, None, float(edges) * sums.size)

    def numbers(self, paths: Paths) -> tuple[int, int]:
        lamp = reads(paths.edges + 1 - _lengths(paths)[0], 1)[0]
        return Bidirectional(paths).dim_u - lamp, lamp

    def gather(self, paths: Paths, own: Float[Array, "n cameras"], shared: Float[Array, " m"]) -> Float[Array, " c"]:
        target, clamp = self.target(paths), jnp.asarray(self.clamp)

        def lit(index: Array, u: Array) -> Array:
            seen = target.evaluate(State(index, u)).seen
            return jnp.exp(seen.log_c) * share(paths, seen.x, paths.geometry(seen.x), clamp)

        index = jnp.arange(target.n_techniques, dtype=jnp.int32)
        u = jnp.concatenate([own, jnp.broadcast_to(shared[:, None], (len(shared), own.shape[1]))])
        return jax.vmap(jax.vmap(lit, in_axes=(None, -1)), in_axes=(0, None))(index, u).sum(0)

    def most(self, scene: Scene, edges: int) -> float:
        paths = Paths(scene, edges)
        if edges == 1 and not paths.sensor.places:
            return brightest(scene, edges)
        if np.isinf(self.clamp) or scene.glossy:
            return np.inf  # neither has G a bound, nor a glossy lobe's f_r at grazing angles
        # A virtual lamp sends the emission times all lamps' length, and loses some at each wall; so does a camera path.
        joined = float(self.clamp) * scene.lamp_length * brightest(scene, edges) / 2
        upon = brightest(scene, edges) if paths.walls.mirrors else 0.0  # lamps that the camera sees in mirrors
        return sum(t <= edges for t in _lengths(paths)) * joined + upon

    def rays(self, paths: Paths) -> float:
        # Those of the light path; of each camera path its own, and its joints, of which mirrors make more.
        k, first = paths.edges, _lengths(paths)[0]
        own = 0 if paths.sensor.places else (k if paths.walls.mirrors else 1)
        return max(k - first, 0) + self.cameras * float(own + sum(t <= k for t in _lengths(paths)))


def _lengths(paths: Paths) -> tuple[int, ...]:
    """The t that can be the first wall's, which is no mirror's."""
    if paths.sensor.places:
        return (1,)
    return tuple(range(2, paths.edges + 2)) if paths.walls.mirrors else (2,)


def _left_out(paths: Paths, clamp: Scalar | float) -> Multiplexed:
    return Multiplexed(LeftOut(Light(paths), clamp), Bidirectional(paths), Balance(), probes=0)


EXAMPLES = Examples(
    lambda: {
        "behind_first_wall": BehindFirstWall(LIT["light"].paths, (2,)),
        "left_out": LeftOut(LIT["light"], 1.0),
    }
)

__all__ = ["EXAMPLES", "BehindFirstWall", "InstantRadiosity", "LeftOut", "gathered_at", "share", "unreachable"]
