"""Where a law contradicts itself, or its own draws: then no kernel is to blame, and there is no verdict."""

from collections.abc import Callable, Mapping, Sequence

import jax
import numpy as np

from mcmc1d.checks import require
from mcmc1d.verify.battery import Test, coordinates
from mcmc1d.verify.ends import varies
from mcmc1d.verify.forgetting import point
from mcmc1d.verify.law import Law, LawError
from mcmc1d.verify.sampler import Tally
from mcmc1d.verify.statistic import Position

_ATOM = 16  # draws that are one number: of a continuous law in float32 there are two or three
_ROUNDED = 0.01  # of the draws, which may lie where the density rounds to zero
_CELLS, _FEWEST = 1024, 64  # between draws, in which a density is held to a CDF
_APART = 0.05  # of the logarithms, in the median cell
_RULES = np.array([[2, 0, 8, 0, 2], [1, 4, 2, 4, 1]]) / 12  # Simpson's, in one cell and in its halves


def require_fit(law: Law, draws: Position) -> None:
    """Raise `ValueError` where `bins` or `bad_start` are not of positions like the draws."""
    if law.bins is not None:
        x = np.asarray(draws.get("x", ()) if isinstance(draws, dict) else draws)
        require(
            x.size == len(jax.tree.leaves(draws)[0]),
            f"{law.name}: bins= is for positions on the line, one array of shape (n,), not {_shapes(draws)}; what is "
            "known of others are statistics, such as verify.Discrete(cell, masses, ordered=True)",
        )
    if law.bad_start is None:
        return
    try:
        alike = jax.tree.map(lambda a, b: np.shape(b) == a.shape[1:] and np.all(np.isfinite(b)), draws, law.bad_start)
    except (ValueError, TypeError):
        alike = False
    require(
        all(jax.tree.leaves(alike)),
        f"{law.name}: bad_start={law.bad_start!r} must be one finite position, of the shapes that a draw has, "
        f"{_shapes(draws)} without the leading axis",
    )


def _shapes(tree: Position) -> str:
    return str(jax.tree.map(np.shape, tree))


def require_random(law: Law, draws: Position, again: Position) -> None:
    """Raise `LawError` where the sampler does not look at its generator: its draws would count many times."""
    one, two = coordinates(draws), coordinates(again)
    if any(varies(values) for values in one.values()) and all(np.array_equal(one[name], two[name]) for name in one):
        raise LawError(
            f"{law.name}: sample(rng, n) gives the same draws whatever rng is; draw them from the generator (a JAX key "
            "from rng.integers(2**32))"
        )


def require_density(law: Law, draws: Position, log_density: np.ndarray) -> None:
    """Raise `LawError` where the density is not finite, or zero, at draws; at a few it may round to zero."""
    zero = np.isneginf(log_density)
    bad = np.isnan(log_density) | np.isposinf(log_density) | (zero & (zero.mean() > _ROUNDED))
    if bad.any():
        at = point(coordinates(draws), int(np.argmax(bad)))
        raise LawError(f"{law.name}: its log_density is {log_density[bad][0]} at its own draw {at}")


