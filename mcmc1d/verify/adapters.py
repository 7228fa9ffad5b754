"""Whatever kernel a user has, under test: this library's, BlackJAX's, NumPyro's, emcee's; none need be installed."""

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from mcmc1d.checks import require
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.moves import Move
from mcmc1d.state import Multiplexed
from mcmc1d.verify.kernels import HostKernel, HostSubject, JaxKernel, JaxSubject
from mcmc1d.verify.law import Law
from mcmc1d.verify.library import LibrarySubject
from mcmc1d.verify.statistic import Position
from mcmc1d.verify.subject import Look, Subject


def as_subject(
    kernel: Any, target: Any, law: Law, *, reversible: bool | None, deposits: Callable | None, max_weight: float
) -> Subject:
    """The subject for whatever kernel a user has; raises `ValueError` for what is none."""
    require(
        not isinstance(kernel, type), f"give an instance, not the class: {getattr(kernel, '__name__', kernel)}(...)"
    )
    require(reversible in (None, True, False), f"reversible is True, False or None, not {reversible!r}")
    foreign = deposits is not None or max_weight != 1
    if isinstance(kernel, Kernel | Move):
        require(
            isinstance(target, Multiplexed),
            f"a move of this library is verified on a mcmc1d.Multiplexed target, not on {type(target).__name__}",
        )
        require(not foreign, "a kernel of this library brings its own deposits: leave out deposits= and max_weight=")
        return LibrarySubject(Metropolis(kernel) if isinstance(kernel, Move) else kernel, target, reversible)
    subject = _foreign(kernel, law)
    if isinstance(subject, JaxKernel):
        subject = replace(subject, deposits=subject.deposits if deposits is None else deposits)
        subject = JaxSubject(subject, max_weight)
    elif isinstance(subject, HostKernel):
        require(not foreign, "deposits are tested of JAX kernels only; a HostKernel has none")
        subject = HostSubject(subject)
    else:
        require(not foreign, f"deposits are tested of JAX kernels only; {subject.name} has none")
        subject = copy.copy(subject)  # what is declared here is not the caller's
    require(
        not reversible or subject.together == 1,
        f"{subject.name}: the walkers of an ensemble move by each other, and their (first, last) pairs are not "
        "independent; leave out reversible=",
    )
    if reversible is not None:
        subject.reversible = reversible
    return subject


def _foreign(kernel: Any, law: Law) -> JaxKernel | HostKernel | Subject:
    """What a kernel of another library is, or a plain JAX function."""
    if isinstance(kernel, JaxKernel | HostKernel | Subject):
        return kernel
    if _has_base(kernel, "emcee.moves.move", "Move"):
        return emcee(kernel, law)
    if _has_base(kernel, "numpyro.infer.mcmc", "MCMCKernel"):
        return numpyro(kernel)
    if isinstance(kernel, tuple) and hasattr(kernel, "init") and hasattr(kernel, "step"):
        return blackjax(kernel)
    if callable(kernel):
        return JaxKernel(kernel)
    raise ValueError(
        f"{kernel!r} is no kernel: give a move of this library, a function step(key, position), a verify.JaxKernel or "
        "verify.HostKernel, a BlackJAX algorithm, a NumPyro kernel or an emcee move"
    )


def blackjax(algorithm: Any, *, name: str = "", reversible: bool | None = None) -> JaxKernel:
    """A BlackJAX `SamplingAlgorithm` (`blackjax.nuts(logdensity, ...)`), whose states have a `position`."""
    import inspect

    # The second parameter is the key: of some algorithms, such as ghmc, it has a default that does not work.
    parameters = inspect.signature(algorithm.init).parameters.values()
    keyed = sum(p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in parameters) > 1

    def init(key: Any, position: Any) -> Any:
        return algorithm.init(position, key) if keyed else algorithm.init(position)

    label = name or "blackjax " + _module(algorithm.step)
    return JaxKernel(algorithm.step, init, lambda state: state.position, reversible=reversible, name=label)


def numpyro(kernel: Any, *, model_args: tuple = (), model_kwargs: dict | None = None, name: str = "") -> JaxKernel:
    """A NumPyro kernel, without its warm-up: positions are its unconstrained parameters.

    Switch adaptation off (`adapt_step_size=False, adapt_mass_matrix=False`), or give what warm-up would have found: a
    kernel that adapts has no stationary law to be tested against.
    """
    keywords = {} if model_kwargs is None else model_kwargs
    field = kernel.sample_field

    def init(key: Any, position: Any) -> Any:
        return kernel.init(key, 0, position, model_args, keywords)

    def step(key: Any, state: Any) -> Any:
        if hasattr(state, "rng_key"):  # the kernel keeps its key in its state; a fresh one is as good
            state = state._replace(rng_key=key)
        return kernel.sample(state, model_args, keywords)

    label = name or f"numpyro {type(kernel).__name__}"
    return JaxKernel(step, init, lambda state: getattr(state, field), name=label)


