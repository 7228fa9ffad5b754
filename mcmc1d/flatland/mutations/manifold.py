"""The manifold step: a vertex moves along its wall, and the mirrors between it and its neighbours follow."""

import equinox as eqx
import jax.numpy as jnp

from mcmc1d.checks import require_positive
from mcmc1d.examples import Examples
from mcmc1d.flatland.mutations.base import layout, looked_at, reweighed, settled
from mcmc1d.moves import Move, Proposal
from mcmc1d.numerics import parameter, pick, stratum, wrap
from mcmc1d.special import normal_quantile
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Scalar


class ManifoldStep(Move):
    """One vertex that is no mirror's bounce steps along its wall, by `sigma` of the wall's length and around its ends.

    A path's bounces are where the images of the vertices around them say (`Paths`): the walk on the specular manifold
    for which Jakob and Marschner 2012 need Newton's method is here in closed form, and a path whose mirrors have lost
    it brings no light. The step is symmetric in x, and so the acceptance ratio is f(y) / f(x); it turns lamps, walls
    and what a wall sensor sees, one at a time.
    """

    sigma: Scalar = eqx.field(converter=parameter, default=0.05)

    def __check_init__(self):
        require_positive(self, sigma=self.sigma)

    def dim_w(self, target: Multiplexed) -> int:
        return 3

    def check(self, target: Multiplexed) -> None:
        layout(target)

    def propose(self, target: Multiplexed, state: State, w: Float[Array, " 3"]) -> Proposal:
        """`w`: which vertex, which is kept; the place inside the weight of the technique in use; the step."""
        here, known = layout(target), state.seen
        walls, places, seen = here.paths.walls, here.paths.sensor.places, looked_at(here, known.x)
        chosen = stratum(w[0], seen.edges + places)
        slot = pick([known.x[j] for j in range(here.paths.dim)], chosen)
        free = slot < walls.total
        segment, along = walls.place(jnp.where(free, slot, 0))
        length = walls.at(walls.length, segment)
        there = walls.slot(segment, length * wrap(along / length + self.sigma * normal_quantile(w[2])))
        x = jnp.where(jnp.arange(len(known.x)) == chosen, there, known.x)
        log_f, log_p = target.target.log_f(x), target.family.log_probs(x)
        index, place, log_weights = reweighed(target, known, state.index, w[1], x, log_p)
        back = jnp.stack([w[0], place, 1 - w[2]])
        return settled(target, index, (x, known.v, log_f, log_p), back, known, jnp.where(free, log_weights, -jnp.inf))


EXAMPLES = Examples(lambda: {"manifold_step": ManifoldStep()})

__all__ = ["EXAMPLES", "ManifoldStep"]
