"""Moves as involutions (s, w) <-> (s', w'); a family in each file, with its `EXAMPLES`."""

from mcmc1d.moves.base import Move, Proposal
from mcmc1d.moves.candidates import Antithetic, Candidates, Independent, Rotated, Stratified
from mcmc1d.moves.exchange import CoordinateStep, Exchange, ReplicaStep
from mcmc1d.moves.mixture import Mixture
from mcmc1d.moves.multiple_try import MultipleTry
from mcmc1d.moves.perturbations import LinearStep, TruncatedStep, UniformStep
from mcmc1d.moves.primary import ExponentialStep, LargeStep, SmallStep
from mcmc1d.moves.returning import Returning
from mcmc1d.moves.reversible_jump import AimedJump, ReversibleJump
from mcmc1d.moves.scaled import ScaledStep
from mcmc1d.moves.technique import StepAndChange, TechniqueChange

__all__ = [
    "AimedJump",
    "Antithetic",
    "Candidates",
    "CoordinateStep",
    "Exchange",
    "ExponentialStep",
    "Independent",
    "LargeStep",
    "LinearStep",
    "Mixture",
    "Move",
    "MultipleTry",
    "Proposal",
    "ReplicaStep",
    "Returning",
    "ReversibleJump",
    "Rotated",
    "ScaledStep",
    "SmallStep",
    "StepAndChange",
    "Stratified",
    "TechniqueChange",
    "TruncatedStep",
    "UniformStep",
]
