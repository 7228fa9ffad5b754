"""What a technique says of its density: zero outside its support, the determinant's integral over v, and 1 in all."""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import cubature
from scipy.stats import qmc, sem
from scipy.stats import t as student

from mcmc1d.compiling import quickly
from mcmc1d.numerics import cast
from mcmc1d.quadrature import around_the_sharpest, by_chunks, integrate_box
from mcmc1d.techniques import Technique, sample_shape
from mcmc1d.types import Array, Float, Scalar
from mcmc1d.verify.compare import Points
from mcmc1d.verify.contract import Check, numbers
from mcmc1d.verify.maps import Maps

_V_POINTS = 2**14  # scrambled Sobol points over v, where log_prob is an integral over v and not the determinant
_SOME_V = 2**6  # for a first look, which finds the x to look at closely
_X_POINTS = 64
_LEAST = 1e-6  # of a density, times the box: less, of all of the box, is no mass to speak of
_NET = 2**18  # points of a box, where the integral of a density of several dimensions has a second witness
_NETS = 8  # scrambles of it, where cubature is not to be believed
_UNTOLD = 1e-2  # the largest error of an integral that passes, unless by nets
_BEYOND = (1e-3, 0.1, 1.0, 100.0)  # widths of the support; nearer, rounding may tell in or out
_ROUNDINGS = 8  # of the corner, at least


def outside(maps: Maps, image: np.ndarray, seed: int) -> Check:
    """Outside the support, and where log_prob says that nothing is, the inverse has no volume either."""
    rng = np.random.default_rng(seed + 3)
    lower, upper = maps.corners
    out = _beyond(maps, image)
    inside = np.zeros((0, image.shape[1]), maps.dtype)
    if np.isfinite(lower).all() and np.isfinite(upper).all():
        inside = rng.random((2048, image.shape[1])).astype(maps.dtype)
        inside[:, : maps.d] = lower + (upper - lower) * inside[:, : maps.d]
    points = np.concatenate([out, inside])
    equation = "log_prob is -inf outside the support, and where it is, so is the inverse's log_det"
    if len(points) == 0:
        return Check(equation, True, 0, 0.0, 0.0, note="the support has no end")
    _, log_det, log_prob = maps.inverse(points)
    must = np.isneginf(log_prob) | (np.arange(len(points)) < len(out))
    bad = must & ~(np.isneginf(log_prob) & np.isneginf(log_det))
    k = int(np.argmax(bad))
    place = f"outside {maps.support}" if k < len(out) else "where the density is zero"
    where = (
        f"x = {maps.x(points[k])}, {place}: log_prob = {log_prob[k]}, the inverse's log_det = {log_det[k]}; "
        "return -inf there (see `techniques.within`), or widen `support`"
    )
    return Check(equation, not bad.any(), int(must.sum()), float(bad.mean()), 0.0, where)


def unreached(maps: Maps, count: int, seed: int) -> list[Check]:
    """In a box of several dimensions: no density where no sample comes to.

    There no quadrature is sharp: a share of the mass that lies elsewhere is within what it may err.
    """
    lower, upper = (corner.astype(np.float64) for corner in maps.corners)
    if maps.d == 1 or maps.dtype == np.float32 or not np.isfinite([lower, upper]).all():
        return []
    points = np.random.default_rng(seed + 4).random((count, maps.technique.dim_u))
    points[:, : maps.d] = lower + (upper - lower) * points[:, : maps.d]
    u, _, log_prob = maps.inverse(points)
    inside = np.all((u >= 0) & (u < 1), axis=1)
    apart = np.abs(maps.forward(np.where(inside[:, None], u, 0.5))[0] - points)[:, : maps.d]
    # Grossly: how near the round trip must come, others check.
    there = inside & (apart <= 1e-2 * (upper - lower)).all(1)
    # Far out in a tail, where a CDF rounds to 1, no u leads to a density that is positive still.
    bad = (log_prob + np.log(upper - lower).sum() > np.log(_LEAST)) & ~there
    k = int(np.argmax(bad))
    where = (
        f"x = {maps.x(points[k])}: log_prob = {log_prob[k]}, but no u in [0, 1) leads there; the inverse gives {u[k]}"
    )
    note = f"a region of {5 / count:.1e} of the support would have been met, with probability 0.99"
    return [Check("log_prob is finite at samples only", not bad.any(), count, float(bad.mean()), 0.0, where, note)]


