"""Metropolis light transport in path space, as Veach and Guibas 1997 have it: one chain for each length."""

import math

import equinox as eqx

from mcmc1d.checks import require, require_whole
from mcmc1d.flatland.integrators.base import multiplexed
from mcmc1d.flatland.integrators.chains import Metropolised
from mcmc1d.flatland.mutations import veach
from mcmc1d.flatland.mutations.base import layout
from mcmc1d.flatland.mutations.bidirectional import deletions
from mcmc1d.flatland.paths import Paths
from mcmc1d.metropolis import Kernel, Metropolis
from mcmc1d.state import Multiplexed
from mcmc1d.weights import Balance, Maximum, Power


class MLT(Metropolised):
    """The bidirectional mutation, and the lens, caustic and multi-chain perturbations, with fixed probabilities.

    A mutation that does not apply to the path is a rejection. Rays: of the bidirectional mutation the edges that are
    not kept, on average; of a perturbation the edge that is traced and the one that joins. Where the scene has mirrors
    a perturbation follows them, and is counted as a whole path, which it never exceeds.
    """

    bidirectional: float = 0.4
    lens: float = 0.25
    caustic: float = 0.2
    multi_chain: float = 0.15
    weights: Balance | Power | Maximum = Balance()
    chains: int = eqx.field(static=True, default=4096)
    spent_on_b: float = 0.25

    def __check_init__(self):
        require_whole(self.chains, "MLT: chains, for a standard error,", 2)
        require(self.spent_on_b > 0, f"MLT: spent_on_b must be positive, not {self.spent_on_b}")
        require(self.bidirectional > 0, "MLT: without bidirectional mutations no chain gets everywhere; give some")
        shares = self.bidirectional, self.lens, self.caustic, self.multi_chain
        require(
            min(shares) >= 0 and math.isclose(sum(shares), 1, abs_tol=1e-6),
            f"MLT: the shares of its mutations must not be negative and sum to 1, not {shares}",
        )

    def target(self, paths: Paths) -> Multiplexed:
        return multiplexed(paths, None, self.weights)

    def kernel(self) -> Kernel:
        return Metropolis(veach(self.bidirectional, self.lens, self.caustic, self.multi_chain))

    def limits(self, techniques: int) -> tuple[float, float]:
        return 1.0, float(techniques)

    def rays(self, target: Multiplexed, paths: Paths, counts: dict[str, float]) -> tuple[float, float]:
        k, first = paths.edges, paths.eye_lengths[0]
        kept = [max(a - 1, 0) + max(b - 1, 0) for a, b in deletions(layout(target))]
        each = {"bidirectional": k - sum(kept) / len(kept)}
        if paths.walls.mirrors:
            each |= dict.fromkeys(("lens", "caustic", "multi_chain"), float(k))
        else:  # a caustic that is hit is not joined, and a lamp that is seen directly throws none on a pinhole
            each |= dict.fromkeys(("lens", "multi_chain"), float(min(k, 2)))
            each["caustic"] = float(1 + first) if k > first else 0.0
        return sum(each[kind] * count for kind, count in counts.items()), float(k)


__all__ = ["MLT"]
