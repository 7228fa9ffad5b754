"""Which way a path goes on from a wall: Lambert, glossy and mirror lobes, and mixtures of them, for one event.

A direction is given by its components along a wall's tangent and front normal. All lobes see the wall from the side
that the path comes from; what the back sends on is black, so a path that goes there brings nothing, and inverts.
"""

import itertools
import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mcmc1d.flatland.geometry import Frame, Numbers, Vector, Walls
from mcmc1d.numerics import below_one, choose, cumulative, limit, pick, unchoose
from mcmc1d.special import normal_quantile
from mcmc1d.types import Array, Bool, Index, Scalar


class Local(NamedTuple):
    """A direction in the frame of a wall."""

    along: Numbers
    """The sine of its angle."""
    up: Numbers
    """Its cosine, positive on the front."""

    def world(self, frame: Frame) -> Vector:
        """The direction in the plane."""
        return frame.tangent * self.along + frame.normal * self.up


def local(frame: Frame, direction: Vector) -> Local:
    """A unit vector of the plane in a wall's frame."""
    return Local(direction.dot(frame.tangent), direction.dot(frame.normal))


class Turn(NamedTuple):
    """A choice of lobe and direction."""

    out: Local
    mirror: Bool[Array, "..."]
    """Whether it was the mirror: then the number for the direction was not read."""
    v: Numbers
    """What the direction forgets: the place inside the lobe's posterior interval."""
    log_p: Numbers
    """Log of the density with respect to d theta, the mirror's left out; of the mirror, log of its probability."""


def lambert_direction(u: Scalar) -> Local:
    """A direction with density cos(theta) / 2 on the front, sin(theta) = 2u - 1."""
    return Local(2 * u - 1, 2 * jnp.sqrt(u * (1 - u)))


def lambert_number(out: Local) -> Scalar:
    """The inverse of `lambert_direction`."""
    return below_one((1 + out.along) / 2)


def scatter(walls: Walls, segment: Index, coming: Local, u_lobe: Scalar, u_direction: Scalar) -> Turn:
    """Choose a lobe by its share of the reflectance, then a direction; `coming`: to where the path comes from.

    A black wall has a Lambert lobe that returns nothing.
    """
    diffuse = lambert_direction(u_direction)
    if not walls.exponents and not walls.mirrors:  # a mixture of one: u_lobe is forgotten as it is
        out, place = Local(diffuse.along, _side(coming) * diffuse.up), below_one(u_lobe)
        log_p = jnp.log(jnp.maximum(diffuse.up / 2, jnp.finfo(place.dtype).tiny))
        return Turn(out, jnp.zeros(jnp.shape(place), bool), place, log_p)
    prior = _prior(walls, segment)
    lobe, place = choose(prior, u_lobe)
    options = [Local(diffuse.along, _side(coming) * diffuse.up)]
    options += [_about_mirror(coming, *_glossy_quantile(walls, segment, u_direction))] if walls.exponents else []
    options += [reflection(coming)]
    out = pick(options, lobe)
    mirror = jnp.equal(lobe, len(options) - 1)
    log_p, posterior = _nonspecular(walls, segment, prior, coming, out)
    v = jnp.where(mirror, place, unchoose(posterior, jnp.minimum(lobe, len(options) - 2), place))
    return Turn(out, mirror, v, jnp.where(mirror, _log_mirror(prior), log_p))


def unscatter(
    walls: Walls, segment: Index, coming: Local, out: Local, mirror: Bool[Array, ""], v: Scalar, pad: Scalar
) -> tuple[Scalar, Scalar]:
    """(u_lobe, u_direction), the inverse of `scatter`; `pad`: the number that a mirror did not read."""
    prior = _prior(walls, segment)
    _, posterior = _nonspecular(walls, segment, prior, coming, out)
    lobe, place = choose(posterior, v)
    numbers = [lambert_number(out)]
    numbers += [_glossy_cdf(walls, segment, *_from_mirror(coming, out))] if walls.exponents else []
    last = len(prior) - 2
    u_lobe = unchoose(prior, jnp.where(mirror, last, lobe), jnp.where(mirror, v, place))
    return u_lobe, jnp.where(mirror, pad, pick(numbers, lobe))


def log_density(walls: Walls, segment: Index, coming: Local, out: Local, mirror: Bool[Array, ""]) -> Scalar:
    """Log of the density of `out` with respect to d theta, the mirror left out; of a mirror, log of its probability."""
    prior = _prior(walls, segment)
    return jnp.where(mirror, _log_mirror(prior), _nonspecular(walls, segment, prior, coming, out)[0])


