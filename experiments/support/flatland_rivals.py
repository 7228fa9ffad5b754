"""What every integrator of flatland does with one scene and path length: its error after so many rays, by technique."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import sem

from experiments.support.flatland_chains import METHODS, Lit, Placed, Usage, close, films, multiplexed_kernel
from mcmc1d.checks import require
from mcmc1d.estimators import Estimator
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators import MLT, Sums
from mcmc1d.flatland.integrators.chains import MMLT, PSSMLT
from mcmc1d.flatland.sampling import bootstrap
from mcmc1d.metropolis import Kernel
from mcmc1d.numerics import cast, stratum
from mcmc1d.random import uniforms
from mcmc1d.starts import exact_start
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key

INDEPENDENT = ("PT", "LT", "BDPT")
CHAINS = ("PSSMLT, sum", "PSSMLT, max", "MLT", *METHODS[:2])
INTEGRATORS = (*INDEPENDENT, *CHAINS)


class Chain(NamedTuple):
    """A chain and its work."""

    kernel: Kernel
    target: Multiplexed
    start: State | None
    rays: float
    """Of a mutation, on average."""
    rays_of_b: float
    """Of a sample of the integral of its target."""


@dataclass(frozen=True)
class Rivals:
    """What all integrators of one scene and length share."""

    paths: Paths
    every: Multiplexed
    """BDPT's target: all techniques."""
    reference: np.ndarray
    """The exact image, (pixels,)."""
    parts: np.ndarray
    """Which pixels an error is the mean of, (parts, pixels)."""
    rays: np.ndarray
    """After which an error is looked at: the same of all integrators, up to the rays of a mutation."""
    sigma: float
    large: float
    runs: int
    """Of one chain each; as many batches of independent samples."""
    samples: int
    """Independent ones."""
    who: tuple[str, ...] = INTEGRATORS
    """Of `INTEGRATORS`, in their order; BDPT is one, for it says what each technique contributes."""

    def __post_init__(self):
        in_order = self.who == tuple(who for who in INTEGRATORS if who in self.who)
        require(
            in_order and "BDPT" in self.who, f"integrators are some of {INTEGRATORS} in this order, BDPT among them"
        )
        require(self.samples % self.runs == 0, f"samples, {self.samples}, are a multiple of runs, {self.runs}")

    @property
    def b(self) -> float:
        return float(self.reference.mean())

    def _mean(self, squares: np.ndarray) -> np.ndarray:
        """Over the pixels of each part: from (..., pixels) to (..., parts)."""
        return squares @ self.parts.T / self.parts.sum(1)

    def independent(self, key: Key) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
        """Path tracing, light tracing and BDPT, whose error after N samples follows from their variance, by batches.

        Also figure 5's contribution of each technique.
        """
        pixels, n = float(len(self.reference)), self.every.n_techniques
        techniques = {"PT": range(n - 2, n), "LT": range(1 + self.paths.sensor.places), "BDPT": range(n)}
        rows, size, total = [], self.samples // self.runs, np.zeros(0)
        for k, who in enumerate(INDEPENDENT):
            if who not in self.who:
                continue
            own, mask = jax.random.fold_in(key, k), np.isin(np.arange(n), techniques[who])
            total, squares = contributions(own, self.every, self.paths, mask, self.runs, size)
            batches = Sums(size, total.sum(1), squares.sum(1), np.inf)
            per_sample = self._mean(pixels**2 * batches.variance).T
            rows.append(
                {
                    "value": pixels * batches.mean.mean(0),
                    "error": pixels * sem(batches.mean),
                    "mean_error": sem(batches.mean.sum(-1)),
                    "mse": per_sample * (self.paths.edges / self.rays)[:, None, None],
                    "scale": 1.0,
                    "b_cost": 0.0,
                }
            )
        shares = total.sum(-1) / size / self.b  # of the last, BDPT
        found = {
            "contribution": shares.mean(0),
            "contribution_error": sem(shares),
            "contribution_film": total.mean(0) / size / self.b,
        }
        return rows, found

    def chains(self, key: Key) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
        """Runs of one chain each: images in absolute scale, by independent samples of the chain's own target.

        Errors against rays are of images to which that integral is known; that of the maximum as well as is estimated.
        """
        pixels, n = float(len(self.reference)), self.every.n_techniques
        rows, found, integrals = [], {}, {}
        for who, chain in self._chains(jax.random.fold_in(key, 2 * len(CHAINS))).items():
            own, of_b = (jax.random.fold_in(key, 2 * CHAINS.index(who) + part) for part in (0, 1))
            if id(chain.target) not in integrals:  # that of all techniques is several chains'
                size = int(self.samples * self.paths.edges / chain.rays_of_b)
                integrals[id(chain.target)] = bootstrap(of_b, chain.target, size, np.inf)
            b = integrals[id(chain.target)]
            steps = np.maximum(1, np.round(self.rays / chain.rays)).astype(int).tolist()
            estimators: dict[str, Estimator] = {"lit": Lit(self.runs)}
            if who in METHODS:  # of both, which are one program then
                estimators["usage"] = Usage(self.paths, self.runs, n)
            if who == CHAINS[0]:
                estimators["placed"] = Placed(self.paths, n)
            ran = films(who, own, chain.kernel, chain.target, self.paths, self.runs, steps, estimators, chain.start)
            estimated, last = float(b.mean[0]), ran.films[-1]
            known = estimated if who == CHAINS[1] else self.b
            value, relative = pixels * estimated * last.mean(0), float(b.error[0]) / estimated
            whole = last.sum(-1)
            lit = ran.sums["lit"] / steps[-1]
            rows.append(
                {
                    "value": value,
                    "error": np.hypot(pixels * estimated * sem(last), value * relative),
                    "mean_error": estimated * np.hypot(sem(whole), whole.mean() * relative),
                    "mse": self._mean((pixels * known * ran.films - self.reference) ** 2).swapaxes(1, 2),
                    "scale": estimated / self.b,
                    "b_cost": float(b.variance[0]) / estimated**2 * chain.rays_of_b,
                    "effective": lit.mean(),
                    "effective_error": sem(lit),
                }
            )
            if who == METHODS[0]:
                shares, film = (part / steps[-1] for part in ran.sums["usage"])
                found |= {"usage": shares.mean(1), "usage_error": sem(shares, axis=-1), "usage_film": film / self.runs}
            if who == CHAINS[0]:
                found |= {"placed_film": ran.sums["placed"] / (steps[-1] * self.runs * n)}
        found |= {part: np.array([row[part] for row in rows]) for part in ("effective", "effective_error")}
        return rows, found

    def _chains(self, key: Key) -> dict[str, Chain]:
        paths, every, n = self.paths, self.every, self.every.n_techniques
        exact = exact_start(key, every, self.runs)
        chains = {}
        for combine, who in zip(("sum", "maximum"), CHAINS, strict=False):
            if who not in self.who:
                continue
            one = PSSMLT(combine=combine, sigma=self.sigma, large=self.large)
            target = one.target(paths)
            # The density of u alone under MMLT's law is the sum, so that its exact starts are exact here.
            start = State(jnp.zeros_like(exact.index), exact.u) if combine == "sum" else None
            chains[who] = Chain(one.kernel(), target, start, *one.rays(target, paths, {"mutation": 1.0}))
        if CHAINS[2] in self.who:
            one = MLT()
            shares = {kind: getattr(one, kind) for kind in ("bidirectional", "lens", "caustic", "multi_chain")}
            chains[CHAINS[2]] = Chain(one.kernel(), every, exact, *one.rays(every, paths, shares))
        for who, matrix in zip(METHODS, (close(n, self.sigma), np.full((n, n), 1 / n)), strict=False):
            if who not in self.who:
                continue
            kernel = multiplexed_kernel(self.sigma, self.large, matrix)
            chains[who] = Chain(kernel, every, exact, *MMLT().rays(every, paths, {"mutation": 1.0}))
        return chains


