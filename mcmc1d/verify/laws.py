"""Laws to verify kernels on: where the bugs that survived a standard normal show.

Each is asymmetric; between them they have two modes, mass at walls, a heavy shoulder, correlated and curved
coordinates, scales that depend on another coordinate, and an index of three states. All sample by construction.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce

import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr
from scipy.stats import gamma

from mcmc1d.verify.law import Law
from mcmc1d.verify.statistic import Continuous, Discrete, Position


def two_modes() -> Law:
    """On the line: 0.3 N(-1.5, 0.5^2) + 0.7 N(1, 0.9^2)."""
    return _normal_mixture("two modes", [0.3, 0.7], [[-1.5], [1.0]], [[[0.25]], [[0.81]]], scalar=True)


def walls() -> Law:
    """On [0, 1]: 0.35 of 4 (1 - x)^3, 0.4 of 3 x^2 and 0.25 uniform: most of its mass leans on two unequal walls."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        u, which = rng.random(n), rng.random(n)
        return np.where(which < 0.35, 1 - (1 - u) ** 0.25, np.where(which < 0.75, u ** (1 / 3), u))

    def log_density(x):
        inside = (x >= 0) & (x <= 1)
        return jnp.where(inside, jnp.log(1.4 * (1 - x) ** 3 + 1.2 * x * x + 0.25), -jnp.inf)

    def cdf(x: np.ndarray) -> np.ndarray:
        x = np.clip(x, 0, 1)
        return 0.35 * (1 - (1 - x) ** 4) + 0.4 * x**3 + 0.25 * x

    return Law(sample, cdf=cdf, log_density=log_density, support=(0.0, 1.0), bad_start=np.float64(0.999), name="walls")


def skewed() -> Law:
    """On x > 0: a gamma law of shape 2, its derivative infinite in log x at the wall."""
    return Law(
        lambda rng, n: rng.gamma(2.0, size=n),
        cdf=gamma(2).cdf,
        log_density=lambda x: jnp.where(x > 0, jnp.log(jnp.maximum(x, 1e-37)) - x, -jnp.inf),
        support=(0.0, np.inf),
        name="skewed",
    )


def ridge() -> Law:
    """In the plane: two crossing ridges, 0.35 and 0.65, correlated -0.7 and 0.6."""
    return _normal_mixture(
        "ridge",
        [0.35, 0.65],
        [[-1.0, 0.8], [0.8, 0.0]],
        [[[0.36, -0.336], [-0.336, 0.64]], [[1.0, 0.42], [0.42, 0.49]]],
    )


