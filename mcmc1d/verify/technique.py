"""The contract of a technique, checked at machine precision for the very code that runs in production."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from mcmc1d.numerics import cast, require
from mcmc1d.quadrature import integrate_box
from mcmc1d.techniques import Technique, sample_shape
from mcmc1d.types import Array, Float, Scalar
from mcmc1d.verify.compare import Points, compare, condition_number, directions, log_abs_det, quickly
from mcmc1d.verify.points import cube_points
from mcmc1d.verify.report import Check, Report, numbers

_V_POINTS = 2**12  # scrambled Sobol points over v, where log_prob is an integral over v and not the determinant


def check_technique(
    technique: Technique,
    *,
    points: int = 10_000,
    seed: int = 0,
    dtypes: Sequence[Any] = (np.float64, np.float32),
) -> Report:
    """Hold a technique to its contract, in each precision, at random points and at the edges of the unit cube.

    Both round trips (the second with the x of one point and the v of another, as a jump has them); `forward`'s
    log-determinant against autodiff; `inverse`'s against `forward`'s; `log_prob` against the determinant, pointwise
    or integrated over v; the integral of the density over `support`; and that nothing leaves the unit cube. The
    tolerance is 1e-10 (2e-5 in float32) times the point's condition number. Where a derivative is infinite, the
    report says so and the log-determinant's limit is checked instead.

    Returns a `Report`, false where a check failed: its text names the broken equation, the worst point and both
    sides there. `report.raise_if_failed()` is for tests. Raises `ValueError` where the technique is not a map
    between spaces of one dimension.
    """
    checks = []
    with jax.enable_x64(True):
        for dtype in map(np.dtype, dtypes):
            found = _Contract(cast(technique, dtype), dtype, seed).checks(points)
            checks += [replace(check, equation=f"{dtype}: {check.equation}") for check in found]
        checks.append(_integral(technique))
    return Report(f"technique {type(technique).__name__}", checks)


class _Contract:
    """A technique in one precision."""

    def __init__(self, technique: Technique, dtype: np.dtype, seed: int):
        self.technique, self.dtype, self.seed = technique, dtype, seed
        self.shape = sample_shape(technique)
        self.d = int(np.prod(self.shape))

    def forward(self, u: np.ndarray) -> list[np.ndarray]:
        """(x, v) in one array, log_det, and the derivatives of both with respect to u."""
        return [np.asarray(a) for a in _over(_Forward(self.technique), jnp.asarray(u, self.dtype))]

    def inverse(self, image: np.ndarray) -> list[np.ndarray]:
        """u, log_det, and log_prob."""
        return [np.asarray(a) for a in _over(_Inverse(self.technique, self.shape), jnp.asarray(image, self.dtype))]

    def checks(self, count: int) -> list[Check]:
        m = self.technique.dim_u
        u = cube_points(m, count, self.seed, self.dtype, self._edges())
        image, log_det, jacobian, slope = self.forward(u)
        require(
            image.shape[1] == m,
            f"{type(self.technique).__name__}: u has {m} numbers, but x and v together {image.shape[1]}; what x "
            "forgets of u must be returned as v, and nothing more",
        )
        at_u = Points(u, condition_number(jacobian, slope, log_det))
        at_image = Points(image, at_u.condition, free=self.d)
        back, log_det_back, log_prob = self.inverse(image)

        def at(k: int) -> str:
            return (
                f"u = {numbers(u[k])}: x = {self._x(image[k])}, v = {numbers(image[k, self.d :])}, "
                f"log_det = {log_det[k]}, autodiff {log_abs_det(jacobian[k : k + 1])[0]}; the inverse gives "
                f"u = {numbers(back[k])}, log_det = {log_det_back[k]}; log_prob = {log_prob[k]}"
            )

        singular = self._singular(at_u)
        return [
            self._cube(u, image, back, log_prob),
            self._regular(at_u, count),
            compare("inverse(forward(u)) = u", at_image, lambda p, _: self.inverse(p)[0], u, describe=at),
            compare(
                "forward's log_det = log|det d(x, v)/du| by autodiff",
                at_u,
                lambda p, _: self.forward(p)[1],
                log_abs_det(jacobian),
                describe=at,
                note=singular,
            ),
            compare("inverse's log_det = -forward's", at_image, lambda p, _: self.inverse(p)[1], -log_det, describe=at),
            *self._limits(at_u, log_det),
            *self._at_fresh_v(u, image),
            self._density(at_image, log_det_back, log_prob),
        ]

    def _x(self, image: np.ndarray) -> str:
        return numbers(image[: self.d].reshape(self.shape))

    def _edges(self) -> set[float]:
        """The numbers u at which the density's breaks are reached, from the technique's own inverse."""
        if self.shape != () or not self.technique.breaks:
            return set()
        breaks = np.asarray(self.technique.breaks)[:: max(1, len(self.technique.breaks) // 64)]
        image = np.column_stack([breaks, np.full((len(breaks), self.technique.dim_u - 1), 0.5)])
        return set(np.unique(self.inverse(image)[0]).tolist())

    def _cube(self, u: np.ndarray, image: np.ndarray, back: np.ndarray, log_prob: np.ndarray) -> Check:
        v = image[:, self.d :]
        lower, upper = (np.asarray(corner, self.dtype).ravel() for corner in self.technique.support)
        x = image[:, : self.d]
        bad = ~np.isfinite(x).all(1) | (x < lower).any(1) | (x > upper).any(1) | np.isnan(log_prob)
        bad |= ~((v >= 0) & (v < 1)).all(1) | ~((back >= 0) & (back < 1)).all(1)
        k = int(np.argmax(bad))
        where = f"u = {numbers(u[k])}: x = {self._x(image[k])}, v = {numbers(v[k])}, back to u = {numbers(back[k])}"
        return Check(
            "x is in the support and log_prob is a number; v and the inverse's u are in [0, 1)",
            not bad.any(),
            len(u),
            float(bad.mean()),
            0.0,
            where,
        )

    def _regular(self, at_u: Points, count: int) -> Check:
        """A bijection may be singular at edges; at random points it is not."""
        singular = ~at_u.regular[:count]
        return Check(
            "the derivatives are finite and not all zero at random points",
            bool(singular.mean() <= 0.01),
            count,
            float(singular.mean()),
            0.01,
            f"u = {numbers(at_u.values[np.argmax(singular)])}",
        )

    def _singular(self, at_u: Points) -> str:
        count = int((~at_u.regular).sum())
        if count == 0:
            return ""
        first = numbers(at_u.values[np.argmin(at_u.regular)])
        return f"a derivative is infinite or zero at {count} points, such as u = {first}: there the limit is checked"

    def _limits(self, at_u: Points, log_det: np.ndarray) -> list[Check]:
        """Where the map is singular the log-determinant must be the limit of its neighbours'."""
        points = at_u.values[~at_u.regular]
        if len(points) == 0:
            return []
        claimed = log_det[~at_u.regular]
        holds = np.zeros(len(points), bool)
        eps = float(np.finfo(self.dtype).eps)
        one = np.ones((), self.dtype)
        for direction in directions(points.shape[1]):
            near = []
            for step in (eps**0.5, eps**0.75, eps**0.9):
                moved = np.clip(points + (step * direction).astype(self.dtype), 0, np.nextafter(one, 0 * one))
                near.append(self.forward(np.resize(moved, at_u.values.shape))[1][: len(points)])
            # An infinite limit is approached by growing, a finite one by differences that shrink.
            infinite = np.isinf(claimed)
            growing = (np.sign(near[2]) == np.sign(claimed)) & (np.abs(near[2]) > np.abs(near[0]))
            far, close = (np.where(infinite, 0, np.abs(value - np.where(infinite, 0, claimed))) for value in near[::2])
            shrinking = ((close < far) & (close < eps**0.2)) | (close <= 1e3 * eps)
            holds |= np.where(infinite, growing, shrinking)
        k = int(np.argmin(holds))
        return [
            Check(
                "where a derivative is infinite, log_det is the limit from some side",
                bool(holds.all()),
                len(points),
                float((~holds).mean()),
                0.0,
                f"u = {numbers(points[k])}: log_det = {claimed[k]}",
            )
        ]

    def _at_fresh_v(self, u: np.ndarray, image: np.ndarray) -> list[Check]:
        """The round trip that starts from a sample and fresh numbers v, as a jump does."""
        if image.shape[1] == self.d:
            return []
        v = np.random.default_rng(self.seed + 1).permutation(u[:, : image.shape[1] - self.d])
        fresh = np.column_stack([image[:, : self.d], v]).astype(self.dtype)
        at, log_det, _ = self.inverse(fresh)
        there, log_det_there, jacobian, slope = self.forward(at)
        points = Points(at, condition_number(jacobian, slope, log_det_there))

        def describe(k: int) -> str:
            return (
                f"x = {self._x(fresh[k])}, v = {numbers(v[k])}: u = {numbers(at[k])}, log_det = {log_det[k]}; forward "
                f"gives x = {self._x(there[k])}, v = {numbers(there[k, self.d :])}, log_det = {log_det_there[k]}"
            )

        equation = "forward(inverse(x, v)) = (x, v) at a fresh v"
        return [
            compare(equation, points, lambda p, _: self.forward(p)[0], fresh, describe=describe),
            compare(
                "inverse's log_det = -forward's at a fresh v",
                points,
                lambda p, _: self.forward(p)[1],
                -log_det,
                describe=describe,
            ),
        ]

    def _density(self, at: Points, log_det: np.ndarray, log_prob: np.ndarray) -> Check:
        """log_prob against the determinant: pointwise, or else its integral over v at a few dozen of the points."""

        def describe(k: int) -> str:
            return f"x = {self._x(at.values[k])}, v = {numbers(at.values[k, self.d :])}: {log_prob[k]} and {log_det[k]}"

        pointwise = compare(
            "log_prob(x) = log|det du/d(x, v)|, pointwise",
            at,
            lambda p, _: self.inverse(p)[2],
            log_det,
            describe=describe,
        )
        k = at.values.shape[1] - self.d
        if pointwise.passed or k == 0:
            return pointwise
        v = qmc.Sobol(k, rng=self.seed).random(_V_POINTS)
        # Some points as they come, and those where the two differ most: a mistake in one place is looked at there.
        differ = np.nan_to_num(np.abs(np.where(at.regular, log_prob, 0) - np.where(at.regular, log_det, 0)))
        rows = np.concatenate([np.arange(32), np.argsort(-differ)[:32]])
        x = at.values[rows, : self.d]
        image = np.column_stack([np.repeat(x, _V_POINTS, axis=0), np.tile(v, (len(x), 1))])
        over_v = np.exp(self.inverse(image)[1].astype(np.float64)).reshape(len(x), -1)
        averages = over_v.reshape(len(x), 4, -1).mean(2)
        p = np.exp(log_prob[rows].astype(np.float64))
        error = np.abs(averages.mean(1) - p)
        # The four quarters of the points tell how far an average can be off; where nothing varies, nothing can be.
        varies = np.ptp(over_v, axis=1) > 1e-4 * p
        quadrature = 6 * averages.std(1, ddof=1) / 2 + 1e-3 * p
        tolerance = np.where(varies, quadrature, at.tolerance[rows] * np.maximum(p, 1))
        tolerance = np.where(at.regular[rows], tolerance, np.inf)
        worst = int(np.argmax(error / tolerance))
        return Check(
            "p(x) = integral over v of |det du/d(x, v)|",
            bool(error[worst] <= tolerance[worst]),
            len(x),
            float(error[worst]),
            float(tolerance[worst]),
            f"x = {self._x(x[worst])}: p = {p[worst]}, the integral {averages[worst].mean()}",
            "the determinant depends on v, so it is not the density pointwise; moves use it, weights use log_prob",
        )


