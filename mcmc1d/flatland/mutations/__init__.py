"""Mutations of paths as involutions: Veach's bidirectional mutation and perturbations, and the manifold step."""

from mcmc1d.flatland.mutations.base import Mutation, Mutations
from mcmc1d.flatland.mutations.bidirectional import BidirectionalMutation
from mcmc1d.flatland.mutations.manifold import ManifoldStep
from mcmc1d.flatland.mutations.perturbations import CausticPerturbation, LensPerturbation, MultiChainPerturbation

VEACH = Mutations(
    {
        "bidirectional": (0.4, BidirectionalMutation()),
        "lens": (0.25, LensPerturbation()),
        "caustic": (0.2, CausticPerturbation()),
        "multi_chain": (0.15, MultiChainPerturbation()),
    }
)
"""All of Veach's, as `integrators.MLT` mixes them."""

EXAMPLES = {"veach": VEACH}

__all__ = [
    "EXAMPLES",
    "VEACH",
    "BidirectionalMutation",
    "CausticPerturbation",
    "LensPerturbation",
    "ManifoldStep",
    "MultiChainPerturbation",
    "Mutation",
    "Mutations",
]
