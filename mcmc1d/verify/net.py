"""What a stationary chain deposits, in expectation: by a scrambled Sobol net over the state and one step's numbers."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from mcmc1d.checks import require, require_cover, require_instance, require_mass, rising
from mcmc1d.compiling import wide_jit
from mcmc1d.metropolis import Kernel, as_kernel
from mcmc1d.moves import Move
from mcmc1d.numerics import cast
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Float, Index
from mcmc1d.verify.cells import net_points, require_nets, sobol

_BATCH = 2**14


class DepositLaw(NamedTuple):
    """The expected weight on each bin, of shape (bins,), and its standard error over the scrambles."""

    masses: np.ndarray
    standard_error: np.ndarray


def deposit_law(
    kernel: Kernel | Move,
    target: Multiplexed,
    edges: ArrayLike,
    *,
    points: int = 2**17,
    scrambles: int = 8,
    seed: int = 0,
) -> DepositLaw:
    """The law of what a kernel deposits on bins of a scalar x in one step from the target's law.

    It is the target's for an unbiased estimator; its difference from that is the bias of a right chain's deposits.
    `points`, a power of two, is the size of the net for one technique; there are `scrambles` of them, two at least.

    Raises `ValueError` where the kernel does not fit the target, x is no scalar, or the bins do not cover its domain.
    """
    forget_what_has_changed(kernel, target)
    kernel = as_kernel(kernel, "deposit_law: the kernel")
    require_instance(target, Multiplexed, "deposit_law: the target")
    kernel.check(target)
    edges = rising(np.asarray(edges, np.float64), "deposit_law")
    of = kernel.sampled(target).target
    require(np.ndim(of.domain[0]) == 0, f"deposit_law: x must be a scalar; {type(of).__name__} has none")
    require_cover("deposit_law", edges, of.domain, type(of).__name__)
    log2 = require_nets(points, scrambles)
    dtype = jnp.zeros(()).dtype
    fitted = cast((kernel, target), dtype)
    batch = min(_BATCH, points)
    found = []
    for r in range(scrambles):
        total, mass = np.zeros(len(edges) - 1), 0.0
        for index in range(target.n_techniques):
            rng = np.random.default_rng([seed, r, index])
            words = jnp.asarray(sobol(target.dim_u + kernel.dim_w(target), log2, rng))
            for first in range(0, points, batch):
                net = net_points(words, jnp.uint32(first), batch, dtype)
                out = _sums(*fitted, net, jnp.int32(index), jnp.asarray(edges, dtype))
                total, mass = total + np.asarray(out[0], np.float64), mass + float(out[1])
        found.append(total / require_mass(mass, "deposit_law", type(of).__name__))
    each = np.stack(found)
    return DepositLaw(each.mean(0), each.std(0, ddof=1) / np.sqrt(scrambles))


@wide_jit
def _sums(
    kernel: Kernel,
    target: Multiplexed,
    points: Float[Array, "dim count"],
    index: Index,
    edges: Float[Array, " n"],
) -> Any:
    """The weight deposited on each bin from one batch of the net, and the weight of its starts."""
    m, bins = target.dim_u, edges.shape[0] - 1

    def one(numbers: Float[Array, " dim"]) -> Any:
        state = target.evaluate(State(index, numbers[:m]))
        start = jnp.exp(state.seen.log_c)
        deposits = kernel.step(target, state, numbers[m:]).deposits
        place = jnp.clip(jnp.searchsorted(edges, deposits.x, side="right") - 1, 0, bins - 1)
        weight = jnp.where(start > 0, start * deposits.weight, 0)
        return place, weight, start

    places, weights, starts = jax.vmap(one, in_axes=-1)(points)
    return jnp.zeros(bins, edges.dtype).at[places.ravel()].add(weights.ravel()), starts.sum()


__all__ = ["DepositLaw", "deposit_law"]
