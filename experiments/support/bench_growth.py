"""What a step costs as the problem grows: chains, steps, bins, techniques, candidates."""

import time
from statistics import median

import jax
import numpy as np

import mcmc1d
from experiments.support.sweep import Show
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
            for size, (target, move, chains, steps, bins) in ready.items():
                times[size].append(_time(target, move, chains, steps, bins, seed))
        found[quantity] = {size: median(values) for size, values in times.items()}
        done += len(sizes)
        show("growth", done, total)
    return found


def _case(quantity: str, size: int, work: float) -> tuple[mcmc1d.Multiplexed, Move, int, int, int]:
    """Target, move, chains, steps and bins of a size, compiled."""
    techniques = size if quantity == "techniques" else 2
    target = mcmc1d.Multiplexed(Sinusoid(), [Tent(float(m)) for m in np.linspace(0.2, 0.8, techniques)])
    move: Move = StepAndChange(SmallStep(0.05))
    if quantity == "candidates":
        move = MultipleTry(SmallStep(0.05), size, by_target)
    chains = size if quantity == "chains" else CHAINS
    # As much work at every number of chains, so that a short run's fixed cost does not show as theirs.
    steps = size if quantity == "steps" else max(8, int(STEPS * work * CHAINS / chains))
    bins = size if quantity == "bins" else 100
    _time(target, move, chains, steps, bins, 0)
    return target, move, chains, steps, bins


def _time(target: mcmc1d.Multiplexed, move: Move, chains: int, steps: int, bins: int, seed: int) -> float:
    start = mcmc1d.exact_start(jax.random.key(0), target, chains)
    estimators = {"x": mcmc1d.Histogram(bins)}
    begin = time.process_time()
    run = mcmc1d.run(
        jax.random.key(seed), move, target, steps=steps, chains=chains, blocks=1, start=start, estimators=estimators
    )
    jax.block_until_ready(run.state)
    return (time.process_time() - begin) / (chains * steps) * 1e9
