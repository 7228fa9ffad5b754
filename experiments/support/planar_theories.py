"""The theories' kernels on a planar target, each put to `verify`, a wrong one beside them."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from experiments.support.framework import Claim
from experiments.support.verdict import detects, passes, verdict
from mcmc1d import tempering
from mcmc1d.importance import Product, Regions
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import LargeStep, Mixture, Move, MultipleTry, SmallStep, StepAndChange
from mcmc1d.moves.exchange import Exchange, ReplicaStep
from mcmc1d.packets import AuxiliaryCentre, PublishedDeposit
from mcmc1d.pooled import PooledDeposit, pooled
from mcmc1d.state import Multiplexed
from mcmc1d.subchain import SubChain
from mcmc1d.targets.planar import two_ridges
from mcmc1d.techniques import ConcentricDisk, Rectangle
from mcmc1d.verify import verify

CANDIDATES = 8
RARE = np.array([[1.0, 4.0], [0.5, 2.0]])
"""What an importance function makes of four regions."""


class Theory(NamedTuple):
    """A kernel, of which is said that its states, or what it deposits, have its target's law."""

    statement: str
    source: str
    kernel: Move | Kernel
    target: Multiplexed
    expected: str = "holds"
    convicts: str = ""
    """Which layer of `verify` must fail where the theory is wrong."""


def theories() -> dict[str, Theory]:
    """By name; f is two crossing ridges and a peak on the square, sampled by a rectangle and by a disk around it."""
    f, small, disk = two_ridges(), SmallStep(0.1), ConcentricDisk((0.5, 0.5), 0.71)
    both, one = Multiplexed(f, (Rectangle(), disk)), Multiplexed(f, disk)
    swap = Mixture({"step": (0.7, ReplicaStep(SmallStep(0.2), 2)), "swap": (0.3, Exchange(2))})
    segovia, hachisuka = "Segovia et al. 2007", "Hachisuka et al. 2014"
    return {
        "ladder": Theory(
            "Serial tempering keeps the joint law of (rung, x)",
            "Marinari, Parisi 1992",
            StepAndChange(small),
            tempering.ladder(f, (1.0, 0.3), Rectangle()),
        ),
        "replica-exchange": Theory(
            "Replica exchange keeps the product law",
            "Geyer 1991; Swendsen, Wang 1986",
            swap,
            tempering.replicas(f, (1.0, 0.3), Rectangle()),
        ),
        "pssmlt": Theory(
            "PSSMLT's deposits by all techniques, over the sum of their contributions, have the law of f",
            f"{hachisuka}, Alg. 1",
            PooledDeposit(small),
            pooled(both, "sum"),
        ),
        "auxiliary-centre": Theory(
            "Depositing all candidates around an auxiliary centre is unbiased",
            "Tjelmeland 2004; Calderhead 2014",
            AuxiliaryCentre(SmallStep(0.2), CANDIDATES),
            one,
        ),
        "published-deposit": Theory(
            "Depositing all candidates with R_g, all competitors with 1 - R_g, is unbiased",
            f"{segovia}, sec. 5.2",
            PublishedDeposit(MultipleTry(SmallStep(0.2), CANDIDATES)),
            one,
            "fails",
            "deposits",
        ),
        "sub-chain": Theory(
            "Deposits along sub-chains that start at the main chain's states are unbiased",
            f"{segovia}, alg. 1",
            SubChain(LargeStep(), small, CANDIDATES),
            one,
        ),
        "importance": Theory(
            "A chain samples f times a table of regions",
            "ours; Hoberock and Hart 2010, sec. 4.2",
            StepAndChange(small),
            Multiplexed(Product((f, Regions(RARE, 2))), (Rectangle(), disk)),
        ),
    }


def put_to_verify(name: str, replicas: int, seed: int) -> dict[str, str | float]:
    """What `verify` says of one of them."""
    theory = theories()[name]
    report = verify(theory.kernel, theory.target, replicas=replicas, seed=seed, name=name)
    return {
        "theory_verdict": report.verdict.value,
        "theory_reason": "".join(f": {reason}" for reason in report.reasons[:1]),
        "theory_layers": ", ".join(sorted({failure.layer for failure in report.failures})),
        "theory_p": report.p_value,
        "theory_gap": report.gap,
    }


def _found(here: xr.Dataset, convicts: str) -> str:
    """What is said of a theory; a failure of another layer than the one in question says nothing of it."""
    passed = passes([here.theory_verdict.item()])
    beside = passed is False and bool(convicts) and convicts not in here.theory_layers.item()
    return verdict(None if beside else passed)


def claims(data: xr.Dataset) -> list[Claim]:
    """A row for each."""
    return [
        Claim(
            f"planar.{name}",
            f"{theory.statement}, in the plane",
            theory.source,
            _found(here, theory.convicts),
            theory.expected,
            f"verify {here.theory_verdict.item()}, p {float(here.theory_p):.2g}{here.theory_reason.item()}",
            detects(here.theory_gap),
        )
        for name, theory in theories().items()
        for here in [data.sel(theory=name)]
    ]
