"""The exact references of `pss_sampler`: matrices, convolutions, enumerations."""

import numpy as np
import xarray as xr
from scipy.special import ndtr
from scipy.stats import multinomial, norm

from experiments.support.framework import Claim
from experiments.support.pss_sampler_law import G
from experiments.support.transitions import stationary
from experiments.support.verdict import verdict
from mcmc1d.verify.goodness import total_variation

BOOK = "Pharr, Jakob, Humphreys, sec. 16.4"


def steps_on_ring(n: int) -> np.ndarray:
    """Stay with probability 1/2, or go to either neighbour."""
    return 0.5 * np.eye(n) + 0.25 * (np.roll(np.eye(n), 1, axis=1) + np.roll(np.eye(n), -1, axis=1))


def lazy_chain(replay: str, large_step: float) -> tuple[np.ndarray, np.ndarray]:
    """(matrix, view): the lazy sampler on a space small enough to write down; a view says what is read in each state.

    A switch proposes, with probability 1/2 each, a state A that reads nothing (f = 1) or B that reads one number on a
    ring of four (f = G). States: (A, number, small steps missed: 0 to 63, when the number is uniform to 1e-18), and
    (B, number).
    """
    n, most = len(G), 64
    ring = steps_on_ring(n)
    powers = [np.linalg.matrix_power(ring, k) for k in range(most + 1)]

    def hidden(d: int, missed: int) -> int:
        return d * most + missed

    lit = n * most + np.arange(n)
    matrix, uniform, enter = np.zeros((n * most + n,) * 2), np.full(n, 1 / n), np.minimum(1, G)
    for d in range(n):
        for missed in range(most):
            here = hidden(d, missed)
            matrix[here, hidden(d, min(missed + 1, most - 1))] += (1 - large_step) / 2
            matrix[here, hidden(0, most - 1)] += large_step / 2
            for share, jump in ((1 - large_step, ring), (large_step, uniform + 0 * ring)):
                # Where the number is before the step that is proposed: a rejection leaves it there, or undoes it all.
                for now in range(n):
                    chance = share / 2 * powers[missed][d, now]
                    matrix[here, lit] += chance * jump[now] * enter
                    back = hidden(now, 0) if replay == "apart" else here
                    matrix[here, back] += chance * (1 - jump[now] @ enter)
        leave = min(1, 1 / G[d])
        matrix[lit[d], hidden(d, 1)] += (1 - large_step) / 2 * leave
        matrix[lit[d], hidden(0, most - 1)] += large_step / 2 * leave
        matrix[lit[d], lit[d]] += (1 - leave) / 2
        for share, jump in ((1 - large_step, ring[d]), (large_step, uniform)):
            taken = share / 2 * jump * np.minimum(1, G / G[d])
            matrix[lit[d], lit] += taken
            matrix[lit[d], lit[d]] += share / 2 - taken.sum()
    view = np.zeros((len(matrix), n + 1))
    view[: n * most, 0], view[lit, np.arange(1, n + 1)] = 1, 1
    return matrix, view


def eager_chain(large_step: float) -> tuple[np.ndarray, np.ndarray]:
    """The same with a sampler that moves the number in every step, read or not: states (A, number) and (B, number)."""
    n = len(G)
    ring = steps_on_ring(n)
    q = np.tile((1 - large_step) * ring + large_step / n, (2, 2)) / 2
    f = np.concatenate([np.ones(n), G])
    matrix = q * np.minimum(1, f / f[:, None])
    matrix[np.diag_indices(2 * n)] += 1 - matrix.sum(1)
    return matrix, np.concatenate([np.eye(1, n + 1).repeat(n, axis=0), np.eye(n, n + 1, 1)])


def lazy_errors(replay: str, large_step: float) -> tuple[float, float]:
    """TV from the exact law of the law that the lazy sampler keeps, and from the eager one's of the first 64 steps."""
    (matrix, view), (eager, eager_view) = lazy_chain(replay, large_step), eager_chain(large_step)
    exact = np.concatenate([[1.0], G / len(G)])
    law, apart = total_variation(stationary(matrix) @ view, exact / exact.sum()), 0.0
    here, there = matrix[-len(G) :], eager[-len(G) :]
    for _ in range(64):
        apart = max(apart, *(total_variation(*pair) for pair in zip(here @ view, there @ eager_view, strict=True)))
        here, there = here @ matrix, there @ eager
    return law, apart


def wrapped(sigma: float, x: np.ndarray) -> np.ndarray:
    """The density of a normal number of standard deviation sigma, around the ends of [0, 1)."""
    return norm.pdf(x[:, None] + np.arange(-30, 31), scale=sigma).sum(1)


