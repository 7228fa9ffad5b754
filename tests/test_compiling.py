"""Programs compiled for the widest vectors compute what those for XLA's default do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax._src.dtypes import canonicalize_value
from jax.scipy import special

import mcmc1d
from mcmc1d import verify
from mcmc1d.compiling import jit_with, wide_jit
from mcmc1d.moves import SmallStep

# fmt: off
_ONE = [
    lax.abs, lax.acos, lax.acosh, lax.asin, lax.asinh, lax.atanh, lax.cbrt, lax.ceil, lax.cos, lax.cosh, lax.digamma,
    lax.erf, lax.erfc, lax.erf_inv, lax.exp, lax.exp2, lax.expm1, lax.floor, lax.lgamma, lax.log, lax.log1p,
    lax.logistic, lax.neg, lax.reciprocal, lax.round, lax.rsqrt, lax.sign, lax.sin, lax.sinh, lax.sqrt, lax.square,
    lax.tan, lax.tanh, lax.bessel_i0e, lax.bessel_i1e,
]
_TWO = [
    lax.atan2, lax.add, lax.div, lax.max, lax.min, lax.mul, lax.nextafter, lax.pow, lax.rem, lax.sub, lax.igamma,
    lax.igammac, jnp.logaddexp,
]
# fmt: on


def elementary(x, y):
    """Everything elementwise that XLA has for floats, but the arctangent."""
    parts = {f.__name__: f(1 + x if f is lax.acosh else 0.3 * x) for f in _ONE}
    parts |= {f.__name__: f(x, y) for f in _TWO} | {"ndtri": special.ndtri(x / 4), "ndtr": special.ndtr(y)}
    return parts


@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
def test_wide_vectors_compute_what_narrow_ones_do(dtype):
    x, y = (np.random.default_rng(k).uniform(0.1, 3, 4099).astype(dtype) for k in (0, 1))
    with jax.enable_x64(dtype == np.float64):
        wide, narrow = jit_with(xla_cpu_prefer_vector_width=512)(elementary)(x, y), jax.jit(elementary)(x, y)
    for name, value in narrow.items():
        scale = 2e-6 if dtype == np.float32 else 1e-13
        assert np.allclose(wide[name], value, rtol=scale, atol=scale, equal_nan=True), name


def _in_a_loop(x):
    return lax.fori_loop(0, 2, lambda _, y: jnp.arctan(y), x)


def _in_a_branch(x):
    return lax.cond(x[0] > 2, jnp.exp, lambda x: jnp.arctan(jnp.arctan(x)), x)


@pytest.mark.parametrize("function", [_in_a_loop, _in_a_branch, jax.jit(lambda x: jnp.arctan(jnp.arctan(x)))])
def test_an_arctangent_is_right_wherever_it_stands(function):
    """With AVX-512 it would be random: XLA passes sixteen floats in a way in which its function does not take them."""
    x = np.random.default_rng(0).uniform(-3, 3, 4096).astype(np.float32)
    x[0] = 1
    compiled = wide_jit(function)
    for _ in range(2):
        assert np.allclose(compiled(x), np.arctan(np.arctan(x)), atol=1e-6)


def test_a_kernel_with_an_arctangent_is_verified():
    """A walk in t = arctan(x) on Cauchy's law, whose ratio has Cauchy's own Jacobian; as if symmetric, it fails."""
    law = verify.Law(
        sample=lambda rng, n: rng.standard_cauchy(n), cdf=lambda x: 0.5 + np.arctan(x) / np.pi, name="Cauchy"
    )

    def walk(key, x, right=1.0):
        first, second = jax.random.split(key)
        t = jnp.arctan(x) / jnp.pi + 0.2 * jax.random.normal(first)
        y = jnp.tan(jnp.pi * (t - jnp.round(t)))
        accepted = jnp.log1p(-jax.random.uniform(second)) < (1 - right) * (jnp.log1p(x * x) - jnp.log1p(y * y))
        return jnp.where(accepted, y, x)

    assert verify.verify(walk, law, replicas=2**14).passed
    assert verify.verify(lambda key, x: walk(key, x, 0.0), law, replicas=2**14).verdict.value == "FAIL"


def test_an_array_that_a_function_closes_over_has_the_precision_of_whoever_traces_it():
    """What JAX makes of it is kept by each program that is alive; it was handed to programs of the other precision."""
    centre = np.array([0.25, 0.75])

    def near(x):
        return jnp.sum(x - centre)

    alive = jax.make_jaxpr(near)(np.float32(0))
    with jax.enable_x64(True):
        wide = jax.make_jaxpr(near)(np.float64(0))
        assert float(jax.jit(jax.vmap(near))(np.ones(2))[0]) == 1.0
    again = jax.make_jaxpr(near)(np.float32(0))
    assert [program.consts[0].dtype for program in (alive, wide, again)] == [np.float32, np.float64, np.float32]


def test_a_target_that_closes_over_arrays_is_probed_run_and_integrated():
    """In float64, float32 and float64: it could not be lowered. To 8 standard errors of 8 blocks (2e-4)."""
    centres, weights = np.array([0.2, 0.7]), np.array([1.0, 2.0])
    target = mcmc1d.targets.FromFunction(lambda x: jnp.sum(weights * jnp.exp(-(((x - centres) / 0.1) ** 2))))
    chain = mcmc1d.Multiplexed(target, (mcmc1d.techniques.Uniform(), mcmc1d.techniques.Tent()))
    kinds = {"half": mcmc1d.Histogram(2)}
    run = mcmc1d.run(jax.random.key(0), SmallStep(0.2), chain, steps=64, chains=1024, estimators=kinds)
    masses = target.bin_masses(np.array([0.0, 0.5, 1.0]))
    assert run.state.u.dtype == np.float32
    assert np.all(np.abs(run.mean("half") - masses / masses.sum()) < 8 * run.standard_error("half"))


def test_an_array_that_is_closed_over_twice_is_one_constant_and_what_is_no_number_is_refused():
    centre = np.array([0.25, 0.75])
    assert len(jax.make_jaxpr(lambda x: jnp.sum((x - centre) * (x + centre)))(1.0).consts) == 1
    with pytest.raises(TypeError):
        jax.make_jaxpr(lambda x: jnp.add(x, np.array(["a"])))(1.0)


def test_no_array_is_taken_for_one_that_is_gone():
    """Of arrays whose places in memory come again, while the constants that were made of them stay alive."""
    places, constants = [], []
    for k in range(1000):
        array = np.empty(3)
        array[:] = k
        places.append(id(array))
        constants.append(canonicalize_value(array))
        del array
    assert len(set(places)) < 1000
    assert [float(constant[0]) for constant in constants] == list(range(1000))
