"""Metropolis light transport in primary sample space: PSSMLT, MMLT and RJMLT, one chain for each path length."""

import abc
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.chain import run
from mcmc1d.checks import require, require_whole
from mcmc1d.estimators import Acceptance, Estimator
from mcmc1d.examples import Examples
from mcmc1d.flatland.integrators.base import Integrator, brightest, multiplexed
from mcmc1d.flatland.integrators.image import Layer
from mcmc1d.flatland.paths import EXAMPLES as LIT
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.sampling import Sums, bootstrap
from mcmc1d.flatland.scene import Scene
from mcmc1d.metropolis import Kernel, Metropolis, Step
from mcmc1d.moves import AimedJump, LargeStep, Mixture, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.numerics import cast
from mcmc1d.pooled import Pooled, PooledDeposit
from mcmc1d.state import Multiplexed
from mcmc1d.techniques.product import cube
from mcmc1d.types import Array, Float, Key
from mcmc1d.weights import Balance, Maximum, Power

_WRITTEN_OUT = 16
"""Up to so many deposits of a step are written out, which fuses; more, of long sub-chains, are a loop."""


class EachChain(Estimator):
    """The deposits of each chain of a block in each pixel, (pixels, chains): chains are independent, steps are not."""

    paths: Paths
    chains: int = eqx.field(static=True)
    """Of a block."""
    only: int | None = eqx.field(static=True, default=None)
    """Which of a step's deposits counts; all of them unless given."""

    def init(self, target: Multiplexed, kernel: Kernel, dtype: Any) -> Float[Array, "n c"]:
        return jnp.zeros((self.paths.sensor.pixels, self.chains), dtype)

    def update(self, sums: Float[Array, "n c"], steps: Step) -> Float[Array, "n c"]:
        deposits = steps.deposits
        paths = cast(self.paths, deposits.x.dtype)
        k = self.only
        if k is not None:
            deposits = jax.tree.map(lambda part: part[k : k + 1], deposits)
        lane = jnp.arange(self.chains)

        def one(sums: Float[Array, "n c"], deposit: tuple[Array, Array]) -> tuple[Float[Array, "n c"], None]:
            x, weight = deposit
            pixel = jax.vmap(paths.pixel, in_axes=-1)(x)
            return sums.at[pixel, lane].add(
                weight.astype(sums.dtype), mode="promise_in_bounds", unique_indices=True
            ), None

        few = deposits.weight.shape[0] <= _WRITTEN_OUT
        return jax.lax.scan(one, sums, (deposits.x, deposits.weight), unroll=few)[0]


