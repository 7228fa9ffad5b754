"""Veach's perturbations: a part of a path is traced again in nearly the same directions, by way of the same mirrors."""

import jax.numpy as jnp

from mcmc1d.examples import Examples
from mcmc1d.flatland.mutations.base import Layout, Mutation, Plan, Seen
from mcmc1d.moves import ExponentialStep, SmallStep
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Bool, Float, Index, Scalar

_STEP = ExponentialStep(1e-3, 0.05)
"""A tenth of a pixel of a hundred, to a twentieth of the film (Veach and Guibas 1997, section 7)."""


class Perturbation(Mutation):
    """A mutation that steps some of the path's numbers, and keeps the others."""

    step: ExponentialStep | SmallStep = _STEP

    def change(
        self, target: Multiplexed, u: Float[Array, " m"], w: Float[Array, " m"]
    ) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        proposal = self.step.propose(target, State(0, u), w)
        return proposal.state.u, proposal.w


class LensPerturbation(Perturbation):
    """Moves the path on the film: traced again from the sensor, by mirrors, to the first wall that is none.

    That wall is joined to the rest of the path, which is kept; so the next vertex must not be a mirror's bounce either,
    unless the wall is the lamp. Veach and Guibas 1997, section 5.3.2: paths (L|D)DS*E.
    """

    def plan(self, here: Layout, seen: Seen, number: Scalar) -> Plan:
        j = first_diffuse(seen, 1)
        applies = (j == seen.edges) | ~at(seen, j + 1)
        return Plan(only(here, seen, j + 1, applies, number), jnp.arange(here.dim_u) <= here.paths.sensor.places)


class CausticPerturbation(Perturbation):
    """Moves a caustic: the last wall before the mirrors next to what is seen sends its light in another direction.

    Traced by mirrors to a wall, which is joined to the pinhole: Veach and Guibas 1997, section 5.3.3, paths (L|D)S*DE.
    A wall sensor is such a wall itself and is hit.
    """

    def plan(self, here: Layout, seen: Seen, number: Scalar) -> Plan:
        t = here.lengths[0]
        j = first_diffuse(seen, t + 1)
        applies = (j <= seen.edges) & ~seen.mirror[t]
        # The lamp's place is the last number, its direction the one before; a later wall has two, lobe and direction.
        turned = here.dim_u - 2 - 2 * (seen.edges - j)
        return Plan(only(here, seen, jnp.asarray(t), applies, number), jnp.arange(here.dim_u) == turned)


class MultiChainPerturbation(Perturbation):
    """The lens perturbation for paths that come to mirrors again: each wall on the way is left in a new direction.

    As far as the first edge between two walls that are no mirrors, which is joined anew, or as the lamp. Veach and
    Guibas 1997, section 5.3.4: paths (D|L)DS+DS+E. Where no mirror follows the first wall it is the lens perturbation.
    """

    def plan(self, here: Layout, seen: Seen, number: Scalar) -> Plan:
        most, places = len(seen.mirror) - 1, here.paths.sensor.places
        last = seen.edges
        for j in reversed(range(1, most)):
            ends = ~seen.mirror[j] & ~seen.mirror[j + 1] & (j < seen.edges)
            last = jnp.where(ends, j, last)
        again = jnp.arange(here.dim_u) <= places
        for j in range(1, most):
            turned = (jnp.arange(here.dim_u) == places + 2 * j) & (j < last) & ~seen.mirror[j]
            again = again | turned
        return Plan(only(here, seen, last + 1, jnp.ones((), bool), number), again)


def first_diffuse(seen: Seen, start: int) -> Index:
    """The first vertex from `start` on that is no mirror's bounce; beyond the path where there is none."""
    found = jnp.asarray(len(seen.mirror), jnp.int32)
    for j in reversed(range(start, len(seen.mirror))):
        found = jnp.where(seen.mirror[j], found, j)
    return found


def at(seen: Seen, vertex: Index) -> Bool[Array, ""]:
    """Whether a vertex is a mirror's bounce."""
    return jnp.any(jnp.stack(seen.mirror) & (jnp.arange(len(seen.mirror)) == vertex))


def only(here: Layout, seen: Seen, t: Index, applies: Bool[Array, ""], number: Scalar) -> tuple[Scalar, ...]:
    """All of the shares to technique t for paths of the path's length; none where the mutation does not apply."""
    one = jnp.ones_like(number)
    return tuple(
        jnp.where(applies & (seen.edges == k) & (t == length), one, 0)
        for k, length in zip(here.edges, here.lengths, strict=True)
    )


EXAMPLES = Examples(
    lambda: {
        "lens_perturbation": LensPerturbation(),
        "caustic_perturbation": CausticPerturbation(),
        "multi_chain_perturbation": MultiChainPerturbation(SmallStep(0.02)),
    }
)

__all__ = ["EXAMPLES", "CausticPerturbation", "LensPerturbation", "MultiChainPerturbation"]