def linear(maps: Maps, image: np.ndarray) -> list[Check]:
    """Where the technique defines `prob`: that it is exp(log_prob), in the support and beyond; 0 just where that is.

    To 1e-9 (1e-4 in float32) of itself, and of the largest density that was met: the two may round otherwise.
    """
    points = np.concatenate([image[np.isfinite(image).all(1)], _beyond(maps, image)])
    found = maps.prob(points)
    if found is None:
        return []
    p, log_prob = found.astype(np.float64), maps.inverse(points)[2].astype(np.float64)
    expected = np.exp(log_prob)
    close = 1e-9 if maps.dtype == np.float64 else 1e-4
    tolerance = close * (expected + np.max(expected, where=np.isfinite(expected), initial=0))
    apart = np.where(p == expected, 0, np.abs(p - expected))
    bad = ~(apart <= tolerance) | ((p == 0) != np.isneginf(log_prob))
    k = int(np.argmax(bad)) if bad.any() else int(np.argmax(apart / np.where(tolerance > 0, tolerance, 1)))
    where = f"x = {maps.x(points[k])}: prob = {p[k]}, log_prob = {log_prob[k]}"
    equation = "prob(x) = exp(log_prob(x)), and 0 where that is -inf alone"
    return [Check(equation, not bad.any(), len(points), float(apart[k]), float(tolerance[k]), where)]


def _beyond(maps: Maps, image: np.ndarray) -> np.ndarray:
    """Images whose x is moved out of the support, across each of its ends."""
    lower, upper = maps.corners
    image = image[np.isfinite(image).all(1)][:64]
    scale = np.where(np.isfinite(upper - lower), upper - lower, 1)
    beyond = [np.zeros((0, image.shape[1]), maps.dtype)]
    for j, (corner, sign) in itertools.product(range(maps.d), ((lower, -1), (upper, 1))):
        if np.isfinite(corner[j]):
            rounding = _ROUNDINGS * np.spacing(np.abs(corner[j]).astype(maps.dtype))
            for step in _BEYOND:
                moved = image.copy()
                moved[:, j] = corner[j] + sign * max(step * scale[j], rounding)
                beyond.append(moved)
    return np.concatenate(beyond)


