"""How often moves are accepted, by path length: Bitterli et al. 2017, figure 4, in the plane."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from scipy.stats import beta, norm, sem
from scipy.stats import t as student

import mcmc1d
from experiments.support.flatland_chains import METHODS, MOVES, mixed_kernel, mixes
from experiments.support.framework import Claim
from experiments.support.verdict import verdict
from mcmc1d.compiling import quickly
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import RJMLT
from mcmc1d.flatland.scenes import scene
from mcmc1d.metropolis import Kernel
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array

SHOWN = ("keep", "change", "jump", "uniform jump")
"""The moves whose acceptance is shown."""
SOURCE = "Bitterli et al. 2017"
LEVEL = 1e-3
"""Of each claim, all lengths together: that a right one is refuted, or a wrong one found to hold."""
PAPER = (10, 0.01)
"""Edges, and what the paper's figure has there for small steps that change the technique."""
_FAR = 0.99
"""The probability with which a smallest error that is stated is found."""


def accepted(
    edges: int, name: str, pixels: int, states: int, moves: tuple[float, float, float], seed: int
) -> dict[str, Any]:
    """At one path length: a proposal from each of many exact states, as a chain makes them on average.

    `moves`: sigma, and the shares of large steps and of jumps, which the acceptance does not depend on.
    """
    paths = Paths(scene(name).with_pixels(pixels), edges)
    target, key = RJMLT().target(paths), jax.random.fold_in(jax.random.key(seed), edges)
    change = mixes(target.n_techniques, *moves)[METHODS[0]][1]
    kernel = mixed_kernel(moves[0], {move: 1 / len(SHOWN) for move in SHOWN}, change)
    start = mcmc1d.exact_start(jax.random.fold_in(key, 0), target, states)
    w = jax.random.uniform(jax.random.fold_in(key, 1), (states, kernel.dim_w(target)), start.u.dtype)
    kind, chance, predicted = (np.asarray(part) for part in _proposals(kernel, target, start, w))
    each = [chance[kind == MOVES.index(move)].astype(np.float64) for move in SHOWN]
    return {
        "acceptance": [float(one.mean()) for one in each],
        "acceptance_error": [float(sem(one)) for one in each],
        "proposals": [one.size for one in each],
        "predicted": float(predicted.mean(dtype=np.float64)),
        "predicted_error": float(sem(predicted.astype(np.float64))),
    }


@quickly
def _proposals(kernel: Kernel, target: Multiplexed, states: State, w: Array) -> tuple[Array, Array, Array]:
    """Of each state: which kind of move is proposed, with what chance it is accepted, and that of a uniform jump.

    The last is predicted, from the weights at x alone: sum_ij min(w_i, w_j) / n, whichever technique made x.
    """

    def one(state: State, w: Array) -> tuple[Array, Array, Array]:
        info = kernel.step(target, state, w).info
        share = jnp.exp(jnp.stack(list(target.log_weights(state.seen.x, state.seen.log_p))))
        predicted = jnp.minimum(share[:, None], share[None]).sum() / target.n_techniques
        return info.kind[0], info.acceptance[0], predicted

    return jax.vmap(one)(states, w)