def banana() -> Law:
    """In the plane: x0 ~ N(0, 1), x1 ~ N(x0^2 / 2, 0.6^2): curved, and skewed in x1."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        x0 = rng.normal(size=n)
        return np.stack([x0, 0.5 * x0**2 + 0.6 * rng.normal(size=n)], 1)

    return Law(
        sample,
        statistics={
            "x[0]": Continuous(lambda x: x[:, 0], ndtr),
            "x[1] given x[0]": Continuous(lambda x: (x[:, 1] - 0.5 * np.float64(x[:, 0]) ** 2) / 0.6, ndtr),
        },
        log_density=lambda x: -0.5 * x[0] ** 2 - 0.5 * ((x[1] - 0.5 * x[0] ** 2) / 0.6) ** 2,
        name="banana",
    )


def lopsided() -> Law:
    """In space: 0.7 and 0.3 of two normals of unlike centres, scales and correlations."""
    return _normal_mixture(
        "lopsided",
        [0.7, 0.3],
        [[0.0, 0.0, 0.0], [1.2, -0.8, 0.6]],
        [
            [[1.0, 0.3, 0.0], [0.3, 0.5, -0.1], [0.0, -0.1, 0.8]],
            [[0.4, -0.1, 0.1], [-0.1, 0.9, 0.2], [0.1, 0.2, 0.3]],
        ],
    )


def normal(dimension: int) -> Law:
    """The standard normal law in any dimension: what everyone tests on, and where symmetric mistakes hide."""
    return Law(
        (lambda rng, n: rng.normal(size=n)) if dimension == 1 else (lambda rng, n: rng.normal(size=(n, dimension))),
        cdf=ndtr,
        log_density=lambda x: -0.5 * jnp.sum(x * x),
        name=f"normal({dimension})",
    )


def correlated(correlation: float) -> Law:
    """In the plane: a normal law of unit variances; its marginals say nothing of the correlation."""
    law = _normal_mixture("correlated", [1.0], [[0.0, 0.0]], [[[1.0, correlation], [correlation, 1.0]]])
    root = float(np.sqrt(1 - correlation**2))

    def value(x: Position) -> np.ndarray:
        x = np.asarray(x, np.float64)
        return (x[:, 1] - correlation * x[:, 0]) / root

    rest = Continuous(value, ndtr)
    return replace(law, statistics={"x[1] given x[0]": rest})


def switch() -> Law:
    """An index of three states and a real x whose law depends on it: {"index": (n,), "x": (n,)}."""
    masses = np.array([0.5, 0.2, 0.3])
    centres, scales = np.array([-1.0, 0.5, 2.0]), np.array([0.7, 0.3, 1.0])
    cells = 12

    def sample(rng: np.random.Generator, n: int) -> Position:
        index = rng.choice(3, size=n, p=masses).astype(np.int32)
        return {"index": index, "x": centres[index] + scales[index] * rng.normal(size=n)}

    def joint(p: Position) -> np.ndarray:
        i = np.asarray(p["index"])
        k = np.clip(i, 0, 2)
        place = (ndtr((np.asarray(p["x"], np.float64) - centres[k]) / scales[k]) * cells).astype(np.int64)
        return np.where((i >= 0) & (i < 3), i * cells + np.minimum(place, cells - 1), -1)

    def log_density(p):
        i = jnp.clip(p["index"], 0, 2)
        z = (p["x"] - jnp.asarray(centres)[i]) / jnp.asarray(scales)[i]
        return jnp.log(jnp.asarray(masses / scales)[i]) - 0.5 * z * z

    return Law(
        sample,
        statistics={
            "x": Continuous(
                lambda p: p["x"],
                lambda x: ndtr((x[..., None] - centres) / scales) @ masses,
            ),
            "index, x": Discrete(
                joint,
                np.repeat(masses / cells, cells),
                tuple(
                    f"index {i}, its x in {k}/{cells}..{k + 1}/{cells} of it" for i in range(3) for k in range(cells)
                ),
            ),
        },
        log_density=log_density,
        support=lambda p: (np.asarray(p["index"]) >= 0) & (np.asarray(p["index"]) < 3),
        name="switch",
    )


def _normal_mixture(
    name: str, weights: Sequence[float], means: Sequence, covariances: Sequence, *, scalar: bool = False
) -> Law:
    """A mixture of normal laws in any dimension; its marginals are mixtures too."""
    w, m, c = (np.asarray(part, np.float64) for part in (weights, means, covariances))
    roots = np.linalg.cholesky(c)
    whitening = np.linalg.inv(roots)  # lower triangular: the exponent is half the squared length of this times d
    offsets = np.log(w) - 0.5 * np.linalg.slogdet(c)[1]
    deviations = np.sqrt(np.diagonal(c, axis1=1, axis2=2))

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        lobe = rng.choice(len(w), size=n, p=w)
        x = m[lobe] + np.einsum("nij,nj->ni", roots[lobe], rng.normal(size=(n, m.shape[1])))
        return x[:, 0] if scalar else x

    def log_density(x):
        # Number by number: XLA's sums over so few entries cost four times as much on a CPU.
        x = jnp.atleast_1d(x)
        exponents = []
        for mean, white, offset in zip(m.tolist(), whitening.tolist(), offsets.tolist(), strict=True):
            d = [x[i] - mean[i] for i in range(len(mean))]
            z = [sum(row[j] * d[j] for j in range(i + 1)) for i, row in enumerate(white)]
            exponents.append(offset - 0.5 * sum(t * t for t in z))
        top = reduce(jnp.maximum, exponents)
        return top + jnp.log(sum(jnp.exp(e - top) for e in exponents))

    def cdf(x: np.ndarray) -> np.ndarray:
        points = np.asarray(x, np.float64).reshape(len(x), -1)
        parts = ndtr((points[:, None, :] - m) / deviations)
        return np.einsum("k,nkd->nd", w, parts).reshape(np.shape(x))

    return Law(sample, cdf=cdf, log_density=log_density, name=name)


LAWS: dict[str, Callable[[], Law]] = {
    "two_modes": two_modes,
    "walls": walls,
    "skewed": skewed,
    "ridge": ridge,
    "banana": banana,
    "lopsided": lopsided,
    "switch": switch,
}
"""Every shipped law by name, made when called."""

__all__ = ["LAWS", "banana", "correlated", "lopsided", "normal", "ridge", "skewed", "switch", "two_modes", "walls"]