class _Forward(eqx.Module):
    technique: Technique

    def __call__(self, u: Float[Array, " m"]) -> tuple[Array, Scalar, Array, Array]:
        def flat(u: Float[Array, " m"]) -> tuple[Array, Scalar]:
            x, v, log_det = self.technique.forward(u)
            return jnp.concatenate([jnp.ravel(x), v]), log_det

        return *flat(u), *jax.jacfwd(flat)(u)


class _Inverse(eqx.Module):
    technique: Technique
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, image: Float[Array, " m"]) -> tuple[Array, Scalar, Scalar]:
        d = int(np.prod(self.shape))
        x = image[:d].reshape(self.shape)
        return *self.technique.inverse(x, image[d:]), self.technique.log_prob(x)


class _Density(eqx.Module):
    technique: Technique
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, x: Float[Array, " d"]) -> Scalar:
        return jnp.exp(self.technique.log_prob(x.reshape(self.shape)))


@quickly
def _over(function: Callable, points: Float[Array, "n m"]) -> Any:
    return jax.vmap(function)(points)


def _integral(technique: Technique) -> Check:
    """The integral of the density over the support, in float64."""
    shape = sample_shape(technique)
    lower, upper = (np.atleast_1d(np.asarray(corner, np.float64)) for corner in technique.support)
    breaks = [np.array([b]) for b in technique.breaks] if shape == () else []
    value, error = integrate_box(_Density(technique, shape), lower, upper, breaks)
    tolerance = min(max(1e-9, 3 * error), 1e-2)
    where = f"the integral of exp(log_prob) over the support {technique.support} is {value}"
    return Check("the integral of p is 1", abs(value - 1) <= tolerance, 1, abs(value - 1), tolerance, where)