def over_v(maps: Maps, at: Points, log_prob: np.ndarray, seed: int) -> Check:
    """p(x) against the mean over v of the inverse's determinant, where the two are not the same pointwise.

    First at many x with few v each; then, with many v, at half as many of those as they come and half that look worst.
    """
    k = at.values.shape[1] - maps.d
    sobol = qmc.Sobol(k, rng=seed)
    few, many = sobol.random(_SOME_V), qmc.Sobol(k, rng=seed + 1).random(_V_POINTS)

    def determinants(rows: np.ndarray, v: np.ndarray) -> np.ndarray:
        image = np.column_stack([np.repeat(at.values[rows, : maps.d], len(v), axis=0), np.tile(v, (len(rows), 1))])
        return np.exp(maps.inverse(image)[1].astype(np.float64)).reshape(len(rows), len(v))

    regular = np.flatnonzero(at.regular)
    rows = regular[:: max(1, len(regular) // 4096)]
    p = np.exp(log_prob.astype(np.float64))
    off = np.abs(determinants(rows, few).mean(1) - p[rows]) / np.maximum(p[rows], 1e-300)
    worst = rows[np.argsort(-np.nan_to_num(off, nan=np.inf))[: _X_POINTS // 2]]
    rows = np.concatenate([regular[: _X_POINTS // 2], worst])
    values = determinants(rows, many)
    mean, p = values.mean(1), p[rows]
    # Where nothing varies over v the mean is exact. Elsewhere: the spread of the means of four quarters of the points
    # (each as even as the whole), and for jumps in v, one of which is off by one of the points at most, eight of them.
    quarters = values.reshape(len(rows), 4, -1).mean(2)
    spread = 3 * quarters.std(1, ddof=1) + 8 * np.ptp(values, axis=1) / _V_POINTS
    tolerance = spread + at.tolerance[rows] * np.maximum(p, 1)
    error = np.abs(mean - p)
    ratio = error / tolerance
    worst = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
    detectable = float(np.median(tolerance / np.maximum(p, 1e-300)))
    return Check(
        "p(x) = integral over v of |det du/d(x, v)|",
        bool(error[worst] <= tolerance[worst]),
        len(rows),
        float(error[worst]),
        float(tolerance[worst]),
        f"x = {maps.x(at.values[rows[worst]])}: p = {p[worst]}, the integral {mean[worst]}",
        "the determinant depends on v, so it is not the density pointwise; moves use it, weights use log_prob. "
        f"By {_V_POINTS} points v at each x: p off by more than {detectable:.1e} of itself would have been seen",
    )


class _Density(eqx.Module):
    technique: Technique
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, x: Float[Array, "..."]) -> Scalar:
        return jnp.exp(self.technique.log_prob(x.reshape(self.shape)))


class _Finite(_Density):
    """Without a pole that cubature comes upon, which is a point or a curve; the net beside it meets none by chance."""

    def __call__(self, x: Float[Array, " d"]) -> Scalar:
        p = super().__call__(x)
        return jnp.where(jnp.isposinf(p), 0, p)


def integral(technique: Technique) -> Check:
    """The integral of the density over the support, in float64."""
    shape = sample_shape(technique)
    density = _Density(technique, shape)
    lower, upper = (np.asarray(corner, np.float64) for corner in technique.support)
    hidden = 0.0
    if shape == ():
        value, error, hidden = _on_the_line(density, float(lower), float(upper))
    else:
        with np.errstate(invalid="ignore"):
            net = np.isfinite([lower, upper]).all()
            over = _Finite(technique, shape) if net else density
            value, error = integrate_box(over, lower, upper)
            if net:
                apart = _by_net(density, lower, upper) - value
                error = max(error, abs(apart))
                value += apart if np.isinf(apart) else 0.0
                if _UNTOLD < abs(apart) < np.inf:
                    return _by_nets_alone(density, lower, upper, value)
    tolerance = float(np.min([np.max([1e-9, 3 * error, 16 * hidden]), _UNTOLD]))  # NaN if any is
    where = f"the integral of exp(log_prob) over {Maps(technique, np.dtype(np.float64)).support} is {value}"
    note = ""
    if not np.isfinite(value):
        note = "p is infinite inside: name where in `breaks`"
    elif tolerance > 1e-8:
        why = (
            "float64 can not resolve the pole at an end"
            if 16 * hidden == tolerance
            else "of the quadrature's own error"
        )
        note = f"an integral that is off by less than {tolerance:.1e} would pass, because {why}"
    off = float(abs(value - 1))
    return Check("the integral of p is 1", bool(off <= tolerance), 1, off, tolerance, where, note)


def _on_the_line(density: _Density, lower: float, upper: float) -> tuple[float, float, float]:
    """The integral over an interval, its error estimate, and the mass within a rounding of the ends and the breaks."""
    technique = density.technique
    known = [end for end in (lower, upper) if np.isfinite(end)]
    known += [b for b in technique.breaks if lower < b < upper]
    if len(known) < 2 or not np.isfinite([lower, upper]).all():
        # Beyond two samples the tails begin, which are no place for a pole.
        with jax.enable_x64(True):
            exact = cast(technique, jnp.float64)
            known += [float(exact.forward(jnp.full(technique.dim_u, u))[0]) for u in (0.25, 0.75)]
    value, error, hidden = _between(density, np.unique(known))
    for end, last in ((lower, min(known)), (upper, max(known))):
        if not np.isfinite(end):
            with np.errstate(invalid="ignore"):
                tail, off = integrate_box(density, np.array([min(end, last)]), np.array([max(end, last)]))
            value, error = value + tail, error + off
    return value, error, hidden


def _by_nets_alone(density: _Density, lower: np.ndarray, upper: np.ndarray, cubature: float) -> Check:
    """Where most of a box is empty, or the density jumps all over it, several nets say how far off they are."""
    nets = np.array([_by_net(density, lower, upper, seed) for seed in range(_NETS)])
    value, error = float(nets.mean()), float(sem(nets))
    tolerance = max(_UNTOLD, float(student.isf(1e-6, _NETS - 1)) * error)
    where = f"the integral of exp(log_prob) over the support [{numbers(lower)}, {numbers(upper)}] is {value:.4g}"
    note = (
        f"by {_NETS} nets, as cubature finds {cubature:.4g}: an integral off by less than {tolerance:.1e} would pass, "
        "because most of the box is empty or the density jumps; that samples have no other density says more"
    )
    off = abs(value - 1)
    return Check("the integral of p is 1", off <= tolerance, 1, off, tolerance, where, note)


def _by_net(density: _Density, lower: np.ndarray, upper: np.ndarray, seed: int = 0) -> float:
    """The integral over a box by a scrambled Sobol net.

    Where a density jumps along a curve, cubature thinks too well of itself; the two do not err alike.
    """
    points = lower + (upper - lower) * qmc.Sobol(lower.size, rng=seed).random(_NET)
    with jax.enable_x64(True):
        values = np.asarray(quickly(eqx.filter_vmap(cast(density, jnp.float64)))(jnp.asarray(points)))
    return float(values.mean() * np.prod(upper - lower))


def _between(density: _Density, cuts: np.ndarray) -> tuple[float, float, float]:
    """The integral over all pieces between `cuts`, its error estimate, and the mass within a rounding of the cuts.

    Cut further around what is sharp at 2**14 points: a peak between two of them is missed. From either end of a piece
    to its middle, x = end +- half t^4: an integrable pole of any power over -3/4 at the end turns into a smooth
    function of t.
    """
    with jax.enable_x64(True):
        values = by_chunks(quickly(eqx.filter_vmap(cast(density, jnp.float64))), 2**12)
        cuts = np.union1d(cuts, around_the_sharpest(values, cuts[0], cuts[-1]))
    ends = np.concatenate([cuts[:-1], cuts[1:]])
    half = np.concatenate([np.diff(cuts), -np.diff(cuts)]) / 2
    tiny = np.finfo(np.float64).tiny  # what XLA does not flush to zero
    ulp = np.maximum(np.abs(np.nextafter(ends, ends + half) - ends), tiny)
    with jax.enable_x64(True):

        def on_nodes(t: np.ndarray) -> np.ndarray:
            x = ends + half * t**4
            x = np.where(half > 0, np.maximum(x, nearest), np.minimum(x, nearest))
            return values(x.ravel()).reshape(x.shape) * np.abs(half) * 4 * t**3

        # The nearest number to each end where p is finite: right at a pole, and a few roundings beside it, it is not.
        nearest = ends + np.copysign(ulp, half)
        for roundings in (2, 4, 8, 16, 32):
            at_ends = values(nearest)
            nearest = np.where(np.isfinite(at_ends), nearest, ends + np.copysign(roundings * ulp, half))
        hidden = float(np.sum(values(nearest) * np.abs(nearest - ends)))
        with np.errstate(invalid="ignore"):  # should p be infinite elsewhere, the error is NaN, and the check fails
            options: dict[str, Any] = {"rtol": 0, "atol": 1e-11 / len(ends), "max_subdivisions": 300}
            result = cubature(on_nodes, [0.0], [1.0], **options)
    return float(result.estimate.sum()), float(result.error.sum()), hidden
