"""The finite chains of `adaptation`: a ring whose kernel's setting goes up and down with acceptance, as matrices."""

import numpy as np

from mcmc1d.verify import RingStep, enumerate_kernel, ring

VALUES = np.array([1, 3, 0.5, 2, 4, 0.2, 1])
"""The density of a ring of seven."""
LARGE = (0.1, 0.5, 0.9)
KINDS = ("step size", "large-step probability")


def accepted_or_not(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """(accepted, rejected) of every setting of what is adapted: the ring's matrices, (settings, n, n) each.

    From enumeration of this library's kernels. A step size is an offset of 1, 2 or 3 either way; a large step is
    uniform on the ring, and accepted where it leads nowhere.
    """
    n = len(VALUES)
    target, states = ring(VALUES)

    def matrix(move: RingStep) -> np.ndarray:
        return enumerate_kernel(move, target, states, probes=33).matrix

    off = 1 - np.eye(n)
    sizes = [matrix(RingStep(n, {k: 0.5, -k: 0.5})) for k in (1, 2, 3)]
    if kind == KINDS[0]:
        every, idle = sizes, [0.0] * len(sizes)
    else:
        large = matrix(RingStep(n, dict.fromkeys(range(n), 1 / n)))
        every, idle = [q * large + (1 - q) * sizes[0] for q in LARGE], [q / n for q in LARGE]
    accepted = np.stack([m * off + rest * np.eye(n) for m, rest in zip(every, idle, strict=True)])
    return accepted, np.stack(every) - accepted


def adaptive_chain(accepted: np.ndarray, rejected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The matrices on (setting, state): of a step after which the setting is adapted, and of one after which it stays.

    An accepted proposal raises the setting by one, a rejected one lowers it, as far as there are any.
    """
    settings, n = accepted.shape[:2]
    adapted, kept = np.zeros((settings, n, settings, n)), np.zeros((settings, n, settings, n))
    for s in range(settings):
        adapted[s, :, min(s + 1, settings - 1)] += accepted[s]
        adapted[s, :, max(s - 1, 0)] += rejected[s]
        kept[s, :, s] = accepted[s] + rejected[s]
    return adapted.reshape(settings * n, -1), kept.reshape(settings * n, -1)
