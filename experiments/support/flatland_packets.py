"""Packets of jittered candidates around a place on the film, as Segovia et al. 2007 make them, in the plane."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require_positive
from mcmc1d.flatland import Paths
from mcmc1d.flatland.bidirectional import Bidirectional
from mcmc1d.flatland.paths import Light
from mcmc1d.metropolis import Kernel, Metropolis, Step
from mcmc1d.moves import LargeStep, Mixture, Move, MultipleTry, Proposal, SmallStep, Stratified
from mcmc1d.moves.base import around_the_ends
from mcmc1d.moves.multiple_try import around, row
from mcmc1d.numerics import below_one, parameter, stratum
from mcmc1d.packets import AuxiliaryCentre, PublishedDeposit
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar

Deposit = Literal["centre", "published", "chosen"]
LENS = 2
"""t of the one technique: the eye walks to the first wall, which is joined to the end of the light's walk."""


class OnFilm(Move):
    """A Gaussian step of a path's place on the film, around the film's ends; `sigma` is a share of the film.

    By the technique `LENS` in a scene without mirrors this is the perturbation of the lens sub-path EDD (section 6.1):
    all vertices from the second wall on stay.
    """

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)

    def dim_w(self, target: Multiplexed) -> int:
        return 1

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 1"]) -> Proposal:
        step = jnp.zeros_like(state.u).at[0].set(self.sigma * normal_quantile(w[0]))
        return around_the_ends(state, step, 1 - w)


class JitteredCentre(Kernel):
    """An auxiliary centre with candidates in strata of the step's first number.

    Of p + 1 strata around the centre the current state stands in one; each of the p candidates has another to itself,
    so that all p + 1 are exchangeable, as the deposit needs.
    """

    right: AuxiliaryCentre

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.right.kinds

    def dim_w(self, target: Multiplexed) -> int:
        return self.right.dim_w(target)

    def check(self, target: Multiplexed) -> None:
        self.right.check(target)

    def step(self, target: Multiplexed, state: State, w: Float[Array, " r"]) -> Step:
        p, r = self.right.tries, self.right.step_by.dim_w(target)
        rows = w[:-1].reshape(p + 1, r)
        back = row(around(self.right.step_by, target, state, rows[:1]), jnp.zeros((), jnp.int32)).w[0]
        free = jnp.arange(p)
        free = free + (free >= stratum(back, p + 1))
        rows = rows.at[1:, 0].set(below_one((rows[1:, 0] + free) / (p + 1)))
        return self.right.step(target, state, jnp.concatenate([rows.ravel(), w[-1:]]))


def lens_target(paths: Paths) -> Multiplexed:
    """The light of paths as the technique `LENS` alone makes them."""
    return Multiplexed(Light(paths), Bidirectional(paths, (LENS,)), probes=0)


def main_chain(sigma: float, large: float) -> Mixture:
    """Steps that change all of a path's numbers: between these the packets stand."""
    return Mixture({"large": (large, LargeStep()), "small": (1 - large, SmallStep(sigma))})


def packets(deposit: Deposit, tries: int, sigma: float) -> Kernel:
    """A step of a sub-chain by jittered candidates on the film; what it deposits is as in `integrators.CoherentMLT`."""
    if deposit == "centre":
        return JitteredCentre(AuxiliaryCentre(OnFilm(sigma), tries))
    several = MultipleTry(OnFilm(sigma), tries, candidates=Stratified())
    return PublishedDeposit(several) if deposit == "published" else Metropolis(several)


def traced(deposit: Deposit, tries: int) -> int:
    """Paths of a packet, competitors or the centre included."""
    return tries + 1 if deposit == "centre" else 2 * tries - 1


__all__ = ["LENS", "Deposit", "JitteredCentre", "OnFilm", "lens_target", "main_chain", "packets", "traced"]
