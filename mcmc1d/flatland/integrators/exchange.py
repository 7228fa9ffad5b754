"""Replica exchange light transport: a chain for each class of paths, which swap their numbers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.chain import run
from mcmc1d.checks import require
from mcmc1d.estimators import Acceptance
from mcmc1d.flatland.integrators.base import Integrator, brightest, multiplexed
from mcmc1d.flatland.integrators.chains import EachChain, require_chains
from mcmc1d.flatland.integrators.image import Layer, Stacked
from mcmc1d.flatland.paths import Paths
from mcmc1d.flatland.sampling import Sums, bootstrap
from mcmc1d.flatland.scene import Scene
from mcmc1d.moves import LargeStep, Mixture, Move, SmallStep
from mcmc1d.moves.exchange import Exchange, ReplicaStep
from mcmc1d.replicated import ReplicaDeposit, replicated
from mcmc1d.starts import exact_start
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Key


class ReplicaExchange(Integrator):
    """Kitaoka, Kitamura, Kishino 2009, "Replica exchange light transport", with the techniques of BDPT as classes.

    An ensemble has a replica for each technique, which samples w_i f / p_i, the part of the light that the balance
    heuristic leaves to it; neighbours swap their u. A class whose light was zero at all samples for its c_i has none:
    those samples stand for it.
    Each class is a layer of its own; their errors are added up as if they were independent, which within an ensemble,
    where replicas swap, they are not quite (the intervals of `compare` do not rest on that).
    """

    sigma: float = 0.05
    large: float = 0.1
    swap: float = 0.1
    """Probability of an exchange."""
    chains: int = eqx.field(static=True, default=2048)
    """Independent ensembles."""
    spent_on_b: float = 0.25

    def __check_init__(self):
        require_chains(self)
        require(
            0 <= self.swap <= 1 - self.large,
            f"ReplicaExchange: the probabilities large = {self.large} and swap = {self.swap} must sum to 1 at most",
        )

    def target(self, paths: Paths) -> Multiplexed:
        return replicated(multiplexed(paths, None, None))

    def render(self, key: Key, scene: Scene, edges: int, samples: int) -> Layer | Stacked:
        b_key, start_key, key = jax.random.split(key, 3)
        paths = Paths(scene, edges)
        each, pixels = multiplexed(paths, None, None), scene.sensor.pixels
        n, bound = each.n_techniques, brightest(scene, edges)
        spent = int(self.spent_on_b * samples / n)
        sums = [bootstrap(jax.random.fold_in(b_key, i), each, spent, bound, only=i) for i in range(n)]
        lit = tuple(i for i in range(n) if sums[i].total.any())
        for_b = float(edges) * sum(part.size for part in sums)
        nothing = np.zeros(pixels)
        dark = [Layer(edges, float(pixels), Sums(sums[i].size, nothing, nothing, bound), None, 0.0) for i in range(n)]
        if not lit:
            return Stacked(tuple(layer._replace(rays=for_b / n) for layer in dark))
        u = [exact_start(jax.random.fold_in(start_key, i), each, self.chains, index=i).u for i in lit]
        start = State(jnp.zeros(self.chains, jnp.int32), jnp.concatenate(u, axis=1))
        steps = max(1, -(-samples // self.chains))
        blocks = next(n for n in (4, 2, 1) if self.chains % n == 0)
        films = {f"film {k}": EachChain(paths, self.chains // blocks, k) for k in range(len(lit))}
        options = {"steps": steps, "chains": self.chains, "blocks": blocks, "start": start}
        estimators = films | {"kinds": Acceptance()}
        ran = run(key, self._kernel(each, len(lit)), replicated(each, lit), **options, estimators=estimators)
        counts = dict(zip(ran.kinds, ran.sums["kinds"][1].sum(0).tolist(), strict=True))
        walked = edges * (sum(counts.values()) + counts.get("swap", 0.0))  # a swap makes two paths
        layers = [dark[i] for i in range(n) if i not in lit]
        for k, i in enumerate(lit):
            mean = np.moveaxis(ran.sums[f"film {k}"], 1, 0).reshape(pixels, -1) / steps
            film = Sums(self.chains, mean.sum(1), (mean**2).sum(1), 1.0)
            layers.append(Layer(edges, float(pixels), film, sums[i], (walked + for_b) / len(lit)))
        return Stacked(tuple(layers))

    def _kernel(self, each: Multiplexed, replicas: int) -> ReplicaDeposit:
        m, small = each.dim_u, 1 - self.large - self.swap
        moves: dict[str, tuple[float, Move]] = {
            "large": (self.large, ReplicaStep(LargeStep(), m)),
            "small": (small + (self.swap if replicas == 1 else 0), ReplicaStep(SmallStep(self.sigma), m)),
        }
        if replicas > 1:
            moves["swap"] = (self.swap, Exchange(m))
        return ReplicaDeposit(Mixture(moves), np.ones(replicas))


__all__ = ["ReplicaExchange"]
