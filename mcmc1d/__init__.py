"""A research-validation toolkit for low-dimensional Markov chain Monte Carlo.

Techniques are bijections u <-> (x, v), moves are involutions (s, w) <-> (s', w'), one function accepts.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mcmc1d import (
        flatland,
        image,
        importance,
        lazy,
        moves,
        packets,
        pixels,
        pooled,
        redistribution,
        rendering,
        replicated,
        stages,
        subchain,
        targets,
        techniques,
        tempering,
        verify,
        weights,
    )
    from mcmc1d.chain import Run, Trace, run, trace
    from mcmc1d.estimators import Acceptance, Estimator, Expectation, Histogram
    from mcmc1d.metropolis import Cycle, Kernel, Metropolis
    from mcmc1d.planar_histogram import Histogram2D
    from mcmc1d.starts import Normalisation, StartError, exact_start, normalisation
    from mcmc1d.state import Eval, Multiplexed, State
else:
    # On first use: pytest imports this package at the start of everyone's run, for its plugin, and must not wait for
    # JAX. Hidden from type checkers, to which a module with __getattr__ has every name.
    def __getattr__(name):
        from importlib import import_module

        home = _HOMES.get(name)
        if home is None:
            raise AttributeError(f"module 'mcmc1d' has no attribute {name!r}", name=name)
        module = import_module(f"mcmc1d.{home}")
        globals()[name] = value = module if home == name else getattr(module, name)
        return value

    def __dir__():
        return sorted({*globals(), *__all__})


_MODULES = [
    "flatland",
    "image",
    "importance",
    "lazy",
    "moves",
    "packets",
    "pixels",
    "pooled",
    "redistribution",
    "rendering",
    "replicated",
    "stages",
    "subchain",
    "targets",
    "techniques",
    "tempering",
    "verify",
    "weights",
]

_HOMES = {
    **dict.fromkeys(["Run", "Trace", "run", "trace"], "chain"),
    **dict.fromkeys(["Normalisation", "StartError", "exact_start", "normalisation"], "starts"),
    **dict.fromkeys(["Acceptance", "Estimator", "Expectation", "Histogram"], "estimators"),
    **dict.fromkeys(["Cycle", "Kernel", "Metropolis"], "metropolis"),
    **dict.fromkeys(["Eval", "Multiplexed", "State"], "state"),
    "Histogram2D": "planar_histogram",
    **{name: name for name in _MODULES},
}
"""The module of each public name; a submodule's is its own."""

__all__ = [
    "Acceptance",
    "Cycle",
    "Estimator",
    "Eval",
    "Expectation",
    "Histogram",
    "Histogram2D",
    "Kernel",
    "Metropolis",
    "Multiplexed",
    "Normalisation",
    "Run",
    "StartError",
    "State",
    "Trace",
    "exact_start",
    "flatland",
    "image",
    "importance",
    "lazy",
    "moves",
    "normalisation",
    "packets",
    "pixels",
    "pooled",
    "redistribution",
    "rendering",
    "replicated",
    "run",
    "stages",
    "subchain",
    "targets",
    "techniques",
    "tempering",
    "trace",
    "verify",
    "weights",
]
