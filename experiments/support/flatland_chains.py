"""Chains on flatland's paths as the papers' figures need them: mixes of moves in one program, a film for each chain."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from experiments.support.long import long_run
from mcmc1d.estimators import Estimator
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators.chains import EachChain
from mcmc1d.metropolis import Kernel, Metropolis, Step
from mcmc1d.moves import AimedJump, LargeStep, Mixture, ReversibleJump, SmallStep, StepAndChange, TechniqueChange
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float

MOVES = ("large", "keep", "change", "jump", "uniform jump")
"""A large step; a small step that keeps the technique; one that changes it; jumps to a technique as the weights have it
(Bitterli et al. 2017, section 4), and to each alike (ours: another T(i, j) in their eq. 14).
"""
METHODS = ("MMLT", "MMLT, any technique", "RJMLT", "RJMLT, uniform jumps")


def close(n: int, sigma: float) -> np.ndarray:
    """How often a small step takes floor(n v) from i to j, of shape (n, n): around the ends, v uniform in interval i.

    Published MMLT keeps v in its state; which technique is proposed from which is as often the same. Symmetric.
    """

    def above(z: np.ndarray) -> np.ndarray:
        """The integral of the normal distribution function up to z."""
        return z * ndtr(z / sigma) + sigma * np.exp(-0.5 * (z / sigma) ** 2) / np.sqrt(2 * np.pi)

    wraps = int(np.ceil(8 * sigma)) + 1
    away = np.arange(-wraps * n, (wraps + 1) * n)  # by how many intervals, unwrapped
    # Far away the differences leave nothing but rounding, of either sign.
    chances = np.maximum(n * (above((away + 1) / n) - 2 * above(away / n) + above((away - 1) / n)), 0)
    row = chances.reshape(-1, n).sum(0)
    row = (row + np.roll(row[::-1], 1)) / 2
    return row[(np.arange(n) - np.arange(n)[:, None]) % n] / row.sum()


def mixes(n: int, sigma: float, large: float, jump: float) -> dict[str, tuple[dict[str, float], np.ndarray]]:
    """Each method's probabilities of `MOVES`, and the matrix of its changes of technique.

    A small step of MMLT proposes a technique that is near in the order of t ("any technique": each alike); one of RJMLT
    keeps it (Bitterli et al. 2017, section 7.2). RJMLT jumps by the weights, as the paper has it; "uniform jumps" are
    ours.
    """
    mixed = {}
    for name, matrix in ((METHODS[0], close(n, sigma)), (METHODS[1], np.full((n, n), 1 / n))):
        kept = float(matrix[0, 0])
        mixed[name] = {"large": large, "keep": (1 - large) * kept, "change": (1 - large) * (1 - kept)}, others(matrix)
    small = {"large": large, "keep": 1 - large - jump}
    mixed[METHODS[2]] = {**small, "jump": jump}, others(close(n, sigma))
    mixed[METHODS[3]] = {**small, "uniform jump": jump}, others(close(n, sigma))
    return mixed


def others(matrix: np.ndarray) -> np.ndarray:
    """The same matrix given that the technique changes."""
    away = matrix * (1 - np.eye(len(matrix)))
    return away / away[0].sum()


def multiplexed_kernel(sigma: float, large: float, matrix: np.ndarray) -> Kernel:
    """MMLT alone: large steps to any technique, and small ones with a change by `matrix`."""
    small = StepAndChange(SmallStep(sigma), TechniqueChange(matrix))
    return Metropolis(Mixture({"large": (large, StepAndChange(LargeStep())), "small": (1 - large, small)}))


def mixed_kernel(sigma: float, mix: Mapping[str, float], matrix: np.ndarray) -> Kernel:
    """All of `MOVES`, with the probabilities of `mix` or none: one compiled program serves every method.

    `matrix`: of "change", without a diagonal.
    """
    small = SmallStep(sigma)
    moves = (
        StepAndChange(LargeStep()),
        small,
        StepAndChange(small, TechniqueChange(matrix)),
        AimedJump(),
        ReversibleJump(),
    )
    mixed = {name: (mix.get(name, 0.0), move) for name, move in zip(MOVES, moves, strict=True)}
    return Metropolis(Mixture(mixed, seldom=("jump", "uniform jump")))


def _pixels(paths: Paths, steps: Step) -> Array:
    """The pixel of each deposit of each chain, by one program however many there are."""
    return jax.vmap(jax.vmap(paths.pixel, in_axes=-1))(steps.deposits.x)


class Usage(Estimator):
    """The deposits' weight by technique: of each chain, (techniques, chains), and by pixel, (techniques, pixels)."""

    paths: Paths
    chains: int = eqx.field(static=True)
    techniques: int = eqx.field(static=True)

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> tuple[Array, Array]:
        shape = self.techniques, self.paths.sensor.pixels
        return jnp.zeros((self.techniques, self.chains), dtype), jnp.zeros(shape, dtype)

    def update(self, sums: tuple[Array, Array], steps: Step) -> tuple[Array, Array]:
        each, film = sums
        deposits, row = steps.deposits, jnp.arange(self.techniques)[:, None]
        for index, weight in zip(deposits.index, deposits.weight, strict=True):
            each = each + jnp.where(index[None] == row, weight[None], 0)
        where = deposits.index, _pixels(self.paths, steps)
        return each, film.at[where].add(deposits.weight, mode="promise_in_bounds")


