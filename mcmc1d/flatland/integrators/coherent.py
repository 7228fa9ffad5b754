"""Coherent Metropolis light transport: packets of candidates along sub-chains (Segovia, Iehl, Peroche 2007)."""

from typing import Literal

import equinox as eqx

from mcmc1d.checks import require
from mcmc1d.flatland.integrators.base import multiplexed
from mcmc1d.flatland.integrators.chains import Metropolised, require_chains
from mcmc1d.flatland.paths import Paths
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.moves import LargeStep, Mixture, MultipleTry, SmallStep, StepAndChange
from mcmc1d.packets import AuxiliaryCentre, PublishedDeposit
from mcmc1d.state import Multiplexed
from mcmc1d.subchain import SubChain
from mcmc1d.weights import Balance, Maximum, Power


class CoherentMLT(Metropolised):
    """Segovia et al. 2007, algorithm 1: from each state of a main chain a sub-chain of multiple-try, thrown away.

    The main chain is that of multiplexed MLT; a sub-chain keeps the technique and takes `length` steps, each with a
    packet of `tries` candidates around one point, for a renderer to trace together. What a packet deposits:

    - `"published"`, section 5.2: R_g on the candidates and 1 - R_g on the competitors, by their light. Biased for two
      candidates or more (`packets.PublishedDeposit`): every step of a sub-chain starts from the target's law, so the
      image is off by what one packet's deposit is, in expectation over that law;
    - `"centre"`: the exact repair, candidates and state around an auxiliary centre, none rejected
      (`packets.AuxiliaryCentre`), at half the rays;
    - `"chosen"`: a on the chosen candidate and 1 - a on the state, exact too; the packet's other members give nothing.

    `samples` are mutations of the main chain; each brings the rays of its sub-chain.
    """

    deposit: Literal["published", "centre", "chosen"] = eqx.field(static=True, default="centre")
    tries: int = eqx.field(static=True, default=4)
    length: int = eqx.field(static=True, default=8)
    sigma: float = 0.03
    """Of the sub-chain's candidates."""
    main_sigma: float = 0.05
    large: float = 0.3
    weights: Balance | Power | Maximum = Balance()
    chains: int = eqx.field(static=True, default=4096)
    spent_on_b: float = 1.0

    def __check_init__(self):
        require(
            self.deposit in ("published", "centre", "chosen"),
            f'CoherentMLT: deposit must be "published", "centre" or "chosen", not {self.deposit!r}',
        )
        require_chains(self)

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, None, self.weights)

    def kernel(self) -> Kernel:
        large, small = StepAndChange(LargeStep()), StepAndChange(SmallStep(self.main_sigma))
        main = Mixture({"large": (self.large, large), "small": (1 - self.large, small)})
        near = SmallStep(self.sigma)
        if self.deposit == "centre":
            inner: Kernel = AuxiliaryCentre(near, self.tries)
        elif self.deposit == "published":
            inner = PublishedDeposit(MultipleTry(near, self.tries))
        else:
            inner = Metropolis(MultipleTry(near, self.tries))
        return SubChain(main, inner, self.length)

    def limits(self, techniques: int) -> tuple[float, float]:
        return 1.0, float(techniques)

    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        packet = self.tries if self.deposit == "centre" else 2 * self.tries - 1
        inner = sum(count for kind, count in counts.items() if kind.startswith("inner "))
        outer = sum(counts.values()) - inner
        return paths.edges * (outer + packet * inner), float(paths.edges)


__all__ = ["CoherentMLT"]
