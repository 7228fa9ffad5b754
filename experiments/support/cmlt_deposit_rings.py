"""The published deposit on small rings for `cmlt_deposit_bias`: which steps, weights and shares save it, enumerated."""

from typing import Any

import numpy as np
import xarray as xr

from experiments.support.framework import Claim
from experiments.support.ring_draw import RingDraw
from experiments.support.verdict import verdict
from mcmc1d.moves import Move, MultipleTry
from mcmc1d.moves.multiple_try import LogWeight, SymmetricLambda, by_importance, by_target, evenly
from mcmc1d.packets import PublishedDeposit
from mcmc1d.verify import RingStep, enumerate_kernel, ring

SOURCE = "Segovia et al. 2007"
F3, G3 = (1.0, 3.0, 2.0), (0.25, 0.5, 0.25)
"""A smaller ring, and an independent proposal that is not even."""
SHARES = ("target", "weights")
"""Inside a family: in proportion to f, as published, or to the weights w that select."""


def measure(f: tuple[float, ...]) -> dict[str, Any]:
    """The relative errors of each state, for a dataset: on the ring of f, and on a smaller one."""
    even = RingStep(len(f), {1: 0.5, -1: 0.5})
    independent, lambdas = by_lambda()
    drawn = [[_published(F3, independent, 2, weight, 4, inner) for weight in lambdas.values()] for inner in SHARES]
    return {
        "three": ("state", _published(f, even, 3, by_importance, 2)),
        "evenly": ("state", _published(f, even, 3, evenly, 2)),
        "independent": (("inner", "lambda", "state3"), np.array(drawn)),
        "lambda": list(lambdas),
        "inner": list(SHARES),
    }


def by_lambda() -> tuple[RingDraw, dict[str, LogWeight]]:
    """An independent step, and the weights of three lambdas: symmetric ones, and 1 / g(x), whose weight is f."""
    step = RingDraw(G3)
    over_both = SymmetricLambda(lambda x, y: -0.5 * (step.log_g(x) + step.log_g(y)))
    return step, {"1 / sqrt(g g)": by_importance, "1 / (g g)": over_both, "weights f": by_target}


def _published(
    f: tuple[float, ...], step: Move, tries: int, weight: LogWeight, outcomes: int, inner: Any = "target"
) -> np.ndarray:
    """The relative error of each state of a ring, whose step has so many equally likely outcomes of its number."""
    target, states = ring(f)
    one = PublishedDeposit(MultipleTry(step, tries, weight), inner)
    found = enumerate_kernel(one, target, states, [outcomes] * (2 * tries - 1) + [None, None], probes=65)
    return found.law @ found.deposits / (np.array(f) / sum(f)) - 1


def claims(data: xr.Dataset) -> list[Claim]:
    """More candidates do not save it; an even choice does, and shares by the weights with one lambda."""
    three, even = np.abs(data.three.to_numpy()), float(np.abs(data.evenly).max())
    off = np.abs(data.independent).max("state3")
    by_f, by_w = (dict(zip(data["lambda"].to_numpy(), off.sel(inner=i).to_numpy(), strict=True)) for i in SHARES)
    saved = [str(name) for name, one in by_w.items() if one < 1e-12]
    return [
        Claim(
            "cmlt.deposit-three",
            "With three candidates it is unbiased",
            f"{SOURCE}, sec. 5.2",
            verdict(three.max() < 1e-12),
            "fails",
            f"a state is off by {three.min():.1%} to {three.max():.1%}",
            "enumeration, p = 3, an even step; 1e-12",
        ),
        Claim(
            "cmlt.deposit-even",
            "With a symmetric step whose candidates are chosen evenly, not by f, it is unbiased",
            f"ours; {SOURCE}, sec. 5.2",
            verdict(even < 1e-12),
            "holds",
            f"a state is off by {even:.0e} at most",
            "enumeration, p = 3, an even step; 1e-12",
        ),
        Claim(
            "cmlt.deposit-independent",
            "With an independent proposal it is unbiased",
            f"ours; {SOURCE}, sec. 5.2",
            verdict(min(by_f.values()) < 1e-12),
            "fails",
            "a state is off by up to " + ", ".join(f"{one:.0%} (lambda {name})" for name, one in by_f.items()),
            "enumeration on three states, p = 2, g not even; 1e-12",
        ),
        Claim(
            "cmlt.deposit-weights",
            "With an independent proposal, and shares by the weights w in place of f, it is",
            f"ours; {SOURCE}, sec. 5.2",
            f"holds if lambda is {' or '.join(saved)}" if saved else "fails",
            "holds if lambda is 1 / (g g)",
            "a state is off by up to " + ", ".join(f"{one:.2g} ({name})" for name, one in by_w.items()),
            "enumeration on three states, p = 2, g not even; 1e-12",
        ),
    ]
