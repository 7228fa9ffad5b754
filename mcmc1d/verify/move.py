"""The contract of a move, checked at machine precision for the very code that runs in production."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require_instance, require_whole
from mcmc1d.moves import Move
from mcmc1d.numerics import cast
from mcmc1d.outside import forget_what_has_changed
from mcmc1d.state import Multiplexed
from mcmc1d.targets.gaussian_mixture import walls_and_valley
from mcmc1d.techniques import Mixture, PiecewiseConstant, PiecewiseLinear, Ramp, Tent
from mcmc1d.verify.compare import Points, compare, condition_number, log_abs_det, steepness
from mcmc1d.verify.contract import Check, ContractReport, numbers
from mcmc1d.verify.points import cube_points
from mcmc1d.verify.twice import Outcome, over

_LARGEST_TOLERANCE = 1e-3
_LEFT_OUT = 0.01


def hard_target() -> Multiplexed:
    """Where moves are checked unless a target is given: nothing symmetric, mass at the walls, three techniques.

    A tent (zero density at both ends), one that can not reach the target's inner mode (zero density around it), and a
    mixture of a step and a ramp with a spare dimension, so that log-determinants vary and some are infinite.
    """
    return Multiplexed(
        walls_and_valley(),
        (
            Tent(0.4),
            PiecewiseLinear([0, 0.35, 0.5, 1], [1.6, 0, 0, 1.1]),
            Mixture((PiecewiseConstant([0, 0.5, 1], [1.6, 0.4]), Ramp(1.5)), (0.3, 0.7)),
        ),
    )


def check_move(
    move: Move,
    target: Multiplexed | None = None,
    *,
    points: int = 10_000,
    seed: int = 0,
    dtypes: Sequence[Any] = (np.float64, np.float32),
) -> ContractReport:
    """Hold a move to its contract on a target, in each precision, at random states and numbers and at the edges.

    That it is an involution of (index, u, w); its log-determinant against autodiff; that the log-determinant of the
    way back is minus that of the way forth; that what it says of its proposal's `eval` is what an evaluation finds;
    that a proposal outside the unit cube is not accepted; and that it moves at all: a move that is the identity on
    this target (a technique change among one) fails, and is to be checked on a target where it is not. Tolerances as
    `check_technique`, and 1e-3 at most; no more than 1 % of the random points that may be accepted are left out.

    The target is `hard_target()` unless given. Returns a `ContractReport`, false where a check failed. Raises
    `ValueError` where the move does not fit the target.
    """
    forget_what_has_changed(move, target)
    require_instance(move, Move, "check_move: the move")
    require_whole(points, "check_move: points")
    target = hard_target() if target is None else target
    require_instance(target, Multiplexed, "check_move: the target", "; wrap it: Multiplexed(target, techniques)")
    move.check(target)
    checks = []
    with jax.enable_x64(True):
        for dtype in map(np.dtype, dtypes):
            contract = _Contract(cast(move, dtype), cast(target, dtype), dtype, seed)
            checks += [replace(check, equation=f"{dtype}: {check.equation}") for check in contract.checks(points)]
    return ContractReport(f"move {type(move).__name__} on {type(target.target).__name__}", checks)


class _Contract:
    """A move on a target in one precision."""

    def __init__(self, move: Move, target: Multiplexed, dtype: np.dtype, seed: int):
        self.move, self.target, self.dtype, self.seed = move, target, dtype, seed
        self.m, self.r = target.dim_u, move.dim_w(target)

    def checks(self, count: int) -> list[Check]:
        uw = cube_points(self.m + self.r, count, self.seed, self.dtype)
        n = self.target.n_techniques
        index = np.random.default_rng(self.seed + 2).integers(n, size=len(uw), dtype=np.int32)

        def at(points: np.ndarray, rows: np.ndarray) -> Outcome:
            return jax.tree.map(np.asarray, over(self.move, self.target, jnp.asarray(index[rows]), jnp.asarray(points)))

        out = at(uw, np.arange(len(uw)))
        condition = condition_number(out.jacobian, out.slope, out.log_det)
        # Densities are looked up at x, whose last bits are felt where they are steep: four roundings, as a technique.
        rounding = 4 * np.finfo(self.dtype).eps
        felt = rounding * np.where(np.isfinite(out.felt), out.felt, 0)
        image = np.abs(np.where(np.isfinite(out.uw), out.uw, 0))
        # Autodiff's own: what is made of 1 - u' has the digits of that, as the derivative s (1 - s) of a sigmoid.
        near_one = 1 / np.maximum(1 - np.minimum(image, 1), np.finfo(self.dtype).epsneg)
        bits = rounding * (steepness(out.jacobian, out.slope) * image + near_one).sum(1)
        points = Points(uw, condition, rounding=felt, cap=_LARGEST_TOLERANCE, last_bits=bits)
        inside = ((out.uw >= 0) & (out.uw < 1)).all(1) & (out.index >= 0) & (out.index < n)
        proposed = inside & np.isfinite(out.log_det)
        # From where the target is zero a move may get away as it likes: no chain comes there.
        possible = proposed & out.lit

        def describe(k: int) -> str:
            def state(i: np.ndarray, p: np.ndarray) -> str:
                return f"(index {i[k]}, u {numbers(p[k, : self.m])}, w {numbers(p[k, self.m :])})"

            return (
                f"{state(index, uw)} -> {state(out.index, out.uw)} with log_det {out.log_det[k]}, autodiff "
                f"{log_abs_det(out.jacobian[k : k + 1])[0]}; and back to {state(out.index_back, out.uw_back)} with "
                f"log_det {out.log_det_back[k]}"
            )

        twice = "applied twice, the identity on (index, u, w)"
        determinant = "log_det = log|det d(u', w')/d(u, w)| by autodiff"
        back = "log_det of the way back = -log_det"
        both = (possible, describe)
        checks = [
            self._alive(out, proposed & points.regular, index[:count], uw[:count]),
            self._looked_at(out, proposed & points.regular, uw[:count]),
            compare(
                twice,
                points,
                lambda p, rows: _back(at(p, rows)),
                (index, uw),
                *both,
                anew=lambda p, rows: (index[rows], p),
            ),
            compare(
                determinant,
                points,
                lambda p, rows: at(p, rows).log_det,
                log_abs_det(out.jacobian),
                *both,
                anew=lambda p, rows: log_abs_det(at(p, rows).jacobian),
            ),
            compare(
                back,
                points,
                lambda p, rows: at(p, rows).log_det_back,
                -out.log_det,
                *both,
                anew=lambda p, rows: -at(p, rows).log_det,
            ),
            self._impossible(out, ~inside | np.isnan(out.log_det) | np.isneginf(out.log_det), uw),
        ]
        if out.kept is not None:
            # What is evaluated is x, f and p: where they are steep, the proposal's own rounding is amplified likewise.
            steep = np.where(np.isfinite(out.sensitivity), out.sensitivity, np.inf)
            where = Points(uw, np.maximum(condition, steep), rounding=felt, cap=_LARGEST_TOLERANCE)
            equation = "the proposal's eval = an evaluation of it"
            # Both sides change at a neighbour: where a light's end is met at a grazing angle, by orders of magnitude.
            checks.append(
                compare(
                    equation,
                    where,
                    lambda p, rows: at(p, rows).found,
                    out.kept,
                    *both,
                    anew=lambda p, rows: at(p, rows).kept,
                )
            )
        return checks

    def _alive(self, out: "Outcome", regular: np.ndarray, index: np.ndarray, uw: np.ndarray) -> Check:
        """At the random points: that the chain may get elsewhere."""
        n = len(uw)
        moved = (out.uw[:n, : self.m] != uw[:, : self.m]).any(1) | (out.index[:n] != index)
        fires = moved & (out.acceptance[:n] > 0) & regular[:n]
        return Check(
            "it proposes other states, and some are accepted",
            bool(fires.any() and regular[:n].mean() > 0.01),
            n,
            float(1 - fires.mean()),
            1.0,
            f"{int(fires.sum())} of {n} random points; a move that is the identity on this target by its nature is to "
            "be checked on one where it is not: give `target`",
        )

    def _looked_at(self, out: "Outcome", regular: np.ndarray, uw: np.ndarray) -> Check:
        """Of the random points that may be accepted, the share that the equations below can not be held to."""
        n = len(uw)
        matter = (out.acceptance[:n] > 0) & out.lit[:n]
        left_out = matter & ~regular[:n]
        share = left_out.sum() / max(1, matter.sum())
        k = int(np.argmax(left_out))
        return Check(
            "at most 1 % of what may be accepted is left out: a derivative infinite, or all digits lost",
            bool(share <= _LEFT_OUT),
            int(matter.sum()),
            float(share),
            _LEFT_OUT,
            f"(u, w) = {numbers(uw[k])} -> {numbers(out.uw[k])}, log_det {out.log_det[k]}",
        )

    def _impossible(self, out: "Outcome", impossible: np.ndarray, uw: np.ndarray) -> Check:
        wrong = impossible & (out.acceptance > 0) | np.isnan(out.acceptance)
        k = int(np.argmax(wrong))
        return Check(
            "what leaves the unit cube, or has a log_det of -inf or NaN, is not accepted",
            not wrong.any(),
            int(impossible.sum()),
            float(out.acceptance[k]) if wrong.any() else 0.0,
            0.0,
            f"(u, w) = {numbers(uw[k])} -> {numbers(out.uw[k])}, log_det {out.log_det[k]}",
        )


def _back(out: Outcome) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(out.index_back), np.asarray(out.uw_back)
