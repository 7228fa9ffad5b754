"""Many independent images at once, by Metropolis in one or more stages, each with an importance function of its own.

One program serves every stage: the table inside the importance function is traced, and so is its resolution.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_key, require_whole
from mcmc1d.estimators import added, empty
from mcmc1d.image import Film, Image
from mcmc1d.importance import Product, Regions, require_importance
from mcmc1d.metropolis import Kernel, as_kernel, step_batch
from mcmc1d.moves import Move
from mcmc1d.numerics import cast
from mcmc1d.pixels import Pixels, masses, resample
from mcmc1d.quadrature import midpoints
from mcmc1d.random import uniforms
from mcmc1d.stages import Stage
from mcmc1d.starts import StartError, independent_states, uniform_states
from mcmc1d.state import Multiplexed, State
from mcmc1d.targets import Target
from mcmc1d.techniques import Technique
from mcmc1d.types import Array, Float, Int, Key

NORMALISERS = ("exact", "apart", "plugged")
"""Where b_I comes from: exact masses; independent samples of the stage's own; the image so far, as Algorithm 2 says."""

Importance = Callable[[Film | None, int], np.ndarray]
"""Of the film so far (None before any) and a stage's k: what f is multiplied by, (replicas, k) or (replicas, k, k)."""


class Rendered(NamedTuple):
    """What independent renders made, one a replica."""

    film: Film
    work: float
    """Evaluations of f by each: steps, and samples for b where it was estimated apart."""
    acceptance: np.ndarray
    """(replicas,), the mean of all steps; NaN of independent samples."""


class Scene(eqx.Module):
    """What is rendered: f, the techniques that reach it, and the pixels, with exact masses of f over any regions."""

    target: Multiplexed
    base: Target
    """What a chain samples before any table multiplies it: f, as a rule."""
    pixels: Pixels
    cuts: tuple[tuple[float, ...], ...] = eqx.field(static=True)

    def __init__(
        self,
        f: Target,
        techniques: Technique | Sequence[Technique],
        pixels: Pixels,
        cuts: Sequence[ArrayLike] = (),
        base: Target | None = None,
    ):
        """`cuts`: where f jumps or turns sharply, for each coordinate, for exact masses; `base`: f unless given."""
        self.target, self.pixels = Multiplexed(f, techniques), pixels
        self.base = f if base is None else base
        if base is not None:
            require_importance(f, base)
        self.cuts = tuple(tuple(np.asarray(axis, np.float64).tolist()) for axis in cuts)

    @property
    def f(self) -> Target:
        """What is rendered."""
        return self.target.target

    @property
    def hidden(self) -> int:
        """How many coordinates of x are no axes of the image."""
        return max(1, int(np.prod(np.shape(self.f.domain[0])))) - self.pixels.dim

    def region_masses(self, regions: int, of: Target | None = None) -> np.ndarray:
        """The integral of f, or `of` another, over each of k (or k x k) regions, of shape (k,) or (k, k)."""
        edges = [np.linspace(0, 1, regions + 1)] * self.pixels.dim + [np.array([0.0, 1.0])] * self.hidden
        return masses(self.f if of is None else of, edges, self.cuts).reshape((regions,) * self.pixels.dim)

    def exact(self) -> np.ndarray:
        """The exact image, of shape (pixels,)."""
        return self.region_masses(self.pixels.side).ravel() * self.pixels.count

    def multiplexed(self, values: Float[Array, "..."], regions: Any) -> tuple[Product, Multiplexed]:
        """The importance function, `base` times the table of values, and what a chain samples."""
        importance = Product((self.base, Regions(values, regions, self.hidden)))
        return importance, Multiplexed(importance, self.target.techniques, self.target.weights)


