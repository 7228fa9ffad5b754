"""What `mmlt_marginals` integrates, and its integrals over primary space: what multiplies, by quadrature."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import xarray as xr

from experiments.support.framework import Claim
from experiments.support.verdict import verdict
from mcmc1d.pooled import Floored, Pooled, integral
from mcmc1d.state import Multiplexed
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import PiecewiseConstant, RaisedSinusoid, Ramp, Tent, Uniform
from mcmc1d.weights import FromFunction

SOURCE = "Hachisuka et al. 2014"
F = Sinusoid(0.9, 1.5, 0.1, 2.0)
"""b = 2.1, so that a normalised target can not hide a factor."""
TECHNIQUES = (Tent(0.4), Ramp(1.2), PiecewiseConstant([0, 0.6, 1], [1, 0]))
NAMES = ("tent", "ramp", "left part")
COVERING = (Ramp(1.2), RaisedSinusoid(0.6), Ramp(-0.5))
"""Techniques that reach all of f by themselves, with a bounded contribution."""


def measure(target: Multiplexed) -> dict[str, Any]:
    """The integrals by each technique over primary space and over x, and the mean of C of four techniques."""
    # A fourth one never contributes, as when no path can hit a pinhole.
    weights = FromFunction(lambda x, p: jnp.concatenate([p[:3], jnp.zeros(1)]) / p[:3].sum())
    four = Multiplexed(F, (*TECHNIQUES, Uniform()), weights)
    ends = np.linspace(0, 1, 2)
    return {
        "primary": ("covering", [integral(Pooled(Multiplexed(F, technique))) for technique in COVERING]),
        "by_technique": ("technique", _primary(target)),
        "by_path": ("technique", target.joint_masses(ends).sum(1) * float(integral(F))),
        "factor": float(_primary(four).mean()),
    }


def _primary(target: Multiplexed) -> np.ndarray:
    """The integral of C_i(u) over the unit interval, for each technique."""
    n = target.n_techniques
    return n * Floored(target).bin_masses((np.linspace(0, 1, n + 1), np.linspace(0, 1, 2))).sum(1)


def claims(data: xr.Dataset) -> list[Claim]:
    """The integrals are those over paths; the number of all techniques is the factor, not of those that contribute."""
    b = float(data.b)
    off = max(float(np.abs(data.primary / b - 1).max()), float(np.abs(data.by_technique - data.by_path).max()) / b)
    right, feasible, dropped = (float(data.factor) * n / b - 1 for n in (4, 3, 1))
    return [
        Claim(
            "mmlt.primary-integral",
            "Each technique's integral over primary space is its integral over paths, with and without MIS weights",
            f"{SOURCE}, eqs. 9, 10, 16",
            verdict(off < 1e-9),
            "holds",
            f"off by {off:.1e} of b at most, six integrals",
            "quadrature, 1e-9",
        ),
        Claim(
            "mmlt.factor",
            "The number of techniques, infeasible ones included, is the constant that multiplies",
            f"{SOURCE}, sec. 4",
            verdict(abs(right) < 1e-9),
            "holds",
            f"4 times the mean of C is b to {abs(right):.0e}; without the factor {dropped:+.0%}",
            "quadrature, 1e-9",
        ),
        Claim(
            "mmlt.factor-feasible",
            "Counting the techniques that contribute is enough",
            f"ours; {SOURCE}, sec. 4",
            verdict(abs(feasible) < 1e-9),
            "fails",
            f"3 of 4 contribute: {feasible:+.0%}",
            "quadrature, 1e-9",
        ),
    ]
