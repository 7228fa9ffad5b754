"""Shapes are found by tracing, once for techniques that are alike, and never taken for those of another."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from mcmc1d.techniques import Technique, Tent, checked_shape, dim_v, sample_shape
from mcmc1d.types import Array


class _Own(Technique):
    """x is the first `d` numbers of u, scaled; `seen` is told of every trace."""

    scale: Array
    seen: Callable[[], None] = eqx.field(static=True)
    d: int = eqx.field(static=True, default=1)
    extra: int = 0

    @property
    def dim_u(self):
        return 3 + self.extra

    def forward(self, u):
        self.seen()
        return self.scale * u[: self.d], u[self.d :], self.d * jnp.log(self.scale)

    def inverse(self, x, v):
        return jnp.concatenate([x / self.scale, v]), -self.d * jnp.log(self.scale)

    def log_prob(self, x):
        return -self.d * jnp.log(self.scale)


class _Count:
    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1


def test_techniques_that_differ_in_numbers_alone_are_traced_once():
    seen = _Count()
    for scale in (0.5, 0.7, 0.9):
        technique = _Own(jnp.float32(scale), seen)
        assert (sample_shape(technique), dim_v(technique)) == ((1,), 2)
    assert seen.calls == 1


@pytest.mark.parametrize("changed", [{"d": 2}, {"extra": 1}, {"d": 3, "extra": 2}])
def test_what_is_no_array_tells_two_apart(changed):
    seen = _Count()
    one, other = _Own(jnp.float32(0.5), seen), _Own(jnp.float32(0.5), seen, **changed)
    d, m = changed.get("d", 1), 3 + changed.get("extra", 0)
    assert (sample_shape(one), dim_v(one)) == ((1,), 2)
    assert (sample_shape(other), dim_v(other)) == ((d,), m - d)


def test_arrays_of_other_shapes_tell_two_apart():
    seen = _Count()
    shapes = [sample_shape(_Own(jnp.full(n, 0.5), seen, d=n)) for n in (1, 2)]
    widened = sample_shape(_Own(jnp.full(3, 0.5), seen))  # of what u[0] is multiplied by
    assert (shapes, widened) == ([(1,), (2,)], (3,))


class _Held(_Own):
    held: Any = eqx.field(static=True, default=None)


def test_what_is_alike_beside_the_arrays_is_one():
    seen = _Count()
    for held in ([0.0], [0.0], [1.0]):
        assert sample_shape(_Held(jnp.float32(0.5), seen, held=held)) == (1,)
    assert seen.calls == 2


class _AsMany(Technique):
    """It reads as many numbers as an array says."""

    n: np.ndarray

    @property
    def dim_u(self):
        return int(self.n)

    def forward(self, u):
        return u, u[:0], jnp.zeros(())

    def inverse(self, x, v):
        return x, jnp.zeros(())

    def log_prob(self, x):
        return jnp.zeros(())


def test_a_number_in_an_array_may_be_the_dimension():
    assert [sample_shape(_AsMany(np.array(n))) for n in (1, 2)] == [(1,), (2,)]


def test_a_type_in_a_field_is_no_array():
    class Typed(Tent):
        of: Any = jnp.float32

    assert sample_shape(Typed()) == ()


def test_the_dtype_can_be_named():
    assert checked_shape(Tent(), dtype=jnp.float32) == ()


def test_a_mistake_is_told_each_time():
    class Wrong(Tent):
        def forward(self, u):
            return u[0], u, jnp.zeros(())

    for _ in range(2):
        with pytest.raises(ValueError, match="Wrong"):
            checked_shape(Wrong())