class Placed(Estimator):
    """PSSMLT's samples by technique and pixel, (techniques, pixels), lit or not: each of the current u counts as one.

    What lies beside the film is left out.
    """

    paths: Paths
    techniques: int = eqx.field(static=True)

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, "n pixels"]:
        return jnp.zeros((self.techniques, self.paths.sensor.pixels), dtype)

    def update(self, sums: Float[Array, "n pixels"], steps: Step) -> Float[Array, "n pixels"]:
        deposits, accepted = steps.deposits, steps.info.acceptance[0]
        film = jax.vmap(jax.vmap(self.paths.film, in_axes=-1))(deposits.x)
        current = jnp.arange(len(film))[:, None] < self.techniques
        weight = jnp.where(film > 0, jnp.where(current, 1 - accepted, accepted), 0)  # 0 is what is not seen
        return sums.at[deposits.index, _pixels(self.paths, steps)].add(weight, mode="promise_in_bounds")


class Lit(Estimator):
    """Of each chain, the share of the samples made for proposals that bring light: sums of shape (chains,).

    A proposal's deposits have a weight where there is light, and only there; PSSMLT's proposal has several samples.
    """

    chains: int = eqx.field(static=True)

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, " chains"]:
        return jnp.zeros(self.chains, dtype)

    def update(self, sums: Float[Array, " chains"], steps: Step) -> Float[Array, " chains"]:
        weight = steps.deposits.weight
        return sums + (weight[weight.shape[0] // 2 :] > 0).mean(0, dtype=sums.dtype)


_WORTH_SAVING = 2**22
"""Mutations: fewer take some seconds (MMLT) to ten (MLT), and to describe their program one or several."""


class Films(NamedTuple):
    """What independent chains deposited, each on a film of its own."""

    films: np.ndarray
    """Mean deposit of a step after each checkpoint's steps, (checkpoints, chains, pixels)."""
    sums: dict[str, Any]
    """Of the other estimators, over all steps, without the axis of blocks."""


def films(
    name: str,
    key: jax.Array,
    kernel: Kernel,
    target: Multiplexed,
    paths: Paths,
    chains: int,
    checkpoints: Sequence[int],
    estimators: Mapping[str, Estimator],
    start: State | None = None,
) -> Films:
    """Run chains from `start`, or exact starts; `checkpoints`: rising numbers of steps, to look at films after.

    `name`: as that of a `long_run`.
    """
    asked = {"film": EachChain(paths, chains), **estimators}
    total, others, seen, done = 0, {}, [], 0
    for k, steps in enumerate(checkpoints):
        ran = long_run(
            f"{name}, to {steps}",
            jax.random.fold_in(key, k),
            kernel,
            target,
            steps=steps - done,
            chains=chains,
            blocks=1,
            estimators=asked,
            start=start,
            saved=(steps - done) * chains >= _WORTH_SAVING,
        )
        start, done = ran.state, steps
        total = total + ran.sums["film"][0].T
        seen.append(total / steps)
        new = {name: jax.tree.map(lambda s: s[0], ran.sums[name]) for name in estimators}
        others = new if k == 0 else jax.tree.map(np.add, others, new)
    return Films(np.stack(seen), others)


__all__ = [
    "METHODS",
    "MOVES",
    "Films",
    "Lit",
    "Placed",
    "Usage",
    "close",
    "films",
    "mixed_kernel",
    "mixes",
    "multiplexed_kernel",
    "others",
]