def emcee(
    move: Any, law: Law | None = None, *, walkers: int = 16, log_prob: Callable[[np.ndarray], np.ndarray] | None = None
) -> "EnsembleSubject":
    """An emcee move in many small ensembles of so many walkers.

    A right ensemble's law is a product, so that all walkers of all ensembles are independent draws when each started
    as one. Small ensembles, because a large one hides what walkers do to each other. `log_prob` of positions (n, d),
    by NumPy, unless the law has a `log_density`.
    """
    require(walkers >= 4, f"an ensemble needs 4 walkers at least, not {walkers}")
    if log_prob is not None:
        return EnsembleSubject(move, walkers, log_prob)
    if law is None or law.log_density is None:
        raise ValueError(
            "an emcee move needs the density: give the law a log_density, or call verify.emcee(move, log_prob=...)"
        )
    batch = jax.jit(jax.vmap(law.log_density))
    return EnsembleSubject(move, walkers, lambda x: np.array(batch(x)))  # a copy, because emcee writes into it


class EnsembleSubject(Subject):
    """An emcee move, in its own `propose`."""

    def __init__(self, move: Any, walkers: int, log_prob: Callable):
        self.move, self.walkers, self.log_prob = move, walkers, log_prob
        self.name = f"emcee {type(move).__name__}, {walkers} walkers"
        self.unit = self.least_unit = walkers * 16
        self.together = walkers

    def check(self, start: Position) -> None:
        require(
            len(start) >= self.walkers, f"{len(start)} replicas are no ensemble of {self.walkers}; give more replicas="
        )
        require(
            hasattr(start, "ndim") and start.ndim <= 2,
            "an emcee move samples points of shape (d,); the law's positions are a tree of several arrays",
        )
        next(self.watch([0], 0, start[: self.walkers], (1,)))

    def crowd(self, points: Position, unlikely: Position, n: int) -> list[Position]:
        # At one point an ensemble could never move: it starts at its least likely draws.
        return [np.resize(np.asarray(unlikely)[: self.walkers], (n, *np.shape(unlikely)[1:]))]

    def watch(self, seed: Sequence[int], first: int, start: Position, times: Sequence[int]) -> Iterator[Look]:
        from emcee import State
        from emcee.model import Model

        def compute(points: np.ndarray) -> tuple[np.ndarray, None]:
            values = self.log_prob(points)
            if np.shape(values) != (len(points),) or np.isnan(values).any():
                raise ValueError(f"{self.name}: log_prob must return one number a walker and no NaN, not {values}")
            return values, None

        points = np.array(start, np.float64).reshape(len(start), -1)
        with jax.enable_x64(True):
            random = np.random.RandomState(np.random.SeedSequence([*seed, first]).generate_state(4))
            model = Model(self.log_prob, compute, map, random)
            # An ensemble that does not fill is left out of the moving, and stays the exact draws that it is.
            states = []
            for k in range(0, len(points) - self.walkers + 1, self.walkers):
                walkers = points[k : k + self.walkers]
                states.append(State(walkers, log_prob=self.log_prob(walkers)))
        done = 0
        for time in times:
            with jax.enable_x64(True):
                states = [self._walked(model, state, time - done) for state in states]
            done = time
            coordinates = np.concatenate([*(state.coords for state in states), points[len(states) * self.walkers :]])
            yield Look(coordinates.reshape(np.shape(start)).copy())

    def _walked(self, model: Any, ensemble: Any, steps: int) -> Any:
        """An ensemble after so many proposals of the move."""
        for _ in range(steps):
            ensemble, _ = self.move.propose(model, ensemble)
        return ensemble


def _module(step: Any) -> str:
    """The algorithm's module, from the functions that its step closes over."""
    cells = [cell.cell_contents for cell in getattr(step, "__closure__", None) or ()]
    modules = [getattr(cell, "__module__", None) or "" for cell in cells]
    names = [module.rsplit(".", 1)[-1] for module in modules if module.startswith("blackjax.")]
    return names[0] if names else "algorithm"


def _has_base(kernel: Any, module: str, name: str) -> bool:
    """Whether a class of this name, from this module, is among the kernel's bases; without importing it."""
    return any(base.__module__ == module and base.__name__ == name for base in type(kernel).__mro__)


__all__ = ["EnsembleSubject", "as_subject", "blackjax", "emcee", "numpyro"]
