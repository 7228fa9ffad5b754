"""Energy redistribution path tracing: short chains of equal energy from independent paths (Cline et al. 2005)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.chain import run
from mcmc1d.checks import require_positive, require_whole
from mcmc1d.compiling import wide_jit
from mcmc1d.flatland.integrators.base import Integrator, brightest, multiplexed
from mcmc1d.flatland.integrators.chains import EachChain
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.sampling import Sums, bootstrap, undefined_light
from mcmc1d.flatland.scene import Scene
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import SmallStep
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.redistribution import chains_of
from mcmc1d.starts import uniform_states
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Key
from mcmc1d.weights import Balance, Maximum, Power

_PATHS = 2**12
"""Independent paths at once."""
_CHAINS = 2**10
"""Chains at once: one size, so that one program serves any number of them."""


class EnergyRedistribution(Integrator):
    """ERPT (Cline, Talbot, Egbert 2005): paths by BDPT, and from each as many chains as its energy has quanta.

    A path of energy e = n w_i f / p_i starts floor(e / quantum + xi) chains of `length` small steps, each of which
    deposits the quantum evenly along its way, on proposals and states with a and 1 - a. The starts follow f in
    expectation and the chains keep it: unbiased for any quantum and length. The quantum is such that a path brings
    `mutations` steps on average, by an estimate of b that errs without harm. No filter takes away noise.

    `samples` are the paths and the steps together. The standard error is that of the paths, each with its chains.
    """

    length: int = eqx.field(static=True, default=32)
    mutations: float = 1.0
    """Steps of chains for each path, on average."""
    sigma: float = 0.03
    weights: Balance | Power | Maximum = Balance()

    def __check_init__(self):
        require_whole(self.length, "EnergyRedistribution: length")
        require_positive(self, mutations=self.mutations)

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, None, self.weights)

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        b_key, path_key, key = jax.random.split(key, 3)
        paths = Paths(scene, edges)
        target, pixels = self.target(paths), paths.sensor.pixels
        most = target.n_techniques * brightest(scene, edges)
        batches = max(1, round(samples / (1 + self.mutations) / _PATHS))
        size = batches * _PATHS
        b = bootstrap(b_key, target, _PATHS, most)
        # A quantum, and whatever it is the image is unbiased: also where no path for b was lit.
        mean = b.mean.item() if b.total.any() else most / b.size
        quantum = mean * self.length / self.mutations
        index, u, owner = self._starts(path_key, target, batches, quantum)
        # Sums of each path: a chain's mean deposit is a quantum of its path's energy.
        paths_with, rank = np.unique(owner, return_inverse=True)
        each = np.zeros((len(paths_with), pixels))
        np.add.at(each, rank, quantum * self._walked(key, target, paths, index, u))
        sums = Sums(size, each.sum(0), (each**2).sum(0), most + quantum)
        rays = float(edges) * (size + len(owner) * self.length + b.size)
        return Layer(edges, float(pixels), sums, None, rays)

    def _starts(
        self, key: Key, target: Multiplexed, batches: int, quantum: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The index and u of each chain's start, and which path it is."""
        found: list[Any] = []
        for k in range(batches):
            state, energy, xi = (jax.tree.map(np.asarray, part) for part in _energies(key, target, jnp.asarray(k)))
            if not np.all(np.isfinite(energy)):
                raise undefined_light(target)
            path = np.repeat(np.arange(_PATHS), chains_of(energy.astype(np.float64), quantum, xi))
            found.append((state.index[path], state.u[path], path + k * _PATHS))
        index, u, owner = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return index, u, owner

    def _walked(self, key: Key, target: Multiplexed, paths: Paths, index: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The mean deposits of each chain, (chains, pixels)."""
        kernel, film = Metropolis(SmallStep(self.sigma)), {"film": EachChain(paths, _CHAINS)}
        means = []
        for first in range(0, len(index), _CHAINS):
            own = np.arange(first, first + _CHAINS) % len(index)  # what fills the last batch up is thrown away
            ran = run(
                jax.random.fold_in(key, first),
                kernel,
                target,
                steps=self.length,
                chains=_CHAINS,
                blocks=1,
                estimators=film,
                start=State(jnp.asarray(index[own]), jnp.asarray(u[own])),
            )
            means.append(ran.sums["film"][0].T / self.length)
        return np.concatenate(means)[: len(index)] if means else np.zeros((0, paths.sensor.pixels))


@wide_jit
def _energies(key: Key, target: Multiplexed, batch: Array) -> tuple[State, Float[Array, " n"], Float[Array, " n"]]:
    """Independent (index, u), the energy of each, and a uniform number."""
    dtype = jnp.zeros(()).dtype
    target = cast(target, dtype)
    numbers = uniforms(key, batch, (target.dim_u + 2, _PATHS), dtype)
    state = uniform_states(target, numbers[0], numbers[2:])
    return State(state.index, state.u.T), target.n_techniques * jnp.exp(state.seen.log_c), numbers[1]


__all__ = ["EnergyRedistribution"]
