"""What is looked at before a chain samples it: the target, its techniques and its weights, at many points."""

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require, traced
from mcmc1d.compiling import quickly
from mcmc1d.numerics import cast
from mcmc1d.targets import Target
from mcmc1d.techniques import Family
from mcmc1d.types import Array, Bool, Float
from mcmc1d.weights import Weights


@quickly
def _look(
    target: Target, family: Family, weights: Weights, points: Float[Array, "n ..."]
) -> tuple[Array, Array, Array]:
    """Log f, p and log w at each point."""

    def at(x: Float[Array, "..."]) -> tuple[Array, Array, Array]:
        log_p = family.log_probs(x)
        return target.log_f(x), jnp.stack(log_p), jnp.stack(list(weights.log_weights(x, log_p)))

    return jax.vmap(at)(points)


@quickly
def _seen(target: Target, points: Float[Array, "n ..."]) -> Array:
    """Log f at each point, as a chain sees it."""
    return jax.vmap(lambda x: target.look(x)[0])(points)


def _looked_at(target: Target, family: Family, weights: Weights, points: np.ndarray) -> list[np.ndarray]:
    """`_look`, in double precision."""
    with jax.enable_x64(True), traced("Multiplexed: f, or a weight,"):
        parts = cast((target, family, weights), jnp.float64)
        return [np.asarray(a) for a in _look(*parts, jnp.asarray(points))]


def require_sound(target: Target, family: Family, weights: Weights, probes: int) -> None:
    """Raise `ValueError` for what no chain could sample, naming the thing and the first of `probes` points."""
    points = family.probes(target.domain, probes)
    log_f, log_p, log_w = _looked_at(target, family, weights, points)
    name = type(target).__name__

    def first(bad: Bool[np.ndarray, " n"], message: str) -> None:
        if bad.any():
            raise ValueError(message.format(x=points[np.argmax(bad)]))

    require(
        log_f.shape == (len(points),), f"{name}.log_f must return one number for one x, not shape {log_f.shape[1:]}"
    )
    if type(target).look is not Target.look:
        with jax.enable_x64(True), traced(f"{name}.look"):
            seen = np.asarray(_seen(cast(target, jnp.float64), jnp.asarray(points)))
        agree = np.isclose(seen, log_f, rtol=1e-6, atol=1e-6, equal_nan=True)
        first(
            ~agree,
            f"{name}: look says another log f than log_f at x = {{x}}: a chain would be held to another law",
        )
    if np.isnan(log_f).any():
        with jax.enable_x64(True):
            raise ValueError(target.complaint(points[np.argmax(np.isnan(log_f))]))
    first(np.isposinf(log_f), f"{name} is infinite at x = {{x}}: a pole must not lie on a probe; move it a little")
    require(
        bool(np.any(np.isfinite(log_f))),
        f"{name} is zero at all of {len(points)} probes of its domain: there is nothing to sample; mend it, or "
        "where all its mass lies between two of them, give more, probes=",
    )
    _require_dark_outside(target, family, weights)
    lit = np.isfinite(log_f)
    for i, technique in enumerate(family.members):
        who = f"technique {i} ({type(technique).__name__})"
        first(lit & np.isnan(log_p[:, i]), f"{who}: log_prob is NaN at x = {{x}}")
        first(lit & np.isposinf(log_p[:, i]), f"{who}: log_prob is infinite at x = {{x}}")
    reached = (log_p > -np.inf).any(1)
    first(lit & ~reached, f"no technique reaches x = {{x}}, where {name} is positive: that mass would be lost; add one")
    shares = np.exp(log_w)
    first(lit & np.isnan(log_w).any(1), "the weights are NaN or negative at x = {x}")
    lost = (shares > 0) & ~(log_p > -np.inf)
    for i in range(len(family.members)):
        first(
            lit & lost[:, i],
            f"the weight of technique {i} ({type(family.members[i]).__name__}) is positive at x = {{x}}, where its "
            "density is zero: that mass would be lost; give it weight zero there",
        )
    total = shares.sum(1)
    wrong = lit & (np.abs(total - 1) > 1e-6)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise ValueError(f"the weights sum to {total[k]:.9g}, not to one, at x = {points[k]}")


def _require_dark_outside(target: Target, family: Family, weights: Weights) -> None:
    """Raise `ValueError` where f is not zero outside its domain, at places that a technique makes."""
    lower, upper = (np.asarray(end, np.float64) for end in target.domain)
    width = upper - lower
    supports = [technique.support for technique in family.members]
    least = np.maximum(np.min([np.broadcast_to(s[0], lower.shape) for s in supports], 0), lower - width)
    most = np.minimum(np.max([np.broadcast_to(s[1], lower.shape) for s in supports], 0), upper + width)
    points = []
    for beyond, end in ((least, lower), (most, upper)):
        # By more than what rounds in single precision.
        for k in np.flatnonzero(np.ravel(np.abs(beyond - end) > 1e-5 * width)):
            for share in (1e-3, 0.1, 0.5, 0.999):
                inside = lower + width * np.linspace(0.1, 0.9, 8).reshape(8, *[1] * lower.ndim)
                inside.reshape(8, -1)[:, k] = np.ravel(end + share * (beyond - end))[k]
                points.append(inside)
    if not points:
        return
    outside = np.concatenate(points)
    log_f, log_p, _ = _looked_at(target, family, weights, outside)
    lit = (log_f > -np.inf) & (log_p > -np.inf).any(1)
    require(
        not lit.any(),
        f"{type(target).__name__} is positive at x = {outside[np.argmax(lit)]}, outside its domain {lower} to "
        f"{upper}, and a technique makes that: let log_f be -inf there, or widen the domain",
    )