def merging(sigma: float, n: int, scale: float) -> float:
    """The largest difference of the densities of n steps, by n-fold convolution, and of one that is `scale` as wide."""
    points = 512  # the trapezoidal rule is exact for the frequencies that a wrapped normal of this width has
    x = np.arange(points) / points
    steps = np.fft.ifft((np.fft.fft(wrapped(sigma, x)) / points) ** n).real * points
    return float(np.abs(steps - wrapped(sigma * scale, x)).max())


def walls(clamp: bool, sigma: float = 0.1, cells: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """(law, exact): of a walk on f = 0.2 + 1.6 x by cells of [0, 1], and the atom at either wall first and last.

    By the midpoint rule, a clamped proposal's mass beyond a wall on the wall itself.
    """
    x = np.concatenate([[0], (np.arange(cells) + 0.5) / cells, [1]]) if clamp else (np.arange(cells) + 0.5) / cells
    f = 0.2 + 1.6 * x
    if clamp:
        edges = np.arange(cells + 1) / cells
        below = ndtr((edges - x[:, None]) / sigma)
        q = np.concatenate([below[:, :1], np.diff(below, axis=1), 1 - below[:, -1:]], axis=1)
    else:
        q = wrapped(sigma, (x[:, None] - x).ravel()).reshape(cells, cells) / cells
        q /= q.sum(1, keepdims=True)
    matrix = q * np.minimum(1, f / f[:, None])
    matrix[np.diag_indices(len(x))] += 1 - matrix.sum(1)
    exact = f / f.sum() if not clamp else np.concatenate([[0], f[1:-1] / f[1:-1].sum(), [0]])
    return stationary(matrix), exact


def deposit_variances(pi: np.ndarray, q: np.ndarray, phi: np.ndarray) -> tuple[float, float]:
    """The asymptotic variances of the mean of phi: deposits on the state after the step, and expected-value ones.

    Both by the fundamental matrix Z = (I - P + 1 pi)^-1; the deposit h(x, y) = (1 - a) phi(x) + a phi(y) is a function
    of the state and the proposal.
    """
    a = np.minimum(1, pi / pi[:, None])
    p = q * a
    p[np.diag_indices(len(pi))] += 1 - p.sum(1)
    z = np.linalg.inv(np.eye(len(pi)) - p + pi)
    phi = phi - pi @ phi
    h = (1 - a) * phi[:, None] + a * phi
    later = z @ (q * h).sum(1)
    joint = pi[:, None] * q
    expected = (joint * h * (h + 2 * (a * later + (1 - a) * later[:, None]))).sum()
    return float(pi @ (phi * (2 * (z @ phi) - phi))), float(expected)


CHAIN = np.array([0.9, 0.05, 0.05]), np.array([[0.95, 0.05, 0], [0.05, 0, 0.95], [0, 0.95, 0.05]]), np.array([0, -1, 1])
"""A rare pair of states that the proposal alternates between, and phi odd on it: alternation cancels, and expected-
value deposits, which smear, cancel less."""


def random_ratios(seed: int, count: int = 4000) -> np.ndarray:
    """Expected over plain variance, of random three-state chains with symmetric proposals."""
    rng = np.random.default_rng(seed)
    ratios = []
    for _ in range(count):
        pi, (a, b, c) = rng.dirichlet(np.full(3, 0.5)) + 1e-3, rng.dirichlet(np.ones(3))
        q = np.array([[0, a, b], [a, 0, c], [b, c, 0]])
        q[np.diag_indices(3)] = 1 - q.sum(1)
        plain, expected = deposit_variances(pi / pi.sum(), q, rng.normal(size=3))
        ratios.append(expected / plain)
    return np.array(ratios)


F = np.array([0.2, 3.0, 0.5, 2.0])
"""Of the ring on which start-up bias is computed; seen through a uniform start, b is its mean."""
STARTS = ("bootstrap, same b", "bootstrap, exact b", "uniform start")
TIMES = np.arange(0, 25)


def startup(candidates: int) -> np.ndarray:
    """E[b phi(X_n)] / E[phi f] - 1 after n steps, phi the first state: by (start, n), all candidates enumerated."""
    n = len(F)
    q = steps_on_ring(n)
    p = q * np.minimum(1, F / F[:, None])
    p[np.diag_indices(n)] += 1 - p.sum(1)
    phi = np.eye(n)[0]
    later = np.stack([np.linalg.matrix_power(p, t) @ phi for t in TIMES])
    truth, b = F @ phi / n, F.mean()
    total = np.zeros((3, len(TIMES)))
    for counts in np.ndindex(*(candidates + 1,) * n):
        if sum(counts) != candidates:
            continue
        chance = multinomial.pmf(counts, candidates, np.full(n, 1 / n))
        weights: np.ndarray = np.array(counts) * F
        value = later @ (weights / weights.sum())
        total[0] += chance * weights.sum() / candidates * value
        total[1] += chance * b * value
    total[2] = b * later.mean(1)
    return total / truth - 1


def lengths() -> tuple[float, float]:
    """Relative errors of E[b phi], b the sum and b the mean of the lengths' averages: two lengths, two candidates each.

    The chain is the one that stays where it starts: what the start's law is, remains.
    """
    fs = np.array([[0.2, 3.0, 0.5], [2.0, 0.1, 1.0]])
    phi = np.array([1.0, 0.3, -0.5])  # what a sample adds to the image, at either length
    estimate = np.zeros(2)
    for states in np.ndindex(3, 3, 3, 3):
        f = np.array([fs[0][states[0]], fs[0][states[1]], fs[1][states[2]], fs[1][states[3]]])
        values = phi[list(states)]
        estimate += np.array([f.sum() / 2, f.mean()]) * (f @ values / f.sum()) / 81
    truth = (fs @ phi).sum() / 3
    return float(estimate[0] / truth - 1), float(estimate[1] / truth - 1)


def claims(data: xr.Dataset) -> list[Claim]:
    """Walls, deposits, starts, lengths and step counts: what is known exactly; where one fails, its repair after it."""
    wall, exact, n = data.clamped.to_numpy(), data.wall_exact.to_numpy(), data.sizes["cell"]
    flow = [total_variation(wall, exact), total_variation(data.around.to_numpy(), exact[1:-1])]
    same, other, uniform = (np.abs(data.startup.sel(start=s)) for s in STARTS)
    worse = float((data.ratios > 1).mean())
    return [
        Claim(
            "pss.wrap",
            "Wrapping around the ends is symmetric",
            f"{BOOK}.4",
            verdict(flow[1] < 1e-9),
            "holds",
            f"TV {flow[1]:.1e}",
            f"transition matrix of {n} cells, 1e-9",
        ),
        Claim(
            "pss.clamp",
            "Clamping to the ends would do as well",
            f"{BOOK}.4, which wraps",
            verdict(flow[0] < 1e-3),
            "fails",
            f"TV {flow[0]:.3f}; {wall[0]:.1%} and {wall[-1]:.1%} of the law stand on the walls",
            f"transition matrix of {n} cells and two walls, 1e-3; sigma 0.1, f = 0.2 + 1.6 u",
        ),
        Claim(
            "pss.expected-deposits",
            "Expected-value deposits are unbiased",
            f"{BOOK}.5",
            verdict(float(data.deposit_bias) < 1e-12),
            "holds",
            f"TV {float(data.deposit_bias):.1e}",
            "enumeration of the library's kernel on a ring, 1e-12",
        ),
        Claim(
            "pss.deposit-variance",
            "Expected-value deposits always lower the variance",
            f"{BOOK}.5",
            verdict(float(data.chain_ratio) <= 1 and worse == 0),
            "fails",
            f"one chain has {float(data.chain_ratio):.3f} of the plain one's; {worse:.1%} of random ones are over 1, "
            f"their median {float(data.ratios.median()):.2f}",
            "asymptotic variances by fundamental matrices, exact",
        ),
        Claim(
            "pss.bootstrap",
            "A start chosen by weight removes start-up bias, if the same estimate of b multiplies",
            f"{BOOK}.5; Veach and Guibas 1997",
            verdict(float(same.max()) < 1e-12),
            "holds",
            f"relative bias {float(same.max()):.1e}: any number of steps, 1 to 16 candidates",
            "all candidates enumerated, 1e-12",
        ),
        Claim(
            "pss.bootstrap-exact-b",
            "The exact b, or one estimated apart, would do as well",
            "ours",
            verdict(float(other.max()) < 1e-12),
            "fails",
            f"relative bias at the start {', '.join(f'{v:.0%}' for v in other[:, 0].to_numpy())} "
            "with 1, 4, 16 candidates",
            "all candidates enumerated, 1e-12",
        ),
        Claim(
            "pss.uniform-start",
            "A uniform start without weights would do as well",
            f"{BOOK}.5",
            verdict(float(uniform.max()) < 1e-12),
            "fails",
            f"relative bias {', '.join(f'{float(uniform[0, t]):.1%}' for t in (0, 8, 24))} after 0, 8, 24 steps",
            "transition matrix, 1e-12",
        ),
        Claim(
            "pss.b-sums-lengths",
            "b is the sum over the lengths of the average contribution of each",
            f"{BOOK}.5",
            verdict(abs(float(data.lengths[0])) < 1e-12),
            "holds",
            f"relative error {float(data.lengths[0]):.1e}; {float(data.lengths[1]):.0%} with the average over all",
            "all candidates enumerated, two lengths, 1e-12",
        ),
        Claim(
            "pss.step-count",
            "The step count is exact where it does not divide by the chains",
            f"{BOOK}.5",
            verdict(int(data.count_error) == 0),
            "holds",
            f"floors that telescope are never off; one rounded-down length for all is short by up to "
            f"{int(data.count_short)} steps",
            "all totals under 200 and chains under 50, exact",
        ),
    ]
