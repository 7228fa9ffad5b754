"""Sampling techniques as bijections u <-> (x, v); a family in each file, with its `EXAMPLES`."""

from mcmc1d.techniques.base import Inversion, Technique, checked_shape, density_within, dim_v, sample_shape, within
from mcmc1d.techniques.compose import Compose
from mcmc1d.techniques.disk import ConcentricDisk, PolarDisk, ProjectedCap
from mcmc1d.techniques.elementary import Ramp, Tent, Uniform
from mcmc1d.techniques.family import Family, Looked, Several
from mcmc1d.techniques.gaussian import BoxMuller
from mcmc1d.techniques.mixture import Mixture
from mcmc1d.techniques.piecewise import PiecewiseConstant, PiecewiseLinear, Tabulated
from mcmc1d.techniques.planar import Planar, Rectangle
from mcmc1d.techniques.planar_table import MarginalConditional
from mcmc1d.techniques.product import Product
from mcmc1d.techniques.sinusoid import RaisedSinusoid
from mcmc1d.techniques.triangle import Triangle
from mcmc1d.techniques.truncated_normal import TruncatedNormal

__all__ = [
    "BoxMuller",
    "Compose",
    "ConcentricDisk",
    "Family",
    "Inversion",
    "Looked",
    "MarginalConditional",
    "Mixture",
    "PiecewiseConstant",
    "PiecewiseLinear",
    "Planar",
    "PolarDisk",
    "Product",
    "ProjectedCap",
    "RaisedSinusoid",
    "Ramp",
    "Rectangle",
    "Several",
    "Tabulated",
    "Technique",
    "Tent",
    "Triangle",
    "TruncatedNormal",
    "Uniform",
    "checked_shape",
    "density_within",
    "dim_v",
    "sample_shape",
    "within",
]
