"""Exact images of flatland, of each path length and of all, by quadrature; and the closed forms that check them."""

from mcmc1d.flatland.reference.closed import (
    crossed_strings,
    emitter_irradiance,
    furnace,
    irradiance_between,
    visible_intervals,
)
from mcmc1d.flatland.reference.exact import GLOSSY, LARGE, SMALL, Reference, converged, image
from mcmc1d.flatland.reference.mesh import Resolution

__all__ = [
    "GLOSSY",
    "LARGE",
    "SMALL",
    "Reference",
    "Resolution",
    "converged",
    "crossed_strings",
    "emitter_irradiance",
    "furnace",
    "image",
    "irradiance_between",
    "visible_intervals",
]
