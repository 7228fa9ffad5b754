"""The contract of a move, checked at machine precision for the very code that runs in production."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.metropolis import acceptance
from mcmc1d.moves import Move, Proposal
from mcmc1d.numerics import cast
from mcmc1d.state import Eval, Multiplexed, State
from mcmc1d.targets import GaussianMixture
from mcmc1d.techniques import Mixture, PiecewiseConstant, Ramp, Tent
from mcmc1d.types import Array, Float, Int, Real, Scalar
from mcmc1d.verify.compare import Points, compare, condition_number, log_abs_det, quickly
from mcmc1d.verify.points import cube_points
from mcmc1d.verify.report import Check, Report, numbers


def hard_target() -> Multiplexed:
    """Where moves are checked unless a target is given: nothing symmetric, mass at the walls, three techniques.

    A tent (zero density at both ends), a step and a mixture with a spare dimension, so that log-determinants vary.
    """
    return Multiplexed(
        GaussianMixture([-0.02, 0.45, 1.0], [0.08, 0.05, 0.12], [0.5, 0.2, 0.3]),
        (
            Tent(0.4),
            PiecewiseConstant([0, 0.5, 1], [1.6, 0.4]),
            Mixture((Tent(0.7), Ramp(1.5)), (0.3, 0.7)),
        ),
    )


def check_move(
    move: Move,
    target: Multiplexed | None = None,
    *,
    points: int = 10_000,
    seed: int = 0,
    dtypes: Sequence[Any] = (np.float64, np.float32),
) -> Report:
    """Hold a move to its contract on a target, in each precision, at random states and numbers and at the edges.

    That it is an involution of (index, u, w); its log-determinant against autodiff; that the log-determinant of the
    way back is minus that of the way forth; that what it says of its proposal's `eval` is what an evaluation finds;
    that a proposal outside the unit cube is not accepted; and that it moves at all. Tolerances as `check_technique`.

    The target is `hard_target()` unless given. Returns a `Report`, false where a check failed. Raises `ValueError`
    where the move does not fit the target.
    """
    target = hard_target() if target is None else target
    move.check(target)
    checks = []
    with jax.enable_x64(True):
        for dtype in map(np.dtype, dtypes):
            contract = _Contract(cast(move, dtype), cast(target, dtype), dtype, seed)
            checks += [replace(check, equation=f"{dtype}: {check.equation}") for check in contract.checks(points)]
    return Report(f"move {type(move).__name__} on {type(target.target).__name__}", checks)


class _Contract:
    """A move on a target in one precision."""

    def __init__(self, move: Move, target: Multiplexed, dtype: np.dtype, seed: int):
        self.twice, self.dtype, self.seed = _Twice(move, target), dtype, seed
        self.m, self.r = target.dim_u, move.dim_w(target)

    def checks(self, count: int) -> list[Check]:
        uw = cube_points(self.m + self.r, count, self.seed, self.dtype)
        n = self.twice.target.n_techniques
        index = np.random.default_rng(self.seed + 2).integers(n, size=len(uw), dtype=np.int32)

        def at(points: np.ndarray, rows: np.ndarray) -> _Outcome:
            return jax.tree.map(np.asarray, _over(self.twice, jnp.asarray(index[rows]), jnp.asarray(points)))

        out = at(uw, np.arange(len(uw)))
        # A move looks at x, f and p at both ends: where they are steep, its own rounding is amplified likewise.
        steepness = np.where(np.isfinite(out.sensitivity), out.sensitivity, np.inf)
        points = Points(uw, np.maximum(condition_number(out.jacobian, out.slope, out.log_det), steepness))
        inside = ((out.uw >= 0) & (out.uw < 1)).all(1) & (out.index >= 0) & (out.index < n)
        possible = inside & np.isfinite(out.log_det)

        def describe(k: int) -> str:
            def state(i: np.ndarray, p: np.ndarray) -> str:
                return f"(index {i[k]}, u {numbers(p[k, : self.m])}, w {numbers(p[k, self.m :])})"

            return (
                f"{state(index, uw)} -> {state(out.index, out.uw)} with log_det {out.log_det[k]}, autodiff "
                f"{log_abs_det(out.jacobian[k : k + 1])[0]}; and back to {state(out.index_back, out.uw_back)} with "
                f"log_det {out.log_det_back[k]}"
            )

        left_out = int((~possible | ~points.regular).sum())
        checks = [
            self._alive(out, possible & points.regular, count, uw),
            compare(
                "applied twice, the identity on (index, u, w)",
                points,
                lambda p, rows: _back(at(p, rows)),
                (index, uw),
                possible,
                describe,
                f"{left_out} points left out: the proposal is impossible or a derivative infinite" if left_out else "",
            ),
            compare(
                "log_det = log|det d(u', w')/d(u, w)| by autodiff",
                points,
                lambda p, rows: at(p, rows).log_det,
                log_abs_det(out.jacobian),
                possible,
                describe,
            ),
            compare(
                "log_det of the way back = -log_det",
                points,
                lambda p, rows: at(p, rows).log_det_back,
                -out.log_det,
                possible,
                describe,
            ),
            self._impossible(out, ~inside | np.isnan(out.log_det) | np.isneginf(out.log_det), uw),
        ]
        if out.kept is not None:
            equation = "the proposal's eval = an evaluation of it"
            checks.append(compare(equation, points, lambda p, rows: at(p, rows).found, out.kept, possible, describe))
        return checks

    def _alive(self, out: "_Outcome", regular: np.ndarray, count: int, uw: np.ndarray) -> Check:
        moved = (out.uw[:, : self.m] != uw[:, : self.m]).any(1) | (out.index != out.index_back)  # back is home
        fires = moved & (out.acceptance > 0) & regular
        return Check(
            "it proposes other states, and some are accepted",
            bool(fires[:count].any() and regular[:count].mean() > 0.01),
            count,
            float(1 - fires[:count].mean()),
            1.0,
            f"{int(fires[:count].sum())} of {count} random points",
        )

    def _impossible(self, out: "_Outcome", impossible: np.ndarray, uw: np.ndarray) -> Check:
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


class _Outcome(eqx.Module):
    """A proposal, the proposal from there, and the derivatives."""

    index: Int[Real, ""]
    uw: Float[Real, " d"]
    log_det: Scalar
    acceptance: Scalar
    index_back: Int[Real, ""]
    uw_back: Float[Real, " d"]
    log_det_back: Scalar
    jacobian: Float[Real, "d d"]
    slope: Float[Real, " d"]
    kept: Eval | None
    """What the move says of its proposal; None where it leaves the evaluation to the kernel."""
    found: Eval
    """What an evaluation finds there."""
    sensitivity: Scalar
    """The largest derivative with respect to u of what an evaluation finds, at either end."""


class _Twice(eqx.Module):
    """A move applied to (index, u, w), and again to what comes out, as production code applies it."""

    move: Move
    target: Multiplexed

    def __call__(self, index: Int[Array, ""], uw: Float[Array, " d"]) -> _Outcome:
        def apply(uw: Float[Array, " d"]) -> tuple[Any, Any]:
            here = self.target.evaluate(State(index, uw[: self.target.dim_u]))
            first = self._propose(here, uw)
            known = State(jnp.asarray(first.state.index, jnp.int32), first.state.u, first.state.eval)
            there = self.target.evaluate(known)
            second = self._propose(there, _flat(first))
            found = self.target.evaluate(State(known.index, known.u)).seen
            a = acceptance(here, Proposal(there, first.w, first.log_det))
            differentiated = (_flat(first), jnp.asarray(first.log_det), here.seen)
            return differentiated, (*differentiated[:2], known, a, second, found)

        (jacobian, slope, slopes), aux = jax.jacfwd(apply, has_aux=True)(uw)
        out, log_det, known, a, second, found = aux
        slopes = (slopes, jax.jacfwd(lambda u: self.target.evaluate(State(known.index, u)).seen)(known.u))
        steepest = [jnp.max(jnp.abs(leaf), initial=0) for leaf in jax.tree.leaves(slopes)]
        return _Outcome(
            index=known.index,
            uw=out,
            log_det=log_det,
            acceptance=a,
            index_back=jnp.asarray(second.state.index, jnp.int32),
            uw_back=_flat(second),
            log_det_back=jnp.asarray(second.log_det),
            jacobian=jacobian,
            slope=slope,
            kept=known.eval,
            found=found,
            sensitivity=jnp.max(jnp.stack(steepest)),
        )

    def _propose(self, state: State, uw: Float[Array, " d"]) -> Proposal:
        proposal = self.move.propose(self.target, state, uw[self.target.dim_u :])
        if proposal.w.shape != (uw.shape[0] - self.target.dim_u,) or proposal.state.u.shape != state.u.shape:
            raise ValueError(
                f"{type(self.move).__name__}.propose must return u' of shape {state.u.shape} and w' of shape "
                f"{(uw.shape[0] - self.target.dim_u,)}, not {proposal.state.u.shape} and {proposal.w.shape}"
            )
        return proposal


def _flat(proposal: Proposal) -> Float[Array, " d"]:
    return jnp.concatenate([proposal.state.u, proposal.w])


def _back(out: _Outcome) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(out.index_back), np.asarray(out.uw_back)


@quickly
def _over(twice: _Twice, index: Int[Array, " n"], points: Float[Array, "n d"]) -> _Outcome:
    return jax.vmap(twice)(index, points)
