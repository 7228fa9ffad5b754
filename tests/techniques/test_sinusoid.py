"""The raised sinusoid in float32, held to a bound that is derived and not tuned."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discover import examples

from mcmc1d.numerics import cast
from mcmc1d.techniques import RaisedSinusoid

SINE = 2.4e-7  # the error of `sin_turns` in float32: see SINE_TOLERANCE in tests/test_numerics.py
TECHNIQUES = {name: t for name, t in examples("mcmc1d.techniques").items() if isinstance(t, RaisedSinusoid)}
TECHNIQUES["flat_at_zero_one_period"] = RaisedSinusoid(-1.0, 1, 0.25)


def exact(technique, x):
    """The distribution function and the density in extended precision, the difference of two cosines as a product."""
    x, n, pi = (
        x.astype(np.longdouble),
        technique.frequency,
        np.longdouble(np.pi) + np.longdouble(1.2246467991473532e-16),
    )
    a, phase = np.longdouble(technique.amplitude), np.longdouble(technique.phase)
    wave = np.sin(pi * (n * x + 2 * phase)) * np.sin(pi * n * x)
    return x + a / (pi * n) * wave, 1 + a * np.sin(2 * pi * (n * x + phase))


@pytest.mark.parametrize("name", TECHNIQUES)
def test_the_quantile_in_float32_is_as_good_as_its_sine_and_its_result(name):
    """|P(x) - u| <= 2 e s / (pi n) + p(x) ulp(x) + 4 roundings of x and u.

    P is x plus e / (pi n) times a product of two sines, each off by s at most; x can not be told apart from its
    neighbours, p(x) ulp(x) away in u; and a sum of a few terms under max(x, u) rounds by as many halves of an ulp.
    """
    technique = TECHNIQUES[name]
    rng = np.random.default_rng(0)
    u = np.concatenate([rng.random(100_000), np.geomspace(1e-7, 0.9999999, 50_000), np.linspace(0.005, 0.02, 20_000)])
    u = np.unique(u.astype(np.float32))
    x = np.asarray(jax.jit(jax.vmap(cast(technique, np.float32).quantile))(jnp.asarray(u)))
    p_x, density = exact(technique, x)
    half = np.finfo(np.float32).eps / 2
    sine = 2 * abs(float(technique.amplitude)) * SINE / (np.pi * technique.frequency)
    bound = sine + density * np.spacing(x) + 4 * half * np.maximum(x, u)
    error = np.abs(p_x - u.astype(np.longdouble))
    assert np.all(error <= bound), f"u = {u[np.argmax(error / bound)]}"
    assert np.max(error / bound) > 0.2  # the bound is no empty one