def dark(rivals: Rivals) -> dict[str, np.ndarray]:
    """The same of a length without light, as of what only lies behind a mirror: no error, and no b to find."""
    each, none = len(rivals.who), np.zeros((len(rivals.who), len(rivals.reference)))
    return {
        **dict.fromkeys(("value", "error"), none),
        "mean_error": np.zeros(each),
        "mse": np.zeros((each, len(rivals.rays), len(rivals.parts), rivals.runs)),
        "scale": np.ones(each),
        "b_cost": np.zeros(each),
    }


def everyone(rivals: Rivals, key: Key) -> dict[str, np.ndarray]:
    """What all of them do, and what was found by technique."""
    independent, of_technique = rivals.independent(jax.random.fold_in(key, 0))
    chains, of_chains = rivals.chains(jax.random.fold_in(key, 1))
    rows = independent + chains
    parts = ("value", "error", "mean_error", "mse", "scale", "b_cost")
    return {part: np.stack([row[part] for row in rows]) for part in parts} | of_technique | of_chains


def contributions(
    key: Key, target: Multiplexed, paths: Paths, mask: np.ndarray, batches: int, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of what each technique of `mask` puts into each pixel, (batches, techniques, pixels); and of squares.

    Multiple importance sampling by those techniques alone, with the balance heuristic, each as often as another.
    """
    chosen = jnp.asarray(np.resize(np.flatnonzero(mask), len(mask))), jnp.asarray(int(mask.sum()))
    of = partial(_contributions, key, target, paths, jnp.asarray(mask), chosen, size=size)
    found = [of(jnp.asarray(k)) for k in range(batches)]
    total, squares = (np.stack([np.asarray(one[part], np.float64) for one in found]) for part in (0, 1))
    return total, squares


@eqx.filter_jit
def _contributions(
    key: Key, target: Multiplexed, paths: Paths, mask: Array, chosen: tuple[Array, Array], batch: Array, *, size: int
) -> tuple[Array, Array]:
    dtype = jnp.zeros(()).dtype
    target, paths = cast((target, paths), dtype)
    numbers, (members, count) = uniforms(key, batch, (target.dim_u + 1, size), dtype), chosen
    index = members[stratum(numbers[0], count)]
    seen = jax.vmap(target.evaluate, in_axes=-1, out_axes=-1)(State(index, numbers[1:])).seen
    p = jnp.where(mask[:, None], jnp.exp(jnp.stack(seen.log_p)), 0).sum(0)
    lit = (seen.log_c > -jnp.inf) & (p > 0)
    value = jnp.where(lit, count * jnp.exp(seen.log_f) / jnp.where(lit, p, 1), 0)
    pixel = jax.vmap(paths.pixel, in_axes=-1)(seen.x)
    zeros = jnp.zeros((target.n_techniques, paths.sensor.pixels), dtype)
    return zeros.at[index, pixel].add(value), zeros.at[index, pixel].add(value * value)


__all__ = ["CHAINS", "INDEPENDENT", "INTEGRATORS", "Rivals", "contributions", "dark", "everyone"]
