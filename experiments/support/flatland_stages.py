"""The six algorithms of Hoberock and Hart 2010, table 1, in the plane: many runs of each, on one scene and length."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.support.flatland_shadow import blocked_share, looked_at, shadow_rays
from mcmc1d.flatland import Paths, Scene
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators import BidirectionalPathTracing, PathTracing, StagedMLT
from mcmc1d.flatland.integrators.base import brightest
from mcmc1d.flatland.integrators.exposure import expose
from mcmc1d.flatland.integrators.image import Layer, Stacked
from mcmc1d.flatland.sampling import Sums
from mcmc1d.numerics import below_one, cast
from mcmc1d.random import uniforms
from mcmc1d.redistribution import chains_of
from mcmc1d.starts import uniform_states
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Index, Int, Key

STAGED = {"MLT": "one_stage", "two-stage": "two_stage", "multi-stage": "multi_stage", "noise-aware": "noise_aware"}


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
    layer: Layer | None = None
    """All runs as one image, of independent paths; None where chains make it, too few of them for a bound."""


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
        move, target = integrator.kernel().move, self.of.target(self.paths)
        rays = np.zeros((2, self.runs))  # in expectation, of all proposals
        for s, stage in enumerate(done):
            assert stage.start is not None  # b is known, and there is light
            found = looked_at(jax.random.fold_in(key, 100 + s), move, target, self.paths, stage.start, tries)
            rays += found.reshape(2, self.runs, -1).mean(-1) / tries * stage.samples
        acceptance = np.average([stage.acceptance for stage in done], axis=0, weights=share)
        return Images(whole.image(), whole.density, acceptance, blocked_share(rays), share.sum())

    def apart(self, key: Key, method: str, chains: int, samples: int) -> Layer | Stacked:
        """MLT in one stage or more by many chains, with b of each stage estimated, so that its scale is its own."""
        integrator = replace(self._integrator(method, self.large), chains=chains)
        return integrator.render(key, self.scene, self.edges, samples)

    def path(self, key: Key) -> Images:
        """Independent samples, each pixel with as many of those that begin at the sensor.

        Those that begin at a lamp and bring no light are in no pixel.
        """
        drawn = self.draws(key, self.samples)
        pixels = len(self.exact)
        image = self._film(drawn.pixel, drawn.energy) * pixels / self.samples
        density = self._film(drawn.pixel, drawn.seen)
        each = [self._film(drawn.pixel, drawn.energy**power).sum(0) for power in (1, 2)]
        sums = Sums(drawn.energy.size, each[0], each[1], self._most())
        layer = Layer(self.edges, float(pixels), sums, None, float(self.edges) * sums.size)
        nothing = np.full(self.runs, np.nan)
        return Images(image, density, nothing, blocked_share(drawn.rays), float(self.samples), layer)

    def redistribution(self, key: Key) -> Images:
        """ERPT: one mutation for each path on average, from starts of equal energy."""
        draw_key, xi_key, walk_key, shadow_key = jax.random.split(key, 4)
        count, pixels = self.samples // 2, len(self.exact)
        drawn = self.draws(draw_key, count)
        quantum = self.exact.mean() * self.length
        xi = np.asarray(jax.random.uniform(xi_key, drawn.energy.shape), np.float64)
        started = chains_of(drawn.energy, quantum, xi)
        run, path = (np.repeat(at, started[started > 0]) for at in np.nonzero(started))
        integrator = self._integrator("MLT", 0.0)
        kernel, target = integrator.kernel(), integrator.target(self.paths)
        lanes, rows, accepted, looks = self.runs * self.chains, [], [], []
        tries = max(1, self.shadows * self.length // count)  # from every start, of which there are count / length
        plain = np.ones((self.runs, pixels))  # of the same shape as the stages': one program
        for first in range(0, len(run), lanes):
            own = np.arange(first, first + lanes) % len(run)  # what fills the last batch up is thrown away
            start = State(jnp.asarray(drawn.technique[run[own], path[own]]), jnp.asarray(drawn.u[run[own], path[own]]))
            found = expose(jax.random.fold_in(walk_key, first), kernel, target, plain, start, self.length)
            rows.append(found.rows.reshape(lanes, *found.rows.shape[2:])[:, 0])
            accepted.append(found.acceptance.ravel())
            own_key = jax.random.fold_in(shadow_key, first)
            looks.append(looked_at(own_key, kernel.move, self.of.target(self.paths), self.paths, start, tries))
        acceptance = np.zeros(self.runs)
        np.add.at(acceptance, run, np.concatenate(accepted)[: len(run)])
        # A path's chains depend on each other: what it puts into each pixel is one number.
        paths, rank = np.unique(run * count + path, return_inverse=True)
        each = np.zeros((len(paths), pixels))
        np.add.at(each, rank, np.concatenate(rows)[: len(run)] / self.length)
        density = np.zeros_like(plain)
        np.add.at(density, paths // count, each * self.length)
        chains = np.bincount(run, minlength=self.runs)
        image = quantum / self.length * density * pixels / count
        # Whether a path starts chains depends on its energy: their number is bounded by the brightest.
        sums = Sums(drawn.energy.size, quantum * each.sum(0), quantum**2 * (each**2).sum(0), self._most() + quantum)
        # Of the paths every ray was looked at; of the mutations so many of each chain.
        rays = np.array(drawn.rays)
        np.add.at(rays.T, run, np.concatenate(looks, -1)[:, : len(run)].T / tries * self.length)
        work = count + chains.mean() * self.length
        layer = Layer(self.edges, float(pixels), sums, None, float(self.edges) * work * self.runs)
        return Images(image, density, acceptance / np.maximum(chains, 1), blocked_share(rays), work, layer)

    def _most(self) -> float:
        """What n w_i f / p_i of a path never exceeds."""
        return self.of.target(self.paths).n_techniques * brightest(self.scene, self.edges)

    def _integrator(self, method: str, large: float) -> StagedMLT:
        return StagedMLT(STAGED[method], of=self.of, sigma=self.sigma, large=large, chains=self.chains)  # pyright: ignore

    def draws(self, key: Key, count: int) -> "Draws":
        """Independent samples of every run; the film's number is stratified."""
        target, lanes = self.of.target(self.paths), self.runs * _BATCH
        batches = -(-count // _BATCH)
        found = [_draws(key, target, self.paths, jnp.asarray(k), lanes) for k in range(batches)]
        parts = [jax.tree.map(lambda a: np.asarray(a).reshape(*a.shape[:-1], self.runs, _BATCH), one) for one in found]
        index, u, energy, pixel, seen, cast_, blocked = (
            np.concatenate([part[k] for part in parts], -1)[..., :count] for k in range(7)
        )
        rays = np.stack([cast_.sum(-1), blocked.sum(-1)]).astype(np.float64)
        return Draws(index, np.moveaxis(u, 0, -1), energy.astype(np.float64), pixel, seen, rays)

    def _film(self, pixel: np.ndarray, weight: np.ndarray) -> np.ndarray:
        film = np.zeros((self.runs, len(self.exact)))
        np.add.at(film, (np.arange(self.runs)[:, None], pixel), weight)
        return film


_BATCH = 2**8
"""Independent samples of each run at once: stratified over the pixels, a multiple of whose number it must be."""


class Draws(NamedTuple):
    """Independent samples of every run: (runs, samples), u (runs, samples, m)."""

    technique: np.ndarray
    u: np.ndarray
    energy: np.ndarray
    """n w_i f / p_i."""
    pixel: np.ndarray
    seen: np.ndarray
    """Whether it is in that pixel at all."""
    rays: np.ndarray
    """Shadow rays that were cast, and those of them that were blocked, (2, runs)."""


@eqx.filter_jit
def _draws(
    key: Key, target: Multiplexed, paths: Paths, batch: Int[Array, ""], lanes: int
) -> tuple[Index, Array, Array, Array, Array, Array, Array]:
    """What `Draws` has, and whether there is a shadow ray and whether it is blocked; the last axis are samples."""
    dtype = jnp.zeros(()).dtype
    target, paths = cast((target, paths), dtype)
    numbers = uniforms(key, batch, (target.dim_u + 1, lanes), dtype)
    stratum = jnp.arange(lanes) % paths.sensor.pixels
    u = numbers[1:].at[0].set(below_one((stratum.astype(dtype) + numbers[1]) / paths.sensor.pixels))
    state = uniform_states(target, numbers[0], u)
    index, seen = state.index, state.seen
    energy = target.n_techniques * jnp.exp(seen.log_c)
    # The first number is the place on the film if the walk from the sensor has more than a pinhole. Then the pixel is
    # the stratum: worked out from the path it may, by rounding, be the next.
    family = target.family
    assert isinstance(family, Bidirectional)
    begun = jnp.asarray(family.lengths)[index] + paths.sensor.places >= 2
    pixel = jnp.where(begun, stratum, jax.vmap(paths.pixel, in_axes=-1)(seen.x))
    return index, u, energy, pixel, begun | (energy > 0), *shadow_rays(target, paths, index, seen.x)


def pooled(layers: Sequence[Layer]) -> Layer:
    """One image of several that were made alike, by as many paths each."""
    sums = [layer.deposits for layer in layers]
    total, squares = (np.sum([getattr(one, of) for one in sums], axis=0) for of in ("total", "squares"))
    deposits = Sums(sum(one.size for one in sums), total, squares, sums[0].bound)
    return layers[0]._replace(deposits=deposits, rays=sum(layer.rays for layer in layers))


__all__ = ["Contest", "Images", "pooled"]