class Metropolised(Integrator):
    """Chains on a target of their own, and b by independent samples of it."""

    chains: eqx.AbstractVar[int]
    """Independent chains, started exactly: a standard error is that of their means."""
    spent_on_b: eqx.AbstractVar[float]
    """Samples for b, as a share of the mutations."""

    @abc.abstractmethod
    def kernel(self) -> Kernel:
        """What steps the chains."""

    @abc.abstractmethod
    def limits(self, techniques: int) -> tuple[float, float]:
        """What a chain deposits in a step at most; and the largest sample for b, in units of `brightest`."""

    @abc.abstractmethod
    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        """Rays for all mutations, given how many there were of each kind, and for each sample of b."""

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer:
        b_key, key = jax.random.split(key)
        paths, kernel = Paths(scene, edges), self.kernel()
        target = self.target(paths)
        techniques = len(paths.eye_lengths)
        deposited, most = self.limits(techniques)
        b = bootstrap(b_key, target, int(self.spent_on_b * samples), most * brightest(scene, edges))
        pixels = float(paths.sensor.pixels)
        per_b = self.rays(target, paths, {})[1] * b.size
        if not b.total.any():
            nothing = np.zeros(paths.sensor.pixels)
            return Layer(edges, pixels, Sums(b.size, nothing, nothing, b.bound), None, per_b)
        steps = max(1, -(-samples // self.chains))
        blocks = next(n for n in (4, 2, 1) if self.chains % n == 0)
        estimators = {"film": EachChain(paths, self.chains // blocks), "kinds": Acceptance()}
        ran = run(key, kernel, target, steps=steps, chains=self.chains, blocks=blocks, estimators=estimators)
        each = np.moveaxis(ran.sums["film"], 1, 0).reshape(paths.sensor.pixels, -1) / steps
        film = Sums(self.chains, each.sum(1), (each**2).sum(1), deposited)
        counts = dict(zip(ran.kinds, ran.sums["kinds"][1].sum(0).tolist(), strict=True))
        return Layer(edges, pixels, film, b, self.rays(target, paths, counts)[0] + per_b)


def require_chains(integrator: Any) -> None:
    """Raise `ValueError` where a setting that all chains have in common is out of range."""
    name = type(integrator).__name__
    require_whole(integrator.chains, f"{name}: chains, for a standard error,", 2)
    require(integrator.spent_on_b > 0, f"{name}: spent_on_b must be positive, not {integrator.spent_on_b}")
    require(0 <= integrator.large <= 1, f"{name}: large is a probability, not {integrator.large}")


class PSSMLT(Metropolised):
    """Kelemen et al. 2002 with the techniques of BDPT: one u makes a path by each of them (Hachisuka 2014, Alg. 1).

    The chain's density is the sum, or the maximum, of their weighted contributions; all are deposited.
    """

    combine: Literal["sum", "maximum"] = eqx.field(static=True, default="sum")
    sigma: float = 0.05
    large: float = 0.1
    weights: Balance | Power | Maximum = Balance()
    chains: int = eqx.field(static=True, default=4096)
    spent_on_b: float = 0.25

    def __check_init__(self):
        require_chains(self)

    def target(self, paths: Paths) -> Multiplexed:
        together = Pooled(multiplexed(paths, None, self.weights), self.combine)
        return Multiplexed(together, cube(together.multiplexed.dim_u), probes=0)

    def kernel(self) -> Kernel:
        steps = {"large": (self.large, LargeStep()), "small": (1 - self.large, SmallStep(self.sigma))}
        return PooledDeposit(Mixture(steps))

    def limits(self, techniques: int) -> tuple[float, float]:
        return (1.0, float(techniques)) if self.combine == "sum" else (float(techniques), 1.0)

    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        # k of the walk from the sensor, k - 1 of that from the lamp, one more where it can hit the sensor, k joints.
        each = 3.0 * paths.edges - 1 + paths.sensor.places
        return each * sum(counts.values()), each


class MMLT(Metropolised):
    """Multiplexed MLT (Hachisuka et al. 2014): the technique is part of the state, and changes with a large step."""

    sigma: float = 0.05
    large: float = 0.1
    weights: Balance | Power | Maximum = Balance()
    chains: int = eqx.field(static=True, default=4096)
    spent_on_b: float = 0.25

    def __check_init__(self):
        require_chains(self)

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, None, self.weights)

    def kernel(self) -> Kernel:
        # A technique drawn afresh with every small step would throw the path away: in `door` 7 % are kept then, not 16.
        steps = {"large": (self.large, StepAndChange(LargeStep())), "small": (1 - self.large, SmallStep(self.sigma))}
        return Metropolis(Mixture(steps))

    def limits(self, techniques: int) -> tuple[float, float]:
        return 1.0, float(techniques)

    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        return paths.edges * sum(counts.values()), float(paths.edges)


class RJMLT(Metropolised):
    """Reversible jump MLT (Bitterli et al. 2017): 10 % large steps, 85 % small ones, 5 % jumps (section 7.2).

    A jump keeps the path and changes the technique: uniformly, or aimed, with the weights' probabilities.
    """

    aimed: bool = eqx.field(static=True, default=False)
    sigma: float = 0.05
    large: float = 0.1
    jump: float = 0.05
    weights: Balance | Power | Maximum = Balance()
    chains: int = eqx.field(static=True, default=4096)
    spent_on_b: float = 0.25

    def __check_init__(self):
        require_chains(self)
        require(
            0 <= self.jump <= 1 - self.large,
            f"RJMLT: the probabilities large = {self.large} and jump = {self.jump} must sum to 1 at most",
        )

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, None, self.weights)

    def kernel(self) -> Kernel:
        jump = AimedJump() if self.aimed else ReversibleJump()
        small = 1 - self.large - self.jump
        steps = {"large": (self.large, StepAndChange(LargeStep())), "small": (small, SmallStep(self.sigma))}
        # A path's inverse costs several times its making.
        return Metropolis(Mixture({**steps, "jump": (self.jump, jump)}, seldom=("jump",)))

    def limits(self, techniques: int) -> tuple[float, float]:
        return 1.0, float(techniques)

    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        walked = sum(count for kind, count in counts.items() if kind != "jump")
        return paths.edges * walked, float(paths.edges)


EXAMPLES = Examples(lambda: {"each_chain": EachChain(LIT["light"].paths, 64)})

__all__ = ["EXAMPLES", "MMLT", "PSSMLT", "RJMLT", "EachChain", "Metropolised", "require_chains"]