def density(walls: Walls, segment: Index, coming: Local, out: Local, mirror: Bool[Array, ""]) -> Scalar:
    """The same density, or probability, itself."""
    if not walls.exponents and not walls.mirrors:
        return jnp.maximum(_side(coming) * out.up, 0) / 2
    prior = _prior(walls, segment)
    total = sum(_joint(walls, segment, prior, coming, out))
    return jnp.where(mirror, prior[-1] - prior[-2], total)


def brdf(walls: Walls, segment: Index, coming: Local, out: Local) -> Scalar:
    """f_r of the Lambert and the glossy lobe; zero unless both directions are on the front.

    rho / 2, and rho cos^n(alpha) / (I_n max(cos_i, cos_o)), which is reciprocal and creates no energy.
    """
    value = walls.at(walls.lambert, segment) / 2
    if walls.exponents:
        larger = jnp.maximum(coming.up, out.up)
        lobe = _glossy_density(walls, segment, _from_mirror(coming, out)[1])
        value = value + walls.at(walls.glossy, segment) * lobe / jnp.where(larger > 0, larger, 1)
    return jnp.where((coming.up > 0) & (out.up > 0), value, 0)


def reflection(coming: Local) -> Local:
    """Where a mirror sends what comes from there."""
    return Local(-coming.along, coming.up)


def _prior(walls: Walls, segment: Index) -> list[Scalar]:
    """The ends of the intervals of Lambert, glossy (where the scene has any) and mirror."""
    lambert, mirror = walls.at(walls.lambert, segment), walls.at(walls.mirror, segment)
    lobes = [lambert, walls.at(walls.glossy, segment), mirror] if walls.exponents else [lambert, mirror]
    black = sum(lobes[1:], lobes[0]) <= 0
    return cumulative([jnp.where(black, 1, lobes[0]), *lobes[1:]])


def _log_mirror(prior: list[Scalar]) -> Scalar:
    share = prior[-1] - prior[-2]
    return jnp.where(share > 0, jnp.log(jnp.where(share > 0, share, 1)), -jnp.inf)


def _nonspecular(
    walls: Walls, segment: Index, prior: list[Scalar], coming: Local, out: Local
) -> tuple[Scalar, list[Scalar]]:
    """Log of the density of Lambert and glossy together, and their intervals in the posterior."""
    joint = _joint(walls, segment, prior, coming, out)
    total = sum(joint[1:], joint[0])
    possible = total > 0
    # Where the density is zero, as at grazing angles, the prior says which lobe it was.
    prior_shares = [end - start for start, end in itertools.pairwise(prior[:-1])]
    prior_shares[0] = jnp.where(prior[-2] > 0, prior_shares[0], 1)
    shares = [jnp.where(possible, part, share) for part, share in zip(joint, prior_shares, strict=True)]
    return jnp.where(possible, jnp.log(jnp.where(possible, total, 1)), -jnp.inf), cumulative(shares)


def _joint(walls: Walls, segment: Index, prior: list[Scalar], coming: Local, out: Local) -> list[Scalar]:
    """The density by way of Lambert's lobe, and by way of the glossy one where the scene has any."""
    joint = [prior[1] * jnp.maximum(_side(coming) * out.up, 0) / 2]
    if walls.exponents:
        joint.append((prior[2] - prior[1]) * _glossy_density(walls, segment, _from_mirror(coming, out)[1]))
    return joint


def _side(coming: Local) -> Scalar:
    return jnp.where(coming.up >= 0, 1, -1).astype(coming.up.dtype)


# --- the glossy lobe: cos^n(alpha) / I_n about the mirror's direction, |alpha| < pi / 2 ------------------------------


def _from_mirror(coming: Local, out: Local) -> tuple[Scalar, Scalar]:
    """(sin, cos) of the angle alpha from the mirror's direction to `out`."""
    return -out.along * coming.up - out.up * coming.along, out.up * coming.up - out.along * coming.along


def _about_mirror(coming: Local, sine: Scalar, cosine: Scalar) -> Local:
    """The direction at alpha from the mirror's: the inverse of `_from_mirror`."""
    return Local(-cosine * coming.along - sine * coming.up, cosine * coming.up - sine * coming.along)


