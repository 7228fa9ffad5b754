"""Targets: unnormalised densities with their exact bin masses; a family in each file, with its `EXAMPLES`."""

from mcmc1d.targets.base import DensityOf, Target
from mcmc1d.targets.function import FromFunction
from mcmc1d.targets.gaussian_mixture import GaussianMixture
from mcmc1d.targets.sinusoid import Sinusoid
from mcmc1d.targets.tables import PiecewiseLinear, Tabulated

__all__ = ["DensityOf", "FromFunction", "GaussianMixture", "PiecewiseLinear", "Sinusoid", "Tabulated", "Target"]
