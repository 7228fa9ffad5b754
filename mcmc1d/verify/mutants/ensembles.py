"""Several chains at once: ensembles of walkers and replica exchange; the stationary law is a product."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from mcmc1d.types import Array, Key
from mcmc1d.verify.kernels import JaxKernel
from mcmc1d.verify.law import Law
from mcmc1d.verify.mutants import Mutant, Trap

_SPACE = 3


def _ensemble(walkers: int) -> Law:
    """So many independent walkers, each standard normal in three dimensions: positions (n, walkers, 3)."""
    return Law(
        lambda rng, n: rng.normal(size=(n, walkers, _SPACE)),
        cdf=ndtr,
        log_density=lambda x: -0.5 * jnp.sum(x * x),
        bad_start=np.full((walkers, _SPACE), 4.0) + np.random.default_rng(0).normal(size=(walkers, _SPACE)),
        name=f"{walkers} walkers in space",
    )


def _log_f(x: Array) -> Array:
    return -0.5 * jnp.sum(x * x, axis=-1)


def stretch(walkers: int, *, exponent: int = _SPACE - 1, mistake: str = ""):
    """Goodman and Weare 2010, red and blue: y = c + z (x - c), accepted with z^(d - 1) f(y) / f(x)."""
    half = walkers // 2

    def update(key: Key, mine: Array, others: Array) -> Array:
        keys = jax.random.split(key, 3)
        count = mine.shape[0]
        root = jax.random.uniform(keys[0], (count,))
        z = ((1 + root) ** 2 / 2)[:, None]  # a = 2: density 1 / sqrt(z) on [1/2, 2]
        partner = others[jax.random.randint(keys[1], (count,), 0, others.shape[0])]
        y = partner + z * (mine - partner)
        log_ratio = exponent * jnp.log(z[:, 0]) + _log_f(y) - _log_f(mine)
        return jnp.where((jnp.log(jax.random.uniform(keys[2], (count,))) < log_ratio)[:, None], y, mine)

    def kernel(key: Key, x: Array) -> Array:
        first, second = jax.random.split(key)
        if mistake == "all at once":
            return update(first, x, x)
        red = update(first, x[:half], x[half:])
        blue = update(second, x[half:], x[:half] if mistake == "old partners" else red)
        return jnp.concatenate([red, blue])

    return kernel


def snooker(walkers: int, *, mistake: bool):
    """A step along the line to another walker, with (|y - z| / |x - z|)^(d - 1) (ter Braak and Vrugt 2008).

    The mistake is emcee's: the direction is divided by the root of the norm, and the exponent halved.
    """

    def update(key: Key, k: int, x: Array) -> Array:
        keys = jax.random.split(key, 2)
        others = jnp.asarray([j for j in range(walkers) if j != k])
        z, a, b = x[jax.random.choice(keys[0], others, (3,), replace=False)]
        delta = x[k] - z
        norm = jnp.linalg.norm(delta)
        unit = delta / (jnp.sqrt(norm) if mistake else norm)
        y = x[k] + unit * 1.7 * (jnp.dot(unit, a) - jnp.dot(unit, b))
        power = (_SPACE - 1) / (2 if mistake else 1)
        log_ratio = _log_f(y) - _log_f(x[k]) + power * jnp.log(jnp.linalg.norm(y - z) / norm)
        accepted = jnp.log(jax.random.uniform(keys[1])) < log_ratio
        return x.at[k].set(jnp.where(accepted, y, x[k]))

    def kernel(key: Key, x: Array) -> Array:
        for k in range(walkers):
            x = update(jax.random.fold_in(key, k), k, x)
        return x

    return kernel


_COLD, _HOT = 1.0, 0.25


def _exchange_law() -> Law:
    """A cold and a hot copy of 0.3 N(-1.5, 0.5^2) + 0.7 N(1, 0.9^2)-like energy (x^2 - 1)^2: (n, 2), by rejection."""
    grid = np.linspace(-4, 4, 20_001)
    tables = []
    for beta in (_COLD, _HOT):
        density = np.exp(-beta * _energy(grid))
        # Trapezoids; the error is under 1e-7, and the sampler and the CDF share the table.
        total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
        tables.append(total / total[-1])

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        u = rng.random((n, 2))
        return np.stack([np.interp(u[:, k], tables[k], grid) for k in range(2)], 1)

    def cdf(x: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(x[:, k], grid, tables[k]) for k in range(2)], 1)

    return Law(sample, cdf=cdf, name="two temperatures", support=(np.full(2, -4.0), np.full(2, 4.0)))


def _energy(x: Any) -> Any:
    return (x * x - 1.5) ** 2 + 0.5 * x


def exchange(*, mistake: str = "") -> JaxKernel:
    """Random walks at two temperatures and a swap, accepted with exp((b1 - b2) (E1 - E2)); energies are cached."""

    def init(key: Key, x: Array) -> tuple[Array, Array]:
        return x, _energy(x)

    def step(key: Key, state: tuple[Array, Array]) -> tuple[Array, Array]:
        x, energy = state
        keys = jax.random.split(key, 3)
        beta = jnp.array([_COLD, _HOT])
        y = x + jnp.array([0.5, 1.0]) * jax.random.normal(keys[0], (2,))
        proposed = jnp.where(jnp.abs(y) < 4, _energy(y), jnp.inf)
        accepted = jnp.log(jax.random.uniform(keys[1], (2,))) < beta * (energy - proposed)
        x, energy = jnp.where(accepted, y, x), jnp.where(accepted, proposed, energy)
        log_ratio = (_COLD - _HOT) * (energy[0] - energy[1])
        if mistake == "transposed":
            log_ratio = -log_ratio
        swap = jnp.log(jax.random.uniform(keys[2])) < log_ratio
        both = jnp.stack([x[1], x[1]]) if mistake == "overwrites" else x[::-1]
        x = jnp.where(swap, both, x)
        return x, energy if mistake == "stale" else jnp.where(swap, energy[::-1], energy)

    return JaxKernel(step, init, lambda state: state[0], name="replica exchange")


_FOUR, _TWO = _ensemble(4), _exchange_law()
_COSTLY = {"gap": 0.02}  # a sixteenth of the replicas

MUTANTS = {
    "snooker_direction": Mutant(
        snooker(4, mistake=True),
        "direction divided by the root of the norm, exponent (n - 1)/2",
        "dfm/emcee #531, in release 3.1.6",
        layer="density",
        law=_FOUR,
        right=snooker(4, mistake=False),
    ),
    "stretch_exponent": Mutant(
        stretch(4, exponent=_SPACE),
        "dimension exponent off by one, which is hardly seen in one dimension",
        "planted; as in dfm/emcee #531, whose exponent is (n - 1)/2",
        layer="marginal",
        law=_FOUR,
        options=_COSTLY,
        right=stretch(4),
    ),
    "walkers_all_at_once": Mutant(
        stretch(3, mistake="all at once"),
        "walkers updated against walkers that move in the same update, themselves included",
        "Foreman-Mackey et al. 2013, section 3, on why the ensemble is split in two",
        layer="density",
        law=_ensemble(3),
        right=stretch(3),
    ),
    "walkers_of_the_last_sweep": Mutant(
        stretch(4, mistake="old partners"),
        "the second half is moved against the first half as it was before",
        "planted; a stale cache as in mlcg #70",
        layer="density",
        law=_FOUR,
        options=_COSTLY,
        right=stretch(4),
    ),
    "swap_transposed": Mutant(
        exchange(mistake="transposed"),
        "swap formula transposed",
        "synesenom/ran #977",
        layer="marginal",
        law=_TWO,
        right=exchange(),
    ),
    "swap_overwrites": Mutant(
        exchange(mistake="overwrites"),
        "swap loop that overwrites: both replicas end as one",
        "a replica-exchange code; which one is not on record",
        layer="marginal",
        law=_TWO,
        right=exchange(),
    ),
    "swap_leaves_energies": Mutant(
        exchange(mistake="stale"),
        "stale cached energy after a swap",
        "mlcg #70: cached forces not swapped",
        layer="marginal",
        law=_TWO,
        right=exchange(),
    ),
}

TRAPS = {
    "red_blue_stretch": Trap(stretch(6), _ensemble(6), "a red-blue ensemble is not reversible", _COSTLY),
    "snooker": Trap(snooker(4, mistake=False), _ensemble(4), "walkers move one after another", _COSTLY),
    "replica_exchange": Trap(exchange(), _exchange_law(), "two chains trade places"),
}
