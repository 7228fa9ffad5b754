"""The six algorithms of Hoberock and Hart 2010, table 1, in the plane: many runs of each, on one scene and length."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.flatland import Paths, Scene
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators import BidirectionalPathTracing, PathTracing, StagedMLT
from mcmc1d.flatland.integrators.exposure import expose
from mcmc1d.moves import Move
from mcmc1d.numerics import below_one, cast
from mcmc1d.random import uniforms
from mcmc1d.redistribution import chains_of
from mcmc1d.starts import uniform_states
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Int, Key

STAGED = {"MLT": "one_stage", "2MLT": "two_stage", "MMLT": "multi_stage", "NAMLT": "noise_aware"}
METHODS = ("path", "MLT", "ERPT", "2MLT", "MMLT", "NAMLT")


class Images(NamedTuple):
    """What a method made, of every run."""

    image: np.ndarray
    """(runs, pixels)."""
    density: np.ndarray
    """The samples in each pixel, (runs, pixels)."""
    acceptance: np.ndarray
    """(runs,); NaN where nothing is accepted."""
    shadow: np.ndarray
    """Of the shadow rays, the share that is blocked, (runs,)."""
    samples: float
    """Paths and mutations of a run, those that are thrown away included."""


@dataclass(frozen=True)
class Contest:
    """What all of them share: b is known to each, so that only their samples differ."""

    scene: Scene
    edges: int
    of: BidirectionalPathTracing | PathTracing
    """Whose paths they make."""
    exact: np.ndarray
    """The image, (pixels,)."""
    runs: int
    samples: int
    """Paths and mutations of each run."""
    chains: int
    """Of each run, at each stage."""
    sigma: float
    large: float
    length: int
    """Of a chain of ERPT."""
    shadows: int
    """Proposals of each run that are looked at for their shadow rays."""

    def __post_init__(self):
        pixels = self.scene.sensor.pixels
        if _BATCH % pixels:
            raise ValueError(f"pixels must divide {_BATCH}, a batch of stratified samples, not {pixels}")

    @property
    def paths(self) -> Paths:
        return Paths(self.scene, self.edges)

    def staged(self, key: Key, method: str) -> Images:
        """MLT in one stage or more."""
        integrator = self._integrator(method, self.large)
        options = {"replicas": self.runs, "exact": self.exact}
        done = list(integrator.staged(key, self.scene, self.edges, self.samples, **options))
        film = [stage.film for stage in done if stage.kept]
        whole = film[0]
        for one in film[1:]:
            whole = whole.plus(one)
        share = np.array([stage.samples for stage in done], float)
        tries = -(-self.shadows // (self.chains * len(done)))
        move = integrator.kernel().move
        shadow = [self._shadow(jax.random.fold_in(key, 100 + s), move, d.start, tries) for s, d in enumerate(done)]
        acceptance = np.average([stage.acceptance for stage in done], axis=0, weights=share)
        return Images(whole.image(), whole.density, acceptance, np.average(shadow, axis=0, weights=share), share.sum())

    def path(self, key: Key) -> Images:
        """Independent samples, each pixel with as many of those that begin at the sensor.

        But for one at a pixel's end that rounds into the next: of an even density that shows in the kurtosis.
        """
        drawn = self.draws(key, self.samples)
        image = self._film(drawn.pixel, drawn.energy) * len(self.exact) / self.samples
        density = self._film(drawn.pixel, np.ones_like(drawn.energy))
        return Images(image, density, np.full(self.runs, np.nan), drawn.shadow, float(self.samples))

    def redistribution(self, key: Key) -> Images:
        """ERPT: one mutation for each path on average, from starts of equal energy."""
        draw_key, xi_key, walk_key, shadow_key = jax.random.split(key, 4)
        count = self.samples // 2
        drawn = self.draws(draw_key, count)
        quantum = self.exact.mean() * self.length
        xi = np.asarray(jax.random.uniform(xi_key, drawn.energy.shape), np.float64)
        started = chains_of(drawn.energy, quantum, xi)
        run, path = (np.repeat(at, started[started > 0]) for at in np.nonzero(started))
        integrator = self._integrator("MLT", 0.0)
        kernel, target = integrator.kernel(), integrator.target(self.paths)
        lanes, rows, accepted, shadow = self.runs * self.chains, [], [], np.nan
        plain = np.ones((self.runs, len(self.exact)))  # of the same shape as the stages': one program
        for first in range(0, len(run), lanes):
            own = np.arange(first, first + lanes) % len(run)  # what fills the last batch up is thrown away
            start = State(jnp.asarray(drawn.technique[run[own], path[own]]), jnp.asarray(drawn.u[run[own], path[own]]))
            found = expose(jax.random.fold_in(walk_key, first), kernel, target, plain, start, self.length)
            rows.append(found.rows.reshape(lanes, *found.rows.shape[2:])[:, 0])
            accepted.append(found.acceptance.ravel())
            if first == 0:
                shadow = self._shadow(shadow_key, kernel.move, start, -(-self.shadows // self.chains)).mean()
        density, acceptance = np.zeros_like(plain), np.zeros(self.runs)
        np.add.at(density, run, np.concatenate(rows)[: len(run)])
        np.add.at(acceptance, run, np.concatenate(accepted)[: len(run)])
        chains = np.bincount(run, minlength=self.runs)
        image = quantum / self.length * density * len(self.exact) / count
        # Half of the rays are those of the paths; of the other half the rate is that of all runs together.
        rate = (drawn.shadow + shadow) / 2
        return Images(image, density, acceptance / chains, rate, count + chains.mean() * self.length)

    def _integrator(self, method: str, large: float) -> StagedMLT:
        return StagedMLT(STAGED[method], of=self.of, sigma=self.sigma, large=large, chains=self.chains)  # pyright: ignore

    def draws(self, key: Key, count: int) -> "Draws":
        """Independent samples of every run; the film's number is stratified."""
        target, lanes = self.of.target(self.paths), self.runs * _BATCH
        batches = -(-count // _BATCH)
        found = [_draws(key, target, self.paths, jnp.asarray(k), lanes) for k in range(batches)]
        parts = [jax.tree.map(lambda a: np.asarray(a).reshape(*a.shape[:-1], self.runs, _BATCH), one) for one in found]
        index, u, energy, pixel, cast_, blocked = (
            np.concatenate([part[k] for part in parts], -1)[..., :count] for k in range(6)
        )
        shadow = blocked.sum(-1) / cast_.sum(-1)
        return Draws(index, np.moveaxis(u, 0, -1), energy.astype(np.float64), pixel, shadow)

    def _film(self, pixel: np.ndarray, weight: np.ndarray) -> np.ndarray:
        film = np.zeros((self.runs, len(self.exact)))
        np.add.at(film, (np.arange(self.runs)[:, None], pixel), weight)
        return film

    def _shadow(self, key: Key, move: Move, start: State | None, tries: int) -> np.ndarray:
        """Of `tries` proposals from each of exact starts, (runs chains): the share of blocked shadow rays, by run."""
        assert start is not None  # b is known, and there is light
        target = self.of.target(self.paths)
        state = State(jnp.asarray(start.index), jnp.asarray(start.u).T)
        looks = [_proposed(key, move, target, self.paths, state, jnp.asarray(k)) for k in range(tries)]
        cast_, blocked = np.sum([np.asarray(look) for look in looks], axis=0)  # (2, runs chains)
        return blocked.reshape(self.runs, -1).sum(1) / cast_.reshape(self.runs, -1).sum(1)


_BATCH = 2**8
"""Independent samples of each run at once: stratified over the pixels, a multiple of whose number it must be."""


class Draws(NamedTuple):
    """Independent samples of every run: (runs, samples), u (runs, samples, m)."""

    technique: np.ndarray
    u: np.ndarray
    energy: np.ndarray
    """n w_i f / p_i."""
    pixel: np.ndarray
    shadow: np.ndarray
    """(runs,)."""


@eqx.filter_jit
def _draws(
    key: Key, target: Multiplexed, paths: Paths, batch: Int[Array, ""], lanes: int
) -> tuple[Index, Array, Array, Array, Array, Array]:
    """Index, u, energy, pixel, whether there is a shadow ray and whether it is blocked; the last axis are samples."""
    dtype = jnp.zeros(()).dtype
    target, paths = cast((target, paths), dtype)
    numbers = uniforms(key, batch, (target.dim_u + 1, lanes), dtype)
    pixel_of = (jnp.arange(lanes) % paths.sensor.pixels).astype(dtype)
    u = numbers[1:].at[0].set(below_one((pixel_of + numbers[1]) / paths.sensor.pixels))
    state = uniform_states(target, numbers[0], u)
    index, seen = state.index, state.seen
    energy = target.n_techniques * jnp.exp(seen.log_c)
    pixel = jax.vmap(paths.pixel, in_axes=-1)(seen.x)
    cast_, blocked = jax.vmap(partial(shadow_ray, target, paths), in_axes=(0, -1))(index, seen.x)
    return index, u, energy, pixel, cast_, blocked


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


def shadow_ray(
    target: Multiplexed, paths: Paths, index: Index, x: Float[Array, " d"]
) -> tuple[Bool[Array, ""], Bool[Array, ""]]:
    """Whether the two walks of a path are joined by a ray, and whether something stands in its way.

    None is cast where one walk made all of the path, and where an end of it is looked at from behind.
    """
    family = target.family
    assert isinstance(family, Bidirectional)
    t, k = jnp.asarray(family.lengths)[index], paths.edges
    edge, g = jnp.clip(t - 1, 0, k - 1), paths.geometry(x)
    first = jax.tree.map(lambda a: a[0], g.out)
    seen = (edge > 0) | (paths.sensor.log_response(first) > -jnp.inf)
    cast_ = (t >= 1) & (t <= k) & (g.out.up[edge] > 0) & (g.coming.up[edge] > 0) & seen
    return cast_, cast_ & ~g.clear[edge]


__all__ = ["METHODS", "Contest", "Images", "shadow_ray"]
