"""What every integrator of flatland does with one scene and path length: its error after so many rays, by technique."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import sem

from experiments.support.flatland_chains import METHODS, Lit, Usage, close, films, multiplexed_kernel
from mcmc1d.chain import exact_start
from mcmc1d.estimators import Estimator
from mcmc1d.flatland import Paths
from mcmc1d.flatland.integrators.chains import MMLT, PSSMLT
from mcmc1d.flatland.sampling import Sums
from mcmc1d.numerics import cast, stratum
from mcmc1d.random import uniforms
from mcmc1d.state import Multiplexed, State
from mcmc1d.types import Array, Key

INDEPENDENT = ("PT", "LT", "BDPT")
CHAINS = ("PSSMLT, sum", "PSSMLT, max", *METHODS[:2])
INTEGRATORS = (*INDEPENDENT, *CHAINS)
_BATCH = 2**14


@dataclass(frozen=True)
class Rivals:
    """What all integrators of one scene and length share."""

    paths: Paths
    every: Multiplexed
    """BDPT's target: all techniques."""
    reference: np.ndarray
    """The exact image, (pixels,)."""
    steps: np.ndarray
    """Samples or mutations after which an error is looked at."""
    sigma: float
    large: float
    runs: int
    """Of one chain each."""
    samples: int
    """Independent ones."""

    @property
    def b(self) -> float:
        return float(self.reference.mean())

    def independent(self, key: Key) -> tuple[list[dict[str, np.ndarray]], dict[str, Any]]:
        """Path tracing, light tracing and BDPT, whose error after N samples follows from their variance.

        Also figure 5's contribution of each technique, and the relative variance of a sample of b by BDPT.
        """
        pixels, n = float(len(self.reference)), self.every.n_techniques
        techniques = {"PT": range(n - 2, n), "LT": range(1 + self.paths.sensor.places), "BDPT": range(n)}
        rows, sums = [], {}
        for k, who in enumerate(INDEPENDENT):
            own, mask = jax.random.fold_in(key, k), np.isin(np.arange(n), techniques[who])
            total, squares, size = contributions(own, self.every, self.paths, mask, self.samples)
            film = Sums(size, total.sum(0), squares.sum(0), np.inf)
            sums[who] = total, squares, size
            rows.append(
                {
                    "value": pixels * film.mean,
                    "error": pixels * film.error,
                    "mse": pixels**2 * film.variance / self.steps[:, None],
                    "noise": np.zeros(len(self.steps)),
                    "rays": self.paths.edges * self.steps,
                }
            )
        total, squares, size = sums["BDPT"]
        by_technique = Sums(size, total.sum(1), squares.sum(1), np.inf)
        found = {
            "contribution": by_technique.mean / self.b,
            "contribution_error": by_technique.error / self.b,
            "contribution_film": total / size / self.b,
            "b_variance": Sums(size, total.sum(), squares.sum(), np.inf).variance / self.b**2,
        }
        return rows, found

    def chains(self, key: Key) -> tuple[list[dict[str, np.ndarray]], dict[str, np.ndarray]]:
        """Runs of one chain each, to which b is known.

        What PSSMLT with the maximum is multiplied by, less than b, follows from what all of its runs deposit together.
        """
        pixels, n = float(len(self.reference)), self.every.n_techniques
        exact = exact_start(jax.random.fold_in(key, len(CHAINS)), self.every, self.runs)
        matrices = {METHODS[0]: close(n, self.sigma), METHODS[1]: np.full((n, n), 1 / n)}
        rows, found = [], {}
        for k, who in enumerate(CHAINS):
            estimators: dict[str, Estimator] = {"lit": Lit(self.runs)}
            start = exact
            if who in matrices:
                one, target = MMLT(), self.every
                kernel = multiplexed_kernel(self.sigma, self.large, matrices[who])
                estimators["usage"] = Usage(self.paths, self.runs, n)
            else:
                combine = "sum" if who.endswith("sum") else "maximum"
                one = PSSMLT(combine=combine, sigma=self.sigma, large=self.large)
                target, kernel = one.target(self.paths), one.kernel()
                # The density of u alone under MMLT's law is the sum, so that its exact starts are exact here.
                start = State(jnp.zeros_like(exact.index), exact.u) if combine == "sum" else None
            each = one.rays(target, self.paths, {"mutation": 1.0})[0]
            own = jax.random.fold_in(key, k)
            ran = films(who, own, kernel, target, self.paths, self.runs, self.steps.tolist(), estimators, start)
            images = pixels * self.b * ran.films
            if who == "PSSMLT, max":
                images /= ran.films[-1].sum(-1).mean()
            off = (images - self.reference) ** 2
            lit = ran.sums["lit"] / self.steps[-1]
            rows.append(
                {
                    "value": images[-1].mean(0),
                    "error": sem(images[-1]),
                    "mse": off.mean(1),
                    "noise": sem(off.mean(-1), axis=-1),
                    "rays": each * self.steps,
                    "effective": lit.mean(),
                    "effective_error": sem(lit, axis=-1),
                }
            )
            if who == METHODS[0]:
                shares, film = (part / self.steps[-1] for part in ran.sums["usage"])
                found = {"usage": shares.mean(1), "usage_error": sem(shares, axis=-1), "usage_film": film / self.runs}
        found |= {part: np.stack([row[part] for row in rows]) for part in ("effective", "effective_error")}
        return rows, found


def contributions(
    key: Key, target: Multiplexed, paths: Paths, mask: np.ndarray, samples: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Sums of what each technique of `mask` puts into each pixel, (techniques, pixels); of squares; of how many.

    Multiple importance sampling by those techniques alone, with the balance heuristic, each as often as another.
    """
    batches = max(1, -(-samples // _BATCH))
    chosen = jnp.asarray(np.resize(np.flatnonzero(mask), len(mask))), jnp.asarray(int(mask.sum()))
    found = [_contributions(key, target, paths, jnp.asarray(mask), chosen, jnp.asarray(k)) for k in range(batches)]
    total, squares = (np.sum([np.asarray(one[part], np.float64) for one in found], axis=0) for part in (0, 1))
    return total, squares, batches * _BATCH


@eqx.filter_jit
def _contributions(
    key: Key, target: Multiplexed, paths: Paths, mask: Array, chosen: tuple[Array, Array], batch: Array
) -> tuple[Array, Array]:
    dtype = jnp.zeros(()).dtype
    target, paths = cast((target, paths), dtype)
    numbers, (members, count) = uniforms(key, batch, (target.dim_u + 1, _BATCH), dtype), chosen
    index = members[stratum(numbers[0], count)]
    seen = jax.vmap(target.evaluate, in_axes=-1, out_axes=-1)(State(index, numbers[1:])).seen
    p = jnp.where(mask[:, None], jnp.exp(jnp.stack(seen.log_p)), 0).sum(0)
    lit = (seen.log_c > -jnp.inf) & (p > 0)
    value = jnp.where(lit, count * jnp.exp(seen.log_f) / jnp.where(lit, p, 1), 0)
    pixel = jax.vmap(paths.pixel, in_axes=-1)(seen.x)
    zeros = jnp.zeros((target.n_techniques, paths.sensor.pixels), dtype)
    return zeros.at[index, pixel].add(value), zeros.at[index, pixel].add(value * value)
