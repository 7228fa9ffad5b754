"""Mistakes of a chain on paths: jumps without their Jacobian, clamped steps, an inverse that forgets a choice."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.integrators import MMLT, RJMLT
from mcmc1d.flatland.integrators.chains import Metropolised
from mcmc1d.flatland.mutants import Mutant, two_lamps
from mcmc1d.flatland.mutants.altered import Altered
from mcmc1d.flatland.paths import Paths
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.moves import LargeStep, Mixture, Move, Proposal, ReversibleJump, SmallStep, StepAndChange
from mcmc1d.numerics import below_one
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Index, Scalar


class TamperedJump(Move):
    """A reversible jump whose log-determinant is multiplied by a number: 0 leaves it out, -1 is its reciprocal."""

    right: ReversibleJump
    power: float

    def dim_w(self, target: Multiplexed) -> int:
        return self.right.dim_w(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Proposal:
        right = self.right.propose(target, state, w)
        return Proposal(right.state, right.w, self.power * right.log_det)


class ClampedStep(Move):
    """A small step that is clamped to the cube, and believed to be symmetric."""

    sigma: float

    def dim_w(self, target: Multiplexed) -> int:
        return target.dim_u

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " m"]) -> Proposal:
        u = below_one(jnp.clip(state.u + self.sigma * normal_quantile(w), 0, 1))
        return Proposal(State(state.index, u), 1 - w, jnp.zeros((), u.dtype))


class WrongKernel(Metropolised):
    """A right integrator whose chains are stepped by another kernel."""

    right: Metropolised
    other: Callable[[], Kernel] = eqx.field(static=True)
    chains: int = eqx.field(static=True, default=1024)
    spent_on_b: float = 1.0

    def target(self, paths: Paths) -> Multiplexed:
        return self.right.target(paths)

    def kernel(self) -> Kernel:
        return self.other()

    def limits(self, techniques: int) -> tuple[float, float]:
        return self.right.limits(techniques)

    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        return self.right.rays(target, paths, counts)


class ForgetfulLamps(Altered):
    """Techniques whose inverse takes the place on a lamp for the number that chose the lamp as well."""

    def inverse(self, index: Index, x: Float[Array, "..."], v: Float[Array, " k"]) -> tuple[Array, Scalar]:
        u, log_det = self.right.inverse(index, x, v)
        walls = self.right.paths.walls
        segment, along = walls.place(x[-1])
        read = jnp.asarray(self.right.lengths)[index] <= self.right.paths.edges
        place = below_one(along / walls.at(walls.length, segment))
        return u.at[-1].set(jnp.where(read, place, u[-1])), log_det


def _jumping(power: float) -> Callable[[], Kernel]:
    def kernel() -> Kernel:
        jump = TamperedJump(ReversibleJump(), power)
        return Metropolis(
            Mixture({"large": (0.1, StepAndChange(LargeStep())), "small": (0.4, SmallStep(0.05)), "jump": (0.5, jump)})
        )

    return kernel


def _clamped() -> Kernel:
    return Metropolis(Mixture({"large": (0.05, StepAndChange(LargeStep())), "small": (0.95, ClampedStep(0.5))}))


def _jump_mutant(power: float, mistake: str, origin: str) -> Mutant:
    # Few pixels are off by more than a tenth: what a deviation may be is bounded by the number of chains.
    right = RJMLT(jump=0.5, chains=2**16, spent_on_b=1.0)
    wrong = WrongKernel(right=right, other=_jumping(power), chains=right.chains)
    return Mutant(wrong, right, mistake, origin, samples=2**22)


MUTANTS = {
    "jump_jacobian_dropped": _jump_mutant(
        0.0, "jumps accepted without the Jacobian p_j / p_i", "Bitterli et al. 2017, figure 3, without the Jacobian"
    ),
    "jump_jacobian_reciprocal": _jump_mutant(
        -1.0, "jumps accepted with p_i / p_j", "Bitterli et al. 2017, eqs. 8 to 14, the other way round"
    ),
    "clamped_steps": Mutant(
        WrongKernel(right=MMLT(chains=1024), other=_clamped),
        MMLT(chains=1024, sigma=0.5, spent_on_b=1.0),
        "a step past the end of the cube stays at its end",
        "Segovia et al. 2007, section 6.1: a clamped perturbation is not symmetric",
    ),
    "inverse_forgets_the_lamp": Mutant(
        ForgetfulLamps(Bidirectional(Paths(two_lamps(), 2))),
        Bidirectional(Paths(two_lamps(), 2)),
        "the inverse of a point on a lamp ignores which lamp was chosen",
        "ours: the choice of a lamp is a number that must be inverted too",
        layer="contract",
        scene=two_lamps(),
    ),
}
