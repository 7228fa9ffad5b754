"""Targets: unnormalised densities with their exact bin masses; a family in each file, with its `EXAMPLES`."""

from mcmc1d.targets.base import DensityOf, Edges, Target
from mcmc1d.targets.function import FromFunction
from mcmc1d.targets.gaussian_mixture import GaussianMixture
from mcmc1d.targets.planar import Banana, Checkerboard, Ring, RotatedMixture
from mcmc1d.targets.sinusoid import Sinusoid
from mcmc1d.targets.tables import PiecewiseLinear, Tabulated
from mcmc1d.targets.tempered import Sum, Tempered

__all__ = [
    "Banana",
    "Checkerboard",
    "DensityOf",
    "Edges",
    "FromFunction",
    "GaussianMixture",
    "PiecewiseLinear",
    "Ring",
    "RotatedMixture",
    "Sinusoid",
    "Sum",
    "Tabulated",
    "Target",
    "Tempered",
]