class Renderer(eqx.Module):
    """Renders `replicas` independent images of a scene by `chains` chains each, which start exactly in each stage."""

    scene: Scene
    kernel: Kernel
    replicas: int = eqx.field(static=True)
    chains: int = eqx.field(static=True)

    def __init__(self, scene: Scene, kernel: Kernel | Move, replicas: int, chains: int = 4):
        """`kernel`: or a move, which `Metropolis` then accepts."""
        self.scene, self.kernel = scene, as_kernel(kernel, "Renderer: the kernel")
        require_whole(replicas, "Renderer: replicas")
        require_whole(chains, "Renderer: chains")
        self.replicas, self.chains = replicas, chains
        self.kernel.check(scene.target)

    def render(
        self, key: Key, stages: Sequence[Stage], importance: Importance, b: str = "exact", apart: float = 0.25
    ) -> Rendered:
        """All stages, each with the importance function of the film so far, and every stage's samples in the film.

        `b`: see `NORMALISERS`; of f itself, in the first stage, there is nothing to plug in, and it is estimated
        apart. `apart`: the independent samples that such an estimate spends, per sample of the stage.

        Raises `ValueError` where in a stage the importance function is NaN, infinite, negative, has more regions than
        the image has pixels, integrates to zero, or is too narrow for exact starts by rejection.
        """
        require_key(key, "render")
        require(b in NORMALISERS, f'render: b must be "exact", "apart" or "plugged", not {b!r}')
        film, work, accepted, steps_done = None, 0.0, np.zeros(self.replicas), 0
        for s, stage in enumerate(stages):
            k, dim = stage.regions, self.scene.pixels.dim
            values = np.broadcast_to(importance(film, k), (self.replicas,) + (k,) * dim)
            require(
                bool(np.isfinite(values).all() and (values >= 0).all()),
                f"render: in stage {s} the importance function is NaN, infinite or negative in a region; a region "
                "without samples has an image of zero",
            )
            b_key, stage_key = jax.random.split(jax.random.fold_in(key, s))
            steps = max(1, round(stage.samples / self.chains))
            if b == "exact":
                normaliser = (self.scene.region_masses(k, self.scene.base) * values).reshape(self.replicas, -1).sum(1)
            elif b == "apart" or film is None:
                count = max(2, round(apart * stage.samples))
                normaliser, work = self._apart(b_key, values, k, count), work + count
            else:
                image = film.image().reshape((self.replicas,) + (self.scene.pixels.side,) * dim)
                normaliser = (resample(image, k, dim) * values).reshape(self.replicas, -1).mean(1)
            require(
                bool(np.all(np.asarray(normaliser) > 0)),
                f"render: in stage {s} b, the integral of the importance function, is zero for some replica: there is "
                "nothing to sample",
            )
            more, rate = self._stage(stage_key, values, k, normaliser, steps)
            film = more if film is None else film.plus(more)
            accepted, steps_done, work = accepted + rate * steps, steps_done + steps, work + steps * self.chains
        require(film is not None, "render: give one stage at least")
        return Rendered(film, work, accepted / steps_done)  # pyright: ignore[reportArgumentType]

    def plain(self, key: Key, samples: int, b: str = "exact") -> Rendered:
        """Metropolis in one stage, by the scene's own importance: ordinary MLT, as a rule."""
        return self.render(key, [Stage(1, samples)], self._unchanged, b)

    def _unchanged(self, film: Film | None, regions: int) -> np.ndarray:
        return np.ones((1,) + (regions,) * self.scene.pixels.dim)

    def two_stage(self, key: Key, first: Stage, samples: int, importance: Importance) -> tuple[Rendered, Rendered]:
        """Veach's two stages: a test image of `first.regions` regions, whose samples are spent and thrown away.

        Returns the test image and the final one, of `samples`, whose importance is f over the test image's regions;
        the work of the second includes that of the first.
        """
        one, two = jax.random.split(key)
        test = self.plain(one, first.samples)
        final = self.render(two, [Stage(first.regions, samples)], lambda _, k: importance(test.film, k))
        return test, final._replace(work=final.work + test.work)

    def batches(self, key: Key, samples: int, count: int) -> list[Film]:
        """Metropolis in one stage, its film dealt into `count` batches of consecutive steps, for batch means."""
        require_whole(samples, "batches: samples")
        require_whole(count, "batches: count", 2)
        values = np.broadcast_to(self._unchanged(None, 1), (self.replicas,) + (1,) * self.scene.pixels.dim)
        b, steps = self.scene.region_masses(1, self.scene.base).sum(), max(1, round(samples / self.chains / count))
        films, state, one, padded = [], None, _whole(1), self._padded(values)
        for k in range(count):
            keys = jax.random.split(jax.random.fold_in(key, k), self.replicas)
            sums, _, state = self._exposed(keys, padded, one, steps, state)
            films.append(Film.of(sums, np.full(self.replicas, b), steps * self.chains))
        return films

    def _stage(self, key: Key, values: np.ndarray, k: int, b: np.ndarray, steps: int) -> tuple[Film, np.ndarray]:
        keys = jax.random.split(key, self.replicas)
        sums, rate, _ = self._exposed(keys, self._padded(values), _whole(k), steps, None)
        return Film.of(sums, b, steps * self.chains), rate

    def _exposed(
        self, keys: Array, values: Array, regions: Array, steps: int, state: State | None
    ) -> tuple[Float[np.ndarray, "r n 5"], Float[np.ndarray, " r"], State]:
        """The film's sums, the mean acceptance and the last states; from exact starts, unless there are states."""
        if state is None:
            state, faults = _start(keys, self.scene, values, regions, self.chains)
            fault = int(np.max(faults))
            if fault:
                raise (StartError if fault == _TOO_NARROW else ValueError)(f"render: {_FAULTS[fault]}")
        sums, accepted = np.zeros(()), np.zeros(())
        for first in range(0, steps, STEPS_AT_ONCE):
            count = min(STEPS_AT_ONCE, steps - first)
            more, rate, state = _expose(
                keys, self.scene, self.kernel, values, regions, state, _whole(first), _whole(count)
            )
            sums, accepted = sums + np.asarray(more, np.float64), accepted + np.asarray(rate, np.float64)
        return sums, accepted / steps, state

    def _apart(self, key: Key, values: np.ndarray, k: int, count: int) -> np.ndarray:
        """The integral of I from `count` independent samples of each replica."""
        keys = jax.random.split(key, self.replicas)
        size = 1 << (count - 1).bit_length()  # so that a few sizes compile
        c = np.asarray(_densities(keys, self.scene, self._padded(values), _whole(k), size), np.float64)[:, :count]
        require(
            bool(np.isfinite(c).all()),
            "render: the importance function is NaN or infinite at a sample for b: mend it there, or give a technique "
            "that follows it to its pole",
        )
        return c.mean(1) * self.scene.target.n_techniques

    def _padded(self, values: np.ndarray) -> Array:
        """Tables of one shape, whatever k is, so that every stage runs one program."""
        extra = self.scene.pixels.side - values.shape[-1]
        require(extra >= 0, f"render: a stage has {values.shape[-1]} regions a side, more than the image has pixels")
        pad = [(0, 0)] + [(0, extra)] * self.scene.pixels.dim
        return jnp.asarray(np.pad(values, pad, constant_values=1.0))


