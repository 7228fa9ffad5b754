"""What a step costs as the problem grows: chains, steps, bins, techniques, candidates, edges of a path."""

import time
from statistics import median
from typing import Any, NamedTuple

import jax
import numpy as np

import mcmc1d
from experiments.support.sweep import Show
from mcmc1d.estimators import Estimator
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import MMLT
from mcmc1d.flatland.integrators.chains import EachChain
from mcmc1d.flatland.scenes import scene
from mcmc1d.metropolis import Kernel
from mcmc1d.moves import Move, MultipleTry, SmallStep, StepAndChange
from mcmc1d.moves.multiple_try import by_target
from mcmc1d.targets import Sinusoid
from mcmc1d.techniques import Tent

SIZES = {
    "chains": (64, 512, 4096, 32768),
    "steps": (64, 512, 4096),
    "bins": (10, 100, 1000, 10000),
    "techniques": (1, 2, 4, 8, 16),
    "candidates": (1, 2, 4, 8),
    "edges": (2, 3, 4, 6),
}
CHAINS, STEPS = 4096, 256


def measure(rounds: int, work: float, show: Show) -> dict[str, dict[int, float]]:
    """Quantity -> size -> nanoseconds a step of a chain: medians, the sizes of one quantity in alternation."""
    found: dict[str, dict[int, float]] = {}
    total = sum(len(sizes) for sizes in SIZES.values())
    done = 0
    for quantity, sizes in SIZES.items():
        times: dict[int, list[float]] = {size: [] for size in sizes}
        ready = {size: _case(quantity, size, work) for size in sizes}
        for seed in range(rounds):
            for size, case in ready.items():
                times[size].append(case.nanoseconds(seed))
        found[quantity] = {size: median(values) for size, values in times.items()}
        done += len(sizes)
        show("growth", done, total)
    return found


class Case(NamedTuple):
    """What is run."""

    target: mcmc1d.Multiplexed
    kernel: Move | Kernel
    estimator: Estimator
    chains: int
    steps: int

    def nanoseconds(self, seed: int) -> float:
        """Of processor time, a step of a chain."""
        chains, steps = self.chains, self.steps
        start = mcmc1d.exact_start(jax.random.key(0), self.target, chains)
        options: dict[str, Any] = {"steps": steps, "chains": chains, "blocks": 1, "start": start}
        begin = time.process_time()
        run = mcmc1d.run(jax.random.key(seed), self.kernel, self.target, **options, estimators={"sums": self.estimator})
        jax.block_until_ready(run.state)
        return (time.process_time() - begin) / (chains * steps) * 1e9


def _case(quantity: str, size: int, work: float) -> Case:
    """That of a size, compiled."""
    chains = size if quantity == "chains" else CHAINS
    # As much work at every number of chains, so that a short run's fixed cost does not show as theirs.
    steps = size if quantity == "steps" else max(8, int(STEPS * work * CHAINS / chains))
    if quantity == "edges":  # multiplexed Metropolis light transport in flatland, whose box has no light of one edge
        paths = Paths(scene("box"), size)
        case = Case(MMLT().target(paths), MMLT().kernel(), EachChain(paths, chains), chains, steps)
    else:
        techniques = size if quantity == "techniques" else 2
        target = mcmc1d.Multiplexed(Sinusoid(), [Tent(float(m)) for m in np.linspace(0.2, 0.8, techniques)])
        tried = MultipleTry(SmallStep(0.05), size, by_target) if quantity == "candidates" else None
        bins = size if quantity == "bins" else 100
        case = Case(target, tried or StepAndChange(SmallStep(0.05)), mcmc1d.Histogram(bins), chains, steps)
    case.nanoseconds(0)
    return case
