"""A research-validation toolkit for low-dimensional Markov chain Monte Carlo.

Techniques are bijections u <-> (x, v), moves are involutions (s, w) <-> (s', w'), one function accepts.
"""

from mcmc1d import moves, targets, techniques, verify, weights
from mcmc1d.chain import Normalisation, Run, Trace, exact_start, normalisation, run, trace
from mcmc1d.estimators import Acceptance, Estimator, Expectation, Histogram
from mcmc1d.metropolis import Cycle, Kernel, Metropolis
from mcmc1d.state import Eval, Multiplexed, State

__all__ = [
    "Acceptance",
    "Cycle",
    "Estimator",
    "Eval",
    "Expectation",
    "Histogram",
    "Kernel",
    "Metropolis",
    "Multiplexed",
    "Normalisation",
    "Run",
    "State",
    "Trace",
    "exact_start",
    "moves",
    "normalisation",
    "run",
    "targets",
    "techniques",
    "trace",
    "verify",
    "weights",
]