STEPS_AT_ONCE = 2**9
"""So that acceptances, which are added up in float32, stay exact enough."""
_ATTEMPTS = 2**18
"""Candidates for each exact start, at most."""
_NOT_FINITE, _TOO_NARROW = 1, 2
_FAULTS = {
    _NOT_FINITE: "the importance function's density is NaN or infinite somewhere: rejection needs a bounded one",
    _TOO_NARROW: f"no exact starts among {_ATTEMPTS} candidates for each: the importance function has a narrow peak; "
    "give techniques that follow it",
}


def _whole(number: int) -> Array:
    """A whole number that is traced, so that another one does not compile again."""
    return jnp.asarray(number, jnp.int32)


@eqx.filter_jit
def _start(keys: Array, scene: Scene, values: Array, regions: Array, chains: int) -> tuple[State, Int[Array, " r"]]:
    """Exact draws for the chains of every replica, and what is at fault with each replica's."""
    dtype = jnp.zeros(()).dtype
    scene, values = cast((scene, values), dtype)

    def one(key: Key, values: Array) -> tuple[State, Array]:
        _, target = scene.multiplexed(values, regions)
        return _exact_starts(jax.random.split(key)[0], target, chains, dtype)

    return jax.vmap(one)(keys, values)


@eqx.filter_jit
def _expose(
    keys: Array,
    scene: Scene,
    kernel: Kernel,
    values: Array,
    regions: Array,
    begin: State,
    first: Array,
    count: Array,
) -> tuple[Float[Array, "r n 5"], Float[Array, " r"], State]:
    """`count` steps from step `first` on of every replica's chains: the film's sums, acceptances, the last states."""
    dtype = jnp.zeros(()).dtype
    scene, kernel, values = cast((scene, kernel, values), dtype)

    def one(key: Key, values: Array, begin: State) -> tuple[Array, Array, State]:
        importance, target = scene.multiplexed(values, regions)
        estimator, step_key = Image(scene.f, importance, scene.pixels), jax.random.split(key)[1]

        def body(k: Array, carry: tuple[State, Array, Array]) -> tuple[State, Array, Array]:
            state, sums, accepted = carry
            step = step_batch(step_key, first + k, kernel, target, state)
            return step.state, added(estimator, sums, step), accepted + step.info.acceptance.mean()

        zero = empty(estimator, target, kernel, dtype)
        begun = jax.vmap(target.evaluate, in_axes=-1, out_axes=-1)(begin)
        last, sums, accepted = jax.lax.fori_loop(0, count, body, (begun, zero, jnp.zeros((), dtype)))
        return sums, accepted, State(last.index, last.u)

    return jax.vmap(one)(keys, values, begin)


