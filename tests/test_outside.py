"""What a function reads from outside of its arguments may change in a session: then what was compiled is not used."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import mcmc1d
from mcmc1d import moves, targets, techniques, verify
from mcmc1d.compiling import compiled, quickly, wide_jit
from mcmc1d.outside import Outside

number = 1.0
array = np.array([1.0, 1.0])
settings = {"scale": [1.0]}
module = types.ModuleType("module")
holder = types.SimpleNamespace(inner=types.SimpleNamespace(scale=1.0))


def helper():
    return number


class Stepper:
    scale = 1.0

    def __init__(self):
        self.own = 1.0

    def step(self, x):
        return self.own * self.scale * x


stepper = Stepper()


def rebind():
    cell = 1.0

    def step(x):
        return cell * x

    def change(value):
        nonlocal cell
        cell = value

    return step, change


bound, change_cell = rebind()


def default(x, by=None):
    return by[0] * x


default.__defaults__ = (np.array([1.0]),)


def nested(x):
    def inner(y):
        return number * y

    return inner(x)


def set_global(name, value):
    globals()[name] = value


WAYS = {
    "a global": (lambda x: number * x, lambda value: set_global("number", value)),
    "a global of a function that it calls": (lambda x: helper() * x, lambda value: set_global("number", value)),
    "a global of a function inside": (nested, lambda value: set_global("number", value)),
    "an array edited in place": (lambda x: array[1] * x, lambda value: array.__setitem__(1, value)),
    "a list in a dictionary": (lambda x: settings["scale"][0] * x, lambda v: settings["scale"].__setitem__(0, v)),
    "a module's attribute": (lambda x: module.scale * x, lambda value: setattr(module, "scale", value)),
    "an attribute of an attribute": (lambda x: holder.inner.scale * x, lambda v: setattr(holder.inner, "scale", v)),
    "a closure's variable": (bound, change_cell),
    "a default, edited in place": (default, lambda value: default.__defaults__[0].__setitem__(0, value)),
    "an attribute of the object it is a method of": (stepper.step, lambda value: setattr(stepper, "own", value)),
    "an attribute of its class": (stepper.step, lambda value: setattr(Stepper, "scale", value)),
}


@pytest.mark.parametrize("compile", [compiled, quickly, wide_jit])
@pytest.mark.parametrize("way", WAYS)
def test_what_is_compiled_follows_what_is_read(way, compile):
    function, change = WAYS[way]
    program = compile(lambda f, x: f(x))
    for value in (1.0, 3.0, 1.0):
        change(value)
        np.testing.assert_allclose(program(function, jnp.arange(3.0)), value * np.arange(3.0))


def test_nothing_is_compiled_again_where_nothing_has_changed():
    traced = []

    def function(x):
        traced.append(1)  # which changes what it reads, and makes it no other
        return number * x

    program = compiled(lambda f, x: f(x))
    for _ in range(5):
        program(function, jnp.ones(2))
    assert len(traced) == 1
    set_global("number", 2.0)
    np.testing.assert_array_equal(program(function, jnp.ones(2)), [2.0, 2.0])
    set_global("number", 1.0)


def test_a_key_is_equal_only_while_all_stays():
    function, change = WAYS["a closure's variable"]
    change(1.0)
    before = Outside(function)
    assert before == Outside(function)
    assert hash(before) == hash(Outside(function))
    change(2.0)
    assert before != Outside(function)
    change(1.0)
    assert before == Outside(function)


def test_a_loop_of_references_ends():
    ring = [1.0]
    ring.append(ring)
    assert Outside(lambda x: ring[0] * x) == Outside(lambda x: ring[0] * x)


tilt = 1.0


def walk(key, x):
    first, second = jax.random.split(key)
    y = x + jax.random.normal(first)
    return jnp.where(jnp.log(jax.random.uniform(second)) < tilt * 0.5 * (x * x - y * y), y, x)


def test_the_verdict_on_a_right_kernel_is_not_given_to_its_mutant():
    """At level 1e-5; the mutant's law has two thirds of the variance, a CDF gap of 0.05."""
    law = verify.Law(sample=lambda rng, n: rng.normal(size=n), cdf=norm.cdf)
    verdicts = []
    for value in (1.0, 1.5):
        set_global("tilt", value)
        verdicts.append(verify.verify(walk, law, replicas=2**13).verdict)
    assert verdicts == [verify.Verdict.PASS, verify.Verdict.FAIL]


slope = 0.0


def density(x):
    return 1 + slope * x


class Sloped(targets.Target):
    """A target that reads a global."""

    def log_f(self, x):
        return jnp.log(density(x))

    def bin_masses(self, edges):
        return self.quadrature(edges)


@pytest.mark.parametrize("make", [lambda: targets.FromFunction(density), Sloped])
def test_a_run_has_the_law_of_now(make):
    for value in (0.0, 8.0):
        set_global("slope", value)
        target = mcmc1d.Multiplexed(make(), techniques.Uniform())
        estimators = {"law": mcmc1d.Histogram(2)}
        run = mcmc1d.run(jax.random.key(0), moves.LargeStep(), target, steps=32, chains=2048, estimators=estimators)
        np.testing.assert_allclose(run.mean("law"), target.joint_masses([0, 0.5, 1])[0], atol=0.02)