def acceptance_claims(data: xr.Dataset) -> list[Claim]:
    """What figure 4 says of small steps and jumps, and what eq. 14 says of a jump to any technique alike."""
    rate = {move: data.acceptance.sel(move=move).to_numpy() for move in SHOWN}
    blur = {move: data.acceptance_error.sel(move=move).to_numpy() for move in SHOWN}
    count = data.proposals.to_numpy()
    edges, size = data.edges.to_numpy(), data.sizes["edges"]
    far = float(student.isf(LEVEL / 2 / size, int(count.min()) - 1))

    def held(error: float) -> str:
        seen = (far + float(norm.ppf(_FAR))) * error
        return f"t intervals, family-wise {LEVEL:g} over {size} lengths; finds {seen:.1%} with probability {_FAR:g}"

    def listed(move: str) -> str:
        return ", ".join(f"{value:.1%}" for value in rate[move]) + f" at {', '.join(map(str, edges))} edges"

    def ends(move: str) -> float:
        return float(np.hypot(blur[move][0], blur[move][-1]))

    def falls(move: str) -> bool | None:
        return over(rate[move][0] - rate[move][-1], far * ends(move))

    def lower(move: str) -> str:
        return verdict(*map(over, rate["keep"] - rate[move], far * np.hypot(blur["keep"], blur[move])))

    apart, both = rate["keep"] - rate["change"], np.hypot(blur["keep"], blur["change"])
    reached = int(edges[-1]) >= PAPER[0]
    last, noise = rate["change"][-1], float(blur["change"][-1])
    # Rejections are binomial at most: a chance between 0 and 1 varies less than one that is either.
    jumps = count[:, SHOWN.index("jump")]
    lost = np.maximum((1 - rate["jump"]) * jumps, 1e-6)
    least = 1 - float(np.max(beta.isf(LEVEL / size, lost + 1, jumps - lost)))
    most = 1 - float(np.max(beta.ppf(LEVEL / size, lost, jumps - lost + 1)))
    spread = np.hypot(blur["uniform jump"], data.predicted_error.to_numpy())
    off = float(np.max(np.abs(rate["uniform jump"] - data.predicted.to_numpy()) / spread))
    twin = float(np.max(np.abs(rate["change"] - data.predicted.to_numpy()) / spread))
    return [
        Claim(
            "plane.rjmlt-small-steps",
            "The acceptance of small steps that keep the technique falls with length",
            f"{SOURCE}, fig. 4",
            verdict(falls("keep")),
            "holds",
            listed("keep"),
            f"{held(ends('keep'))}; twin: uniform jumps, {verdict(falls('uniform jump'))}",
        ),
        Claim(
            "plane.rjmlt-small-steps-change",
            "Small steps that change the technique are accepted less often than those that keep it, at every length",
            f"{SOURCE}, fig. 4",
            lower("change"),
            "holds",
            f"lower by {apart.min():.1%} to {apart.max():.1%}",
            f"{held(float(both.max()))}; twin: uniform jumps, {lower('uniform jump')}",
        ),
        Claim(
            "plane.rjmlt-small-steps-one-percent",
            f"The acceptance of small steps that change the technique falls with length, to under {2 * PAPER[1]:.0%} "
            f"at {PAPER[0]} edges",
            f"{SOURCE}, fig. 4, sec. 7.2 (as low as {PAPER[1]:.0%})",
            # Expected is what was found: in the plane a bounce has one number, not two, that a change can spoil.
            verdict(falls("change"), over(2 * PAPER[1] - last, far * noise)) if reached else "open",
            "fails",
            listed("change"),
            held(noise),
        ),
        Claim(
            "plane.rjmlt-jumps-accepted",
            "Jumps to technique j with probability w_j are accepted, but for what floating point inverts badly",
            f"{SOURCE}, sec. 4, fig. 4 (close to 100 %)",
            verdict(True if least > 0.99 else False if most < 0.99 else None),
            "holds",
            f"a share of {lost.sum() / jumps.sum():.1e} rejected, of {jumps.sum()} at {size} lengths",
            f"99 %; binomial, family-wise {LEVEL:g}: over {least:.2%} at every length; twin: uniform jumps, "
            f"{listed('uniform jump')}",
        ),
        Claim(
            "plane.rjmlt-jump-law",
            "A jump to any technique alike, T(i, j) = 1 / n, is accepted as the weights say, whatever the path",
            f"ours; {SOURCE}, eq. 14",
            verdict(off < far),
            "holds",
            f"{off:.1f} s.e. at most from sum_ij min(w_i, w_j) / n",
            f"{far:.1f} s.e.; {held(float(spread.max()))}; twin: small steps that change it, {twin:.0f} s.e.",
        ),
    ]


def over(excess: float, radius: float) -> bool | None:
    """Whether a difference is positive; None where it may be either."""
    return True if excess > radius else False if excess < -radius else None


__all__ = ["PAPER", "SHOWN", "SOURCE", "acceptance_claims", "accepted"]
