"""A random walk on two modes of the line: this library with its histogram, BlackJAX, NumPyro and emcee with nothing."""

import time
from collections.abc import Callable
from typing import Any

import blackjax
import emcee
import jax
import jax.numpy as jnp
import numpy as np
import numpyro

import mcmc1d
from experiments.support.bench_steps import Contestant, library
from experiments.support.samplers import autocorrelation_time
from mcmc1d.metropolis import Metropolis
from mcmc1d.moves import SmallStep
from mcmc1d.targets import GaussianMixture
from mcmc1d.techniques import Uniform

SIGMA = 0.1
CHAINS, STEPS = 8192, 8192
LONG, FEW = 2000, 64
"""Steps and chains of which the autocorrelation time is taken."""


def target() -> mcmc1d.Multiplexed:
    """Two modes on the unit interval, with next to nothing at its ends."""
    return mcmc1d.Multiplexed(GaussianMixture([0.25, 0.7], [0.05, 0.08], [0.4, 0.6]), Uniform())


def contestants(work: float) -> dict[str, Contestant]:
    """Each keeps no more than it must: this library a histogram, the others the last state."""
    line, steps = target(), max(1, int(STEPS * work))
    walk = Metropolis(SmallStep(SIGMA), "plain")  # a histogram of the states, and no expected values
    ours = {source: library(line, walk, steps, source) for source in ("threefry", "hash32")}
    x = mcmc1d.trace(jax.random.key(0), walk, line, steps=LONG, chains=FEW).x
    found = {name: Contestant(go, autocorrelation_time(x)) for name, go in ours.items()}
    few = max(1, int(200 * work))
    found["BlackJAX"] = _jax(line, few, *_blackjax(line))
    found["NumPyro Barker"] = _jax(line, few, *_numpyro(line))
    moves = {"emcee stretch": emcee.moves.StretchMove(), "emcee Gaussian": emcee.moves.GaussianMove(SIGMA**2)}
    for name, move in moves.items():
        found[name] = _emcee(line, max(1, int(60 * work)), move)
    return found


Scan = Callable[[Any, Any, int], Any]
"""(Keys, starts, steps) -> the states of every chain after every step."""


def _blackjax(line: mcmc1d.Multiplexed) -> tuple[Callable, Callable]:
    algorithm: Any = blackjax.rmh(line.target.log_f, lambda key, x: x + SIGMA * jax.random.normal(key, x.shape))
    return lambda key, x: algorithm.init(x), lambda key, state: algorithm.step(key, state)[0]


def _numpyro(line: mcmc1d.Multiplexed) -> tuple[Callable, Callable]:
    """It has no plain random walk; Barker's proposal is its nearest, at a gradient a step."""
    kernel = numpyro.infer.BarkerMH(
        potential_fn=lambda x: -line.target.log_f(x), step_size=SIGMA, adapt_step_size=False, adapt_mass_matrix=False
    )

    def step(key: Any, state: Any) -> Any:
        return kernel.sample(state._replace(rng_key=key), (), {})

    return lambda key, x: kernel.init(key, 0, x, (), {}), step


def _jax(line: mcmc1d.Multiplexed, steps: int, init: Callable, step: Callable) -> Contestant:
    def position(state: Any) -> Any:
        return state.position if hasattr(state, "position") else state.z

    def chain(key: Any, x: Any, count: int, keep: bool) -> Any:
        def body(state: Any, k: Any) -> Any:
            state = step(jax.random.fold_in(key, k), state)
            return state, position(state) if keep else None

        last, kept = jax.lax.scan(body, init(key, x), jnp.arange(count))
        return kept if keep else position(last)

    many = jax.jit(jax.vmap(lambda key, x: chain(key, x, steps, False)))
    starts = mcmc1d.exact_start(jax.random.key(0), line, CHAINS).seen.x

    def go(seed: int) -> float:
        keys = jax.random.split(jax.random.key(seed), CHAINS)
        begin = time.process_time()
        jax.block_until_ready(many(keys, starts))
        return CHAINS * steps / (time.process_time() - begin)

    go(0)
    kept = jax.jit(jax.vmap(lambda key, x: chain(key, x, LONG, True)))
    x = np.asarray(kept(jax.random.split(jax.random.key(1), FEW), starts[:FEW]))
    return Contestant(go, autocorrelation_time(x.T))


def _emcee(line: mcmc1d.Multiplexed, steps: int, move: Any) -> Contestant:
    """One ensemble of as many walkers as the others have chains; the density of half of them at a time, compiled."""
    batch = jax.jit(jax.vmap(line.target.log_f))

    def log_prob(x: np.ndarray) -> np.ndarray:
        return np.asarray(batch(x[:, 0].astype(np.float32)), np.float64)

    def walk(seed: int, walkers: int, steps: int, store: bool) -> tuple[Any, float]:
        starts = np.asarray(mcmc1d.exact_start(jax.random.key(seed), line, walkers).seen.x, np.float64)[:, None]
        sampler = emcee.EnsembleSampler(walkers, 1, log_prob, moves=move, vectorize=True)
        sampler.random_state = np.random.RandomState(seed).get_state()
        sampler.compute_log_prob(starts)
        begin = time.process_time()
        for _ in sampler.sample(starts, iterations=steps, store=store, skip_initial_state_check=True):
            pass
        return sampler, time.process_time() - begin

    def go(seed: int) -> float:
        return CHAINS * steps / walk(seed, CHAINS, steps, False)[1]

    go(0)
    # In an ensemble of the size that is timed, from its first walkers: how a stretch moves depends on the others.
    chain = walk(1, CHAINS // 8, LONG // 2, True)[0].get_chain()[:, :FEW, 0]
    return Contestant(go, autocorrelation_time(chain))