def _exact_starts(key: Key, target: Multiplexed, chains: int, dtype: Any) -> tuple[State, Int[Array, ""]]:
    """Exact draws by rejection, as `starts.exact_start`: under the largest density of a grid with a quarter to spare.

    Should a candidate exceed that, the bound is raised and everything is drawn again. The last axis counts the states.
    Also what is at fault, of `_FAULTS`, or 0.
    """
    probes = 1024 if target.dim_u == 1 else 4096
    grid = jnp.asarray(midpoints(np.zeros(target.dim_u), np.ones(target.dim_u), probes), dtype).T
    everywhere = [uniform_states(target, grid[0], grid, i).seen.log_c.max() for i in range(target.n_techniques)]
    bound = jnp.max(jnp.stack(everywhere)) + jnp.log(1.25)

    def unfinished(carry: tuple[Array, State, Array, Array, Array]) -> Array:
        attempt, _, done, _, finite = carry
        return ~jnp.all(done) & finite & (attempt < _ATTEMPTS)

    def draw(carry: tuple[Array, State, Array, Array, Array]) -> tuple[Array, State, Array, Array, Array]:
        attempt, state, done, bound, finite = carry
        fresh, uniform = independent_states(key, attempt, target, chains, dtype)
        density = fresh.seen.log_c
        kept = ~done & (jnp.log(uniform) < density - bound)
        exceeded = density.max() > bound
        state = State(jnp.where(kept, fresh.index, state.index), jnp.where(kept, fresh.u, state.u))
        bound = jnp.where(exceeded, density.max() + jnp.log(1.25), bound)
        finite = finite & jnp.all(density < jnp.inf)  # which a NaN is not
        return attempt + 1, state, (done | kept) & ~exceeded, bound, finite

    nothing = State(jnp.zeros(chains, jnp.int32), jnp.zeros((target.dim_u, chains), dtype))
    start = (jnp.zeros((), jnp.int32), nothing, jnp.zeros(chains, bool), bound, bound < jnp.inf)
    _, state, done, _, finite = jax.lax.while_loop(unfinished, draw, start)
    narrow = jnp.where(jnp.all(done), 0, _TOO_NARROW)
    return state, jnp.where(finite, narrow, _NOT_FINITE).astype(jnp.int32)


@eqx.filter_jit
def _densities(keys: Array, scene: Scene, values: Array, regions: Array, count: int) -> Float[Array, "r n"]:
    """The density C_i(u) of the importance function at independent samples."""
    dtype = jnp.zeros(()).dtype
    scene, values = cast((scene, values), dtype)

    def one(key: Key, values: Array) -> Array:
        _, target = scene.multiplexed(values, regions)
        w = uniforms(key, 0, (target.dim_u + 1, count), dtype)
        return jnp.exp(uniform_states(target, w[0], w[1:]).seen.log_c)

    return jax.vmap(one)(keys, values)
