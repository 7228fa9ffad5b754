"""The contract of a technique, checked at machine precision for the very code that runs in production."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from mcmc1d.checks import require, require_instance, require_whole
from mcmc1d.numerics import cast
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.techniques import Family, Technique
from mcmc1d.verify.compare import Points, compare, condition_number, directions, log_abs_det, steepness
from mcmc1d.verify.contract import Check, ContractReport, numbers
from mcmc1d.verify.density import integral, linear, outside, over_v, unreached
from mcmc1d.verify.maps import Maps
from mcmc1d.verify.points import cube_points


def check_technique(
    technique: Technique,
    *,
    points: int = 10_000,
    seed: int = 0,
    dtypes: Sequence[Any] = (np.float64, np.float32),
) -> ContractReport:
    """Hold a technique to its contract, in each precision, at random points and at the edges of the unit cube.

    Both round trips (the second with the x of one point and the v of another, as a jump has them); `forward`'s
    log-determinant against autodiff; `inverse`'s against `forward`'s; `log_prob` against the determinant, pointwise
    or integrated over v; `prob`, where it is defined, against `log_prob`; that both densities are none outside
    `support`, or in a box of several dimensions where no sample comes to; the integral over `support`; and that
    nothing leaves the unit cube. The tolerance is 1e-10 (2e-5 in
    float32) times the point's condition number, and what four roundings of x do to the log-determinant. Where a
    derivative is infinite, the report says so and the log-determinant's limit is checked instead. Under an infinite
    support x may be infinite where the density is zero.

    Returns a `ContractReport`, false where a check failed: its text names the broken equation, the worst point and both
    sides there. `report.raise_if_failed()` is for tests. Raises `ValueError` where the technique is not a map
    between spaces of one dimension.
    """
    several = isinstance(technique, Family)
    require_instance(
        technique, Technique, "check_technique: the technique", "; check each of its .members" if several else ""
    )
    require_whole(points, "check_technique: points")
    forget_what_has_changed(technique)
    checks = []
    with jax.enable_x64(True):
        for dtype in map(np.dtype, dtypes):
            require(dtype in (np.float32, np.float64), f"check_technique: dtypes are float32 and float64, not {dtype}")
            found = _Contract(cast(technique, dtype), dtype, seed).checks(points)
            checks += [replace(check, equation=f"{dtype}: {check.equation}") for check in found]
        checks.append(integral(technique))
    return ContractReport(f"technique {type(technique).__name__}", checks)


class _Contract:
    """A technique in one precision."""

    def __init__(self, technique: Technique, dtype: np.dtype, seed: int):
        self.maps, self.seed = Maps(technique, dtype), seed
        self.technique, self.dtype, self.d = technique, dtype, self.maps.d

    def checks(self, count: int) -> list[Check]:
        m = self.technique.dim_u
        u = cube_points(m, count, self.seed, self.dtype, self._edges())
        image, log_det, jacobian, slope = self.maps.forward(u)
        condition = condition_number(jacobian, slope, log_det)
        at_u = Points(u, condition, rounding=self._felt(jacobian, slope, image))
        at_image = Points(image, condition, free=self.d)
        back, log_det_back, log_prob = self.maps.inverse(image)

        def at(k: int) -> str:
            return (
                f"u = {numbers(u[k])}: x = {self.maps.x(image[k])}, v = {numbers(image[k, self.d :])}, "
                f"log_det = {log_det[k]}, autodiff {log_abs_det(jacobian[k : k + 1])[0]}; the inverse gives "
                f"u = {numbers(back[k])}, log_det = {log_det_back[k]}; log_prob = {log_prob[k]}"
            )

        singular = self._singular(at_u)
        return [
            self._cube(u, image, back, log_prob),
            self._regular(at_u, jacobian, count),
            compare("inverse(forward(u)) = u", at_image, lambda p, _: self.maps.inverse(p)[0], u, describe=at),
            compare(
                "forward's log_det = log|det d(x, v)/du| by autodiff",
                at_u,
                lambda p, _: self.maps.forward(p)[1],
                log_abs_det(jacobian),
                describe=at,
                note=singular,
            ),
            compare(
                "inverse's log_det = -forward's", at_image, lambda p, _: self.maps.inverse(p)[1], -log_det, describe=at
            ),
            *self._limits(at_u, log_det),
            *self._at_fresh_v(u, image),
            self._density(at_image, log_det_back, log_prob),
            outside(self.maps, image, self.seed),
            *unreached(self.maps, len(u), self.seed),
            *linear(self.maps, image),
        ]

    def _felt(self, jacobian: np.ndarray, slope: np.ndarray, image: np.ndarray) -> np.ndarray:
        """What the last bits of x and v do to a log-determinant that is computed from them, as next to a pole.

        Four roundings of each; that a constant is wrong shows at every other point.
        """
        size = np.abs(np.where(np.isfinite(image), image, 0))
        return 4 * np.finfo(self.dtype).eps * (steepness(jacobian, slope) * size).sum(1)

    def _edges(self) -> set[float]:
        """The numbers u at which the density's breaks are reached, from the technique's own inverse."""
        if self.maps.shape != () or not self.technique.breaks:
            return set()
        breaks = np.asarray(self.technique.breaks)[:: max(1, len(self.technique.breaks) // 64)]
        image = np.column_stack([breaks, np.full((len(breaks), self.technique.dim_u - 1), 0.5)])
        return set(np.unique(self.maps.inverse(image)[0]).tolist())

    def _cube(self, u: np.ndarray, image: np.ndarray, back: np.ndarray, log_prob: np.ndarray) -> Check:
        """Four conditions in one line; a failure says which of them broke, each with its first point."""
        x, v = image[:, : self.d], image[:, self.d :]
        lower, upper = self.maps.corners
        # Under infinite support u = 0 may well be x = -inf, if no state is ever accepted there: the density is zero.
        nowhere = np.isinf(x) & np.isinf(np.where(x > 0, upper, lower)) & np.isneginf(log_prob)[:, None]
        broken = {
            f"x must be finite and in {self.maps.support}": ~((x >= lower) & (x <= upper) & (np.isfinite(x) | nowhere)),
            "log_prob must be a number": np.isnan(log_prob)[:, None],
            "v must be in [0, 1)": ~((v >= 0) & (v < 1)),
            "the inverse's u must be in [0, 1)": ~((back >= 0) & (back < 1)),
        }
        bad = np.any([rows.any(1) for rows in broken.values()], axis=0)
        told = []
        for what, rows in broken.items():
            if rows.any():
                k = int(np.argmax(rows.any(1)))
                told.append(
                    f"u = {numbers(u[k])}: x = {self.maps.x(image[k])}, v = {numbers(v[k])}, log_prob = {log_prob[k]}, "
                    f"back to u = {numbers(back[k])}; {what}"
                )
        count = int(np.isinf(x).any(1).sum())
        note = f"x is infinite at {count} points, where the density is zero" if count and not bad.any() else ""
        return Check(
            "x is in the support and log_prob is a number; v and the inverse's u are in [0, 1)",
            not bad.any(),
            len(u),
            float(bad.mean()),
            0.0,
            "\n      and ".join(told),
            note,
        )

    def _regular(self, at_u: Points, jacobian: np.ndarray, count: int) -> Check:
        """A bijection may be singular at edges; at random points it is not."""
        singular = ~at_u.regular[:count] | np.isneginf(log_abs_det(jacobian))[:count]
        flat = (jacobian[:count] == 0).all(1).any(1)
        return Check(
            "the derivatives are finite and the map is invertible at random points",
            bool(singular.mean() <= 0.01),
            count,
            float(singular.mean()),
            0.01,
            f"u = {numbers(at_u.values[np.argmax(singular)])}",
            "autodiff finds no gradient through a bisection or a rounding: end with a Newton step, or jax.custom_jvp"
            if flat.mean() > 0.01
            else "",
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
        # A derivative beyond the largest float is none that is infinite.
        holds = np.isfinite(claimed) & (np.abs(claimed) > np.log(float(np.finfo(self.dtype).max)))
        eps = float(np.finfo(self.dtype).eps)
        one = np.ones((), self.dtype)
        for direction in directions(points.shape[1]):
            near = []
            for step in (eps**0.5, eps**0.75, eps**0.9):
                moved = np.clip(points + (step * direction).astype(self.dtype), 0, np.nextafter(one, 0 * one))
                near.append(self.maps.forward(np.resize(moved, at_u.values.shape))[1][: len(points)])
            # An infinite limit is approached by growing, a finite one by differences that shrink. Where another edge is
            # near, what grows may not have come to the sign of its limit: as a logarithm it grows steadily.
            infinite, sign = np.isinf(claimed), np.sign(claimed)
            with np.errstate(invalid="ignore"):
                first, second = sign * (near[1] - near[0]), sign * (near[2] - near[1])
            growing = (np.sign(near[2]) == sign) & (np.abs(near[2]) > np.abs(near[0]))
            growing |= (first > 0) & (second > first / 2)
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
        at, log_det, log_prob = self.maps.inverse(fresh)
        there, log_det_there, jacobian, slope = self.maps.forward(at)
        # At a pole of the density, which another lobe's x may round to, there is no way back from u; and none where the
        # density is zero, as at the rim of what is lit, to which a sample may round.
        nowhere = np.isposinf(log_det) | (np.isneginf(log_det) & np.isneginf(log_prob))
        condition = np.where(nowhere, np.inf, condition_number(jacobian, slope, log_det_there))
        points = Points(at, condition, rounding=self._felt(jacobian, slope, there))

        def describe(k: int) -> str:
            return (
                f"x = {self.maps.x(fresh[k])}, v = {numbers(v[k])}: u = {numbers(at[k])}, log_det = {log_det[k]}; "
                f"forward gives x = {self.maps.x(there[k])}, v = {numbers(there[k, self.d :])}, "
                f"log_det = {log_det_there[k]}"
            )

        equation = "forward(inverse(x, v)) = (x, v) at a fresh v"
        return [
            compare(equation, points, lambda p, _: self.maps.forward(p)[0], fresh, describe=describe),
            compare(
                "inverse's log_det = -forward's at a fresh v",
                points,
                lambda p, _: self.maps.forward(p)[1],
                -log_det,
                describe=describe,
            ),
        ]

    def _density(self, at: Points, log_det: np.ndarray, log_prob: np.ndarray) -> Check:
        """log_prob against the determinant: pointwise, or else its integral over v at a few dozen of the points."""

        def describe(k: int) -> str:
            x, v = self.maps.x(at.values[k]), numbers(at.values[k, self.d :])
            return f"x = {x}, v = {v}: {log_prob[k]} and {log_det[k]}"

        equation = "log_prob(x) = log|det du/d(x, v)|, pointwise"
        pointwise = compare(equation, at, lambda p, _: self.maps.inverse(p)[2], log_det, describe=describe)
        if pointwise.passed or at.values.shape[1] == self.d:
            return pointwise
        return over_v(self.maps, at, log_prob, self.seed)