def _glossy_density(walls: Walls, segment: Index, cosine: Scalar) -> Scalar:
    ahead = cosine > 0
    log_cosine = jnp.log(jnp.where(ahead, cosine, 1))
    powers = [jnp.exp(n * log_cosine - math.log(_norm(n))) for n in walls.exponents]
    return jnp.where(ahead, pick(powers, walls.at(walls.finish, segment)), 0)


def _glossy_quantile(walls: Walls, segment: Index, u: Scalar) -> tuple[Scalar, Scalar]:
    """(sin, cos) of the alpha below which lies a share u of the lobe."""
    alpha = pick([_quantile(n, u) for n in walls.exponents], walls.at(walls.finish, segment))
    return jnp.sin(alpha), jnp.cos(alpha)


def _glossy_cdf(walls: Walls, segment: Index, sine: Scalar, cosine: Scalar) -> Scalar:
    shares = [_cdf(n, sine, cosine, jnp.arctan2(sine, cosine)) for n in walls.exponents]
    return below_one(jnp.where(cosine > 0, pick(shares, walls.at(walls.finish, segment)), jnp.where(sine > 0, 1, 0)))


_FEW = 16
"""Up to so many terms a series is written out; a longer one is a loop, which compiles in no time."""


def _norm(n: int) -> float:
    """I_n, the integral of cos^n over the half circle."""
    return math.sqrt(math.pi) * math.exp(math.lgamma((n + 1) / 2) - math.lgamma(n / 2 + 1))


def _cdf(n: int, sine: Scalar, cosine: Scalar, alpha: Scalar) -> Scalar:
    """The share of cos^n below alpha, by the recurrence n J_n = cos^(n-1) sin + (n-1) J_(n-2), summed by Horner."""
    coefficients, factor = [], 1.0
    for k in range(n, 1, -2):
        coefficients.append(factor / k)
        factor *= (k - 1) / k
    square, series = cosine * cosine, jnp.zeros_like(cosine)
    if len(coefficients) <= _FEW:
        for coefficient in coefficients:
            series = series * square + coefficient
    else:
        table = jnp.asarray(coefficients, cosine.dtype)
        series = jax.lax.fori_loop(0, len(table), lambda j, total: total * square + table[j], series)
    last = (series * square + factor) * sine if n % 2 else series * sine * cosine + factor * alpha
    return limit(0.5 + last / _norm(n), 0, 1)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _quantile(n: int, u: Scalar) -> Scalar:
    """The alpha below which lies a share u of cos^n, by Newton's method for the logarithm of the smaller share.

    To a few roundings of u = 1, which next to the ends, where the density vanishes, is more in alpha. The logarithm of
    the distribution function is concave: after the first step all come from one side, and none overshoots.
    """
    u = jnp.asarray(u)
    share = jnp.minimum(u, 1 - u)
    tiny = jnp.finfo(u.dtype).tiny
    # At a distance d from the end the lobe is less than d^n: a bound.
    distance = jnp.exp(jnp.log(jnp.maximum(share * ((n + 1) * _norm(n)), tiny)) / (n + 1))
    low = -jnp.maximum(jnp.pi / 2 - distance, 0)
    # tan(alpha) is about normal, of variance 1 / (n + 1), with longer tails.
    guess = jnp.arctan(normal_quantile(jnp.maximum(share, jnp.finfo(u.dtype).eps)) / math.sqrt(n + 1))
    alpha = jnp.clip(guess, low, 0)
    for _ in range(8 if u.dtype == jnp.float64 else 5):
        cosine = jnp.cos(alpha)
        below = jnp.maximum(_cdf(n, jnp.sin(alpha), cosine, alpha), tiny)
        step = jnp.log(jnp.maximum(share, tiny) / below) * below / jnp.maximum(_power(n, cosine), tiny)
        alpha = jnp.clip(alpha + step, low, 0)
    return jnp.where(u < 0.5, alpha, -alpha)


@_quantile.defjvp
def _quantile_jvp(n: int, primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    """That of the inverse function: infinite at the ends, where the density vanishes."""
    (u,), (step,) = primals, tangents
    alpha = _quantile(n, u)
    power = jnp.where((u > 0) & (u < 1), _power(n, jnp.cos(alpha)), 0)
    return alpha, jnp.where(step == 0, 0, step / power)


def _power(n: int, cosine: Scalar) -> Scalar:
    return jnp.maximum(cosine, 0) ** n / _norm(n)