def require_one_density(law: Law, draws: Position, log_density: Callable[[Position], np.ndarray]) -> None:
    """Raise `LawError` where, on the line, the density is grossly another than the CDF's: kernels are given the one.

    Between neighbours of many draws the CDF's rise is held to Simpson's rule for the density, up to a constant. A
    twentieth in half of the law is far from what a cell's width, rounding, a pole or a wall makes (1e-3 was the most
    seen, at gamma and beta laws of shape 0.002 and 0.05); less is not looked for, and nothing where two rules, of three
    and of five points, say that the cells do not resolve the density.
    """
    if law.cdf is None or law.auxiliary or not hasattr(draws, "shape") or draws.size != len(draws):
        return
    x = np.unique(np.asarray(draws, np.float64))
    if np.all(x == np.round(x)):
        return  # of whole numbers no density is known
    x = x[:: max(1, len(x) // _CELLS)].reshape(-1, *draws.shape[1:])
    rise, width = (np.diff(np.ravel(part)) for part in (np.asarray(law.cdf(x), np.float64), x))
    places = [x[:-1] + share * (x[1:] - x[:-1]) for share in (0, 0.25, 0.5, 0.75, 1)]
    at = np.stack([np.asarray(log_density(place), np.float64) for place in places])
    with np.errstate(all="ignore"):
        three, five = (at[2] + np.log(rule @ np.exp(at - at[2])) for rule in _RULES)
        apart = np.log(rise / width) - five
    known = np.isfinite(apart) & np.isfinite(three)
    if known.sum() < _FEWEST or np.median(np.abs(three[known] - five[known])) > _APART / 10:
        return
    apart = apart[known]
    off = float(np.median(np.abs(apart - np.median(apart))))
    if off > _APART:
        raise LawError(
            f"{law.name}: its log_density is not that of its cdf: over half of the law they are apart by a factor of "
            f"{np.exp(off):.3g} or more, beside a constant one; mend the one or the other"
        )


def require_cells(law: Law, tests: Sequence[Test], tally: Tally) -> None:
    """Raise `LawError` where one of the draws is in no cell of what is known of the law."""
    for (steps, k), counts in tally.counts.items():
        if steps == 0 and counts[0][-1]:
            raise LawError(
                f"{law.name}: {counts[0][-1]} of {tally.n} of its own draws are in no cell of {tests[k].name}, which "
                "has no probability for them; give the tails to the end cells"
            )


def require_alike(
    law: Law,
    tests: Sequence[Test],
    tally: Tally,
    p_values: Mapping[tuple[int, int], float],
    threshold: float,
    draws: Position,
) -> None:
    """Raise `LawError` where the tallied draws do not have what is known of the law, at a p-value of `threshold`.

    `draws`: some of them, which may say why.
    """
    own = {key: p for key, p in p_values.items() if key[0] == 0}
    if min(own.values(), default=1.0) > threshold:
        return
    worst = min(own, key=lambda key: own[key])
    test = tests[worst[1]]
    mend = "Mend the sampler, the cdf, bins or masses"
    if law.auxiliary:  # those of a chain's target, which a user has not written
        mend = "A technique's log_prob, or the target's bin_masses, is wrong: check_technique tells which"
    coarse = _coarse(draws)
    columns = coordinates(draws).values()
    if not coarse and all(varies(values) and np.all(values == np.round(values)) for values in columns):
        mend += "; the draws are whole numbers, whose law is given as a verify.Discrete"
    raise LawError(
        f"{law.name}: its sampler and its exact law of {test.name} disagree (p = {own[worst]:.1e} from {tally.n} "
        f"draws): {'; '.join(test.worst(tally.counts[worst], 3))}. {mend}{coarse or _atoms(draws)}"
    )


def _coarse(draws: Position) -> str:
    """A word on draws so far from zero that their floats are coarse."""
    for name, values in coordinates(draws).items():
        if values.dtype == np.float32 and varies(values):
            step, middle = float(np.spacing(np.abs(values).max())), np.ptp(np.quantile(values, [0.25, 0.75]))
            # Half of them may be one number: an atom, or, where all are a few steps apart, rounding.
            if step > 1e-4 * middle > 0 or np.ptp(values) < _ATOM * step:
                return f"; in float32 {name} has steps of {step:.2g}: verify it with jax.enable_x64(True)"
    return ""


def _atoms(draws: Position) -> str:
    """A word on draws that are the same number."""
    for name, values in coordinates(draws).items():
        numbers, counts = np.unique(values, return_counts=True)
        if np.issubdtype(values.dtype, np.floating) and counts.max() >= _ATOM:
            return (
                f"; {counts.max()} of {values.size} draws are {name} = {numbers[np.argmax(counts)]:.6g}: where that is "
                "rounding, verify it with jax.enable_x64(True); where the law has an atom, say so by `statistics`, for "
                "a cdf is of a continuous law"
            )
    return ""
