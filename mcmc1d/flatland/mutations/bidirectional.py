"""Veach's bidirectional mutation: vertices of a path are deleted, and new ones walked from both sides of the gap."""

import jax.numpy as jnp

from mcmc1d.examples import Examples
from mcmc1d.flatland.evaluation import reads
from mcmc1d.flatland.mutations.base import Layout, Mutation, Plan, Seen
from mcmc1d.numerics import cumulative, entry, locate
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Float, Scalar


class BidirectionalMutation(Mutation):
    """Keeps a vertices from the sensor and b from the lamp; each way to join a new middle is one of the techniques.

    Veach and Guibas 1997, section 5.3.1. (a, b) is drawn uniformly, whatever the path; a technique makes the new middle
    with a share of 2^-n for n new vertices, and of those with as many vertices each alike. Where paths of several
    lengths are one space (`AnyLength`) this is the jump between them: vertices are put in or taken out anywhere, with
    numbers of their own, which is what matches the dimensions (Bitterli et al. 2017, section 8.2). A path that is too
    short to keep so many vertices is left alone.
    """

    def plan(self, here: Layout, seen: Seen, number: Scalar) -> Plan:
        kept, numbers = deletions(here), jnp.arange(here.dim_u)
        chosen = locate(cumulative([jnp.ones_like(number)] * len(kept)), number)

        def of_chosen(values: list[float]) -> Array:
            return entry([jnp.asarray(value, number.dtype) for value in values], chosen)

        techniques = zip(here.edges, here.lengths, strict=True)
        shares = tuple(of_chosen([_share(k, t, a, b) for a, b in kept]) for k, t in techniques)
        first = of_chosen([reads(a, here.paths.sensor.places)[0] for a, _ in kept])
        beyond = of_chosen([here.dim_u - reads(b, 1)[0] for _, b in kept])
        return Plan(shares, (numbers >= first) & (numbers < beyond))

    def change(
        self, target: Multiplexed, u: Float[Array, " m"], w: Float[Array, " m"]
    ) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        return w, u


def deletions(here: Layout) -> list[tuple[int, int]]:
    """All (a, b), how many vertices are kept from the sensor and from the lamp.

    A pinhole is always kept. Of paths of one length one vertex at least is deleted; of several, none need be.
    """
    least, most = here.lengths[0], here.paths.edges + (len(set(here.edges)) > 1)
    return [(a, b) for a in range(least, most + 1) for b in range(most - a + 1)]


def _share(k: int, t: int, a: int, b: int) -> float:
    """How often technique t for k edges is to fill the gap between a and b vertices; it keeps them, or it never is."""
    new = k + 1 - a - b
    return 2.0**-new / (new + 1) if t >= a and k + 1 - t >= b else 0.0


EXAMPLES = Examples(lambda: {"bidirectional_mutation": BidirectionalMutation()})

__all__ = ["EXAMPLES", "BidirectionalMutation", "deletions"]
