"""Mutations of paths as involutions: Veach's bidirectional mutation and perturbations, and the manifold step."""

from mcmc1d.examples import Examples
from mcmc1d.flatland.mutations.base import Mutation, Mutations
from mcmc1d.flatland.mutations.bidirectional import BidirectionalMutation
from mcmc1d.flatland.mutations.manifold import ManifoldStep
from mcmc1d.flatland.mutations.perturbations import CausticPerturbation, LensPerturbation, MultiChainPerturbation


def veach(bidirectional: float = 0.4, lens: float = 0.25, caustic: float = 0.2, multi_chain: float = 0.15) -> Mutations:
    """All of Veach's, with these probabilities, which sum to one."""
    return Mutations(
        {
            "bidirectional": (bidirectional, BidirectionalMutation()),
            "lens": (lens, LensPerturbation()),
            "caustic": (caustic, CausticPerturbation()),
            "multi_chain": (multi_chain, MultiChainPerturbation()),
        }
    )


VEACH = veach()
"""As `integrators.MLT` mixes them."""

EXAMPLES = Examples(lambda: {"veach": VEACH})

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
    "veach",
]
