"""A technique as two maps of NumPy arrays in one precision, with the derivatives that a contract looks at."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.compiling import quickly
from mcmc1d.techniques import Technique, checked_shape
from mcmc1d.types import Array, Float, Scalar
from mcmc1d.verify.contract import numbers


class Maps:
    """`forward` and `inverse` of a technique over arrays of points; an image is (x, v) in one row."""

    def __init__(self, technique: Technique, dtype: np.dtype):
        self.technique, self.dtype = technique, dtype
        self.shape = checked_shape(technique, dtype)
        self.d = int(np.prod(self.shape))

    def forward(self, u: np.ndarray) -> list[np.ndarray]:
        """(x, v) in one array, log_det, and the derivatives of both with respect to u."""
        return [np.asarray(a) for a in _over(_Forward(self.technique), jnp.asarray(u, self.dtype))]

    def inverse(self, image: np.ndarray) -> list[np.ndarray]:
        """u, log_det, and log_prob."""
        return [np.asarray(a) for a in _over(_Inverse(self.technique, self.shape), jnp.asarray(image, self.dtype))]

    def prob(self, image: np.ndarray) -> np.ndarray | None:
        """The density itself, where the technique defines it."""
        if type(self.technique).prob is Technique.prob:
            return None
        found = _over(_Density(self.technique, self.shape), jnp.asarray(image, self.dtype))
        return None if found is None else np.asarray(found)

    def x(self, image: np.ndarray) -> str:
        """The sample of one image, for a message."""
        return numbers(image[: self.d].reshape(self.shape))

    @property
    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """The lower and upper corner of the support, each of shape (d,)."""
        lower, upper = (np.asarray(corner, self.dtype).ravel() for corner in self.technique.support)
        return np.broadcast_to(lower, (self.d,)), np.broadcast_to(upper, (self.d,))

    @property
    def support(self) -> str:
        """The support for a message, with the reminder that it is the default where it is."""
        inherited = type(self.technique).support is Technique.support
        lower, upper = (np.asarray(corner).tolist() for corner in self.technique.support)
        return f"the support [{lower}, {upper}]" + (", the default: define `support`" if inherited else "")


class _Forward(eqx.Module):
    technique: Technique

    def __call__(self, u: Float[Array, " m"]) -> tuple[Array, Scalar, Array, Array]:
        def flat(u: Float[Array, " m"]) -> tuple[Array, Scalar]:
            x, v, log_det = self.technique.forward(u)
            # A number of NumPy's is a float64, and so would be x: held to what a chain in this precision has.
            return jnp.concatenate([jnp.ravel(x), v]).astype(u.dtype), log_det

        return *flat(u), *jax.jacfwd(flat)(u)


class _Inverse(eqx.Module):
    technique: Technique
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, image: Float[Array, " m"]) -> tuple[Array, Scalar, Scalar]:
        d = int(np.prod(self.shape))
        x = image[:d].reshape(self.shape)
        u, log_det = self.technique.inverse(x, image[d:])
        return u.astype(image.dtype), log_det, self.technique.log_prob(x)


class _Density(eqx.Module):
    technique: Technique
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, image: Float[Array, " m"]) -> Scalar | None:
        return self.technique.prob(image[: int(np.prod(self.shape))].reshape(self.shape))


@quickly
def _over(function: Callable, points: Float[Array, "n m"]) -> Any:
    return jax.vmap(function)(points)
