"""Independent samples of light: what they put on a film, or what they integrate to, as sums with an honest error."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.compiling import wide_jit
from mcmc1d.flatland.paths import Paths
from mcmc1d.numerics import cast
from mcmc1d.random import uniforms
from mcmc1d.starts import uniform_states
from mcmc1d.state import Multiplexed
from mcmc1d.types import Array, Key

_LANES = 2**12
_STEPS = 2**9


class Sums(NamedTuple):
    """Sums over independent random numbers, each in [0, bound]: of the samples of a pixel, or of a chain's deposits."""

    size: int
    total: np.ndarray
    squares: np.ndarray
    bound: float
    """What none of the numbers exceeds, in theory: with it, a deviation of the mean has an honest probability."""

    @property
    def mean(self) -> np.ndarray:
        """Their mean."""
        return self.total / self.size

    @property
    def variance(self) -> np.ndarray:
        """Of one of them, unbiased."""
        return np.maximum(self.squares - self.total**2 / self.size, 0) / (self.size - 1)

    @property
    def error(self) -> np.ndarray:
        """The standard error of the mean."""
        return np.sqrt(self.variance / self.size)


def exposed(key: Key, target: Multiplexed, paths: Paths, samples: int, bound: float) -> Sums:
    """Independent samples of `target`'s states: what each puts into each pixel, C_i(u) times the techniques."""
    return _sums(key, target, paths, samples, bound)


def bootstrap(key: Key, target: Multiplexed, samples: int, bound: float, only: int | None = None) -> Sums:
    """The same without a film, as sums of shape (1,): the integral of whatever `target` is, `Pooled` included.

    With `only`, that of this technique's contribution alone.
    """
    return _sums(key, target, None, samples, bound, only)


def _sums(
    key: Key, target: Multiplexed, paths: Paths | None, samples: int, bound: float, only: int | None = None
) -> Sums:
    pixels = 1 if paths is None else paths.sensor.pixels
    steps = max(1, -(-samples // _LANES))
    total, squares = np.zeros(pixels), np.zeros(pixels)
    for first in range(0, steps, _STEPS):
        count = min(_STEPS, steps - first)
        lanes = _sampled(key, target, paths, jnp.asarray(first), jnp.asarray(count), only)
        total, squares = (
            old + np.asarray(new, np.float64).sum(-1) for old, new in zip((total, squares), lanes, strict=True)
        )
    if not np.all(np.isfinite(squares)):
        raise undefined_light((paths, target), ", or its square over what single precision holds")
    return Sums(steps * _LANES, total, squares, bound)


def undefined_light(what: Any, further: str = "") -> ValueError:
    """That a path's light is no number: of how many edges, for anything that holds `Paths`, and where to look."""
    leaves = jax.tree.leaves(what, is_leaf=lambda node: isinstance(node, Paths))
    edges = sorted({leaf.edges for leaf in leaves if isinstance(leaf, Paths)})
    of = f"paths of {' or '.join(map(str, edges))} edges: " if edges else ""
    return ValueError(f"{of}the light of a path is NaN or infinite{further}; look at the scene's lamps")


@wide_jit
def _sampled(
    key: Key, target: Multiplexed, paths: Paths | None, first: Array, count: Array, only: int | None
) -> tuple[Array, Array]:
    """Of each lane and pixel the sum over `count` samples, and that of their squares: two of shape (pixels, lanes)."""
    dtype = jnp.zeros(()).dtype
    target, paths = cast((target, paths), dtype)
    pixels = 1 if paths is None else paths.sensor.pixels

    def body(k: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        numbers = uniforms(key, first + k, (target.dim_u + 1, _LANES), dtype)
        seen = uniform_states(target, numbers[0], numbers[1:], only).seen
        value = ((target.n_techniques if only is None else 1) * jnp.exp(seen.log_c))[None]
        if paths is not None:
            pixel = jax.vmap(paths.pixel, in_axes=-1)(seen.x)
            value = jnp.where(pixel[None] == jnp.arange(pixels)[:, None], value, 0)
        return sums[0] + value, sums[1] + value * value

    zero = jnp.zeros((pixels, _LANES), dtype)
    return jax.lax.fori_loop(0, count, body, (zero, zero))
