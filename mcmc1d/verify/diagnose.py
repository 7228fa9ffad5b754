"""Which move of a failing kernel breaks detailed balance, and between which states."""

from collections.abc import Sequence

import numpy as np

from mcmc1d.metropolis import Cycle
from mcmc1d.verify.goodness import sign_p_value
from mcmc1d.verify.library import LibrarySubject
from mcmc1d.verify.statistic import Position

_CELLS = 8


def diagnose(subject: LibrarySubject, seed: Sequence[int], start: Position) -> list[str]:
    """For each kind of move, the pair of (technique, x) cells whose flows in one step differ most.

    Stationary chains of a reversible move go from a to b as often as from b to a. The p-values are exact, and no part
    of the verdict. The kernels of a cycle are looked at one by one, each from the exact draws.
    """
    kernel = subject.kernel
    if isinstance(kernel, Cycle):
        parts = [LibrarySubject(part, subject.target, None) for part in kernel.kernels]
        return [line for k, part in enumerate(parts) for line in diagnose(part, (*seed, k), start)]
    after, kind = subject.kinds(seed, 0, start)
    a, b, label = _cells(start, after)
    cells, lines = int(max(a.max(), b.max())) + 1, []
    for k, name in enumerate(kernel.kinds):
        own = kind == k
        if not own.any():
            lines.append(f"move {name}: never proposed")
            continue
        flow = np.bincount(a[own] * cells + b[own], minlength=cells * cells).reshape(cells, cells)
        upper = np.triu_indices(cells, 1)
        p = sign_p_value(flow[upper], flow.T[upper])
        z = (flow - flow.T) / np.sqrt(np.maximum(flow + flow.T, 1))
        i, j = np.unravel_index(np.argmax(np.triu(np.abs(z), 1)), z.shape)
        verdict = "breaks detailed balance" if p < 1e-6 else "no violation seen"
        worst = f": {flow[i, j]} from {label(i)} to {label(j)}, {flow[j, i]} back" if p < 1e-6 else ""
        lines.append(f"move {name}: {verdict} (p = {p:.1e}){worst}")
    return lines


def _cells(start: Position, after: Position):
    """Cells of (technique, x), or of the first coordinate of x, before and after one step, and their names."""
    first, last = (np.asarray(p["x"]).reshape(len(p["index"]), -1)[:, 0] for p in (start, after))
    ends = np.unique(np.quantile(first, np.arange(1, _CELLS) / _CELLS))
    width = len(ends) + 1

    def cell(index: np.ndarray, x: np.ndarray) -> np.ndarray:
        # A wrong kernel may have left every technique.
        return np.maximum(index, 0) * width + np.searchsorted(ends, x, side="right")

    def label(k: np.integer) -> str:
        index, b = divmod(int(k), width)
        around = np.concatenate([[-np.inf], ends, [np.inf]])
        return f"(technique {index}, x in [{around[b]:.3g}, {around[b + 1]:.3g}])"

    return cell(start["index"], first), cell(after["index"], last), label
