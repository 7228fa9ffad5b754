"""Samplers side by side: this library's moves, emcee and BlackJAX, each on a target of this library, timed."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import blackjax
import emcee
import jax
import numpy as np

import mcmc1d
from mcmc1d.moves import Move


@dataclass(frozen=True)
class Size:
    """How much each does."""

    chains: int = 128
    steps: int = 2000
    walkers: int = 32
    """Of an ensemble of emcee, of which there are `ensembles`."""
    ensembles: int = 3
    ensemble_steps: int = 1500
    nuts_steps: int = 1500


class Walk(NamedTuple):
    """What one run of a method leaves."""

    x: np.ndarray
    """(steps, chains, d)."""
    seconds: float
    evaluations: float
    """Of the target, a step of one chain; a gradient counts as one."""


Method = Callable[[int], Walk]
"""Of the seed; starts are exact, and what compiles once is not timed."""


def library(size: Size, target: mcmc1d.Multiplexed, move: Move, evaluations: float) -> Method:
    """A move of this library; its first run compiles."""

    def method(seed: int) -> Walk:
        first, second = jax.random.split(jax.random.key(seed))
        start = mcmc1d.exact_start(first, target, size.chains)
        began = time.perf_counter()
        x = mcmc1d.trace(second, move, target, steps=size.steps, chains=size.chains, start=start).x
        seconds = time.perf_counter() - began
        return Walk(x[..., None] if x.ndim == 2 else x, seconds, evaluations)

    return method


def emcee_stretch(size: Size, target: mcmc1d.Multiplexed) -> Method:
    """Emcee's default move, in independent ensembles."""

    def method(seed: int) -> Walk:
        batch = jax.jit(jax.vmap(_log_f(target)))
        starts = _starts(target, seed, size.walkers * size.ensembles)
        batch(starts[: size.walkers // 2])  # compiles
        chains, seconds = [], 0.0
        for k, start in enumerate(np.split(starts, size.ensembles)):
            sampler = emcee.EnsembleSampler(
                size.walkers,
                start.shape[1],
                lambda x: np.asarray(batch(x.astype(np.float32)), np.float64),
                moves=emcee.moves.StretchMove(),
                vectorize=True,
            )
            sampler.random_state = np.random.RandomState(seed * size.ensembles + k).get_state()
            began = time.perf_counter()
            sampler.run_mcmc(start.astype(np.float64), size.ensemble_steps, skip_initial_state_check=True)
            seconds += time.perf_counter() - began
            chains.append(sampler.get_chain())
        return Walk(np.concatenate(chains, axis=1), seconds, 1)

    return method


def blackjax_walk(size: Size, target: mcmc1d.Multiplexed, sigma: float) -> Method:
    """BlackJAX's random walk; `sigma`, a share of each side of the domain."""
    lower, upper = (np.atleast_1d(np.asarray(corner, np.float32)) for corner in target.target.domain)
    sides = sigma * (upper - lower)
    algorithm = blackjax.rmh(_log_f(target), lambda key, x: x + sides * jax.random.normal(key, x.shape))
    return _blackjax(size.chains, size.steps, target, algorithm, lambda info: 1)


def blackjax_nuts(size: Size, target: mcmc1d.Multiplexed, step: float) -> Method:
    """BlackJAX's NUTS with a leapfrog of this step and unit masses."""
    dim = np.size(target.target.domain[0])
    algorithm = blackjax.nuts(_log_f(target), step, np.ones(dim, np.float32))
    return _blackjax(size.chains, size.nuts_steps, target, algorithm, lambda info: info.num_integration_steps)


def _blackjax(chains: int, steps: int, target: mcmc1d.Multiplexed, algorithm: Any, evaluations: Callable) -> Method:
    def chain(key: Any, x: Any) -> Any:
        def step(state: Any, key: Any) -> Any:
            state, info = algorithm.step(key, state)
            return state, (state.position, evaluations(info))

        return jax.lax.scan(step, algorithm.init(x), jax.random.split(key, steps))[1]

    keys = jax.random.split(jax.random.key(0), chains)
    walk = jax.jit(jax.vmap(chain)).lower(keys, _starts(target, 0, chains)).compile()

    def method(seed: int) -> Walk:
        starts = _starts(target, seed, chains)
        keys = jax.random.split(jax.random.key(seed + 1000), chains)
        began = time.perf_counter()
        x, counts = jax.block_until_ready(walk(keys, starts))
        seconds = time.perf_counter() - began
        return Walk(np.moveaxis(np.asarray(x), 0, 1), seconds, float(np.mean(counts)))

    return method


def _log_f(target: mcmc1d.Multiplexed) -> Callable[[Any], Any]:
    """Of positions of shape (d,), on the line too."""
    scalar = np.ndim(target.target.domain[0]) == 0
    return lambda x: target.target.log_f(x[0] if scalar else x)


def _starts(target: mcmc1d.Multiplexed, seed: int, count: int) -> np.ndarray:
    """Exact draws of x, (count, d)."""
    return np.asarray(mcmc1d.exact_start(jax.random.key(seed), target, count).seen.x).reshape(count, -1)


def autocorrelation_time(x: np.ndarray, window: float = 5) -> float:
    """The integrated autocorrelation time of (steps, chains), by Sokal's window, about the mean of all chains.

    About each chain's own mean it would come out too short where a chain is not many times as long.
    """
    n = len(x)
    spectrum = np.abs(np.fft.rfft(x - x.mean(), 2 * n, axis=0)) ** 2
    correlation = np.fft.irfft(spectrum.mean(1))[:n] / np.arange(n, 0, -1)
    times = 2 * np.cumsum(correlation / correlation[0]) - 1
    enough = np.arange(n) >= window * times
    return float(times[np.argmax(enough) if enough.any() else n - 1])
