"""What a function reads from outside of its arguments may change in a session: then what was compiled is not used."""

import functools
import types
import weakref
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import mcmc1d
from mcmc1d import moves, targets, techniques, verify
from mcmc1d.outside import forget_what_has_changed

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


class Chosen:
    def one(self, x):
        return 1.0 * x

    def three(self, x):
        return 3.0 * x

    step = one


chosen = Chosen()


def choose(value):
    Chosen.step = Chosen.one if value == 1.0 else Chosen.three


def asks(x):
    return chosen.step(x)


@jax.jit
def jitted(x):
    return number * x


def body(total, x):
    return total + number, number * x


def scanned(x):
    return jax.lax.scan(body, 0.0, x)[1]


def replaced(x):
    return 1.0 * x


CODE = {1.0: replaced.__code__, 3.0: (lambda x: 3.0 * x).__code__}
part = functools.partial(lambda by, x: by[0] * x, np.array([1.0]))
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
    "which of its methods is called": (asks, choose),
    "a global of a function under jit": (jitted, lambda value: set_global("number", value)),
    "a global of a loop's body": (scanned, lambda value: set_global("number", value)),
    "its own code": (replaced, lambda value: setattr(replaced, "__code__", CODE[value])),
    "an array of a partial": (part, lambda value: part.args[0].__setitem__(0, value)),
    "an attribute of its class": (stepper.step, lambda value: setattr(Stepper, "scale", value)),
}


@pytest.mark.parametrize("way", WAYS)
def test_what_is_compiled_follows_what_is_read(way):
    function, change = WAYS[way]
    compiled = jax.jit(function)
    for value in (1.0, 3.0, 1.0):
        change(value)
        forget_what_has_changed(function)
        np.testing.assert_allclose(compiled(jnp.arange(3.0)), value * np.arange(3.0))


def test_an_array_edited_in_place_is_another_constant_though_a_program_holds_the_old_one():
    own = np.array([1.0, 1.0])
    held = jax.make_jaxpr(lambda x: jnp.asarray(own) * x)(1.0)
    own[0] = 3.0
    np.testing.assert_array_equal(jax.jit(lambda x: jnp.asarray(own) * x)(1.0), [3.0, 1.0])
    np.testing.assert_array_equal(jax.core.eval_jaxpr(held.jaxpr, held.consts, 1.0)[0], [1.0, 1.0])


@pytest.fixture
def cleared(monkeypatch):
    """How often everything was forgotten."""
    times = []
    monkeypatch.setattr(jax, "clear_caches", lambda: times.append(1))
    return times


def counting(x):
    traces.append(1)
    return x


class Counter:
    def __init__(self):
        self.calls, self.results, self.by = 0, [], 2.0

    def step(self, x):
        self.calls += 1
        return self.by * x


class Pair:
    """Two methods of one object, in one call."""

    def __init__(self):
        self.one, self.two = 1.0, 2.0

    def step(self, x):
        return self.one * x

    def init(self, x):
        return self.two * x


class Odd:
    """Equal to all, and to no key."""

    __hash__ = None

    def __eq__(self, other):
        return True

    def __call__(self, x):
        return x


counter, traces, pair, odd = Counter(), [], Pair(), Odd()


def inner_key(x):
    key = jax.random.key(0)

    def inner(y):
        return y + jax.random.normal(key)

    return inner(x)


@jax.tree_util.register_dataclass
@dataclass
class Position:
    x: Any


UNRELATED = {
    "it counts how often it is traced": (counting, lambda: traces.append(1)),
    "its object counts its calls": (counter.step, lambda: setattr(counter, "calls", counter.calls + 1)),
    "its object keeps results": (counter.step, lambda: counter.results.append(1)),
    "a global is called as a variable of its own": (inner_key, lambda: set_global("key", object())),
    "two methods of one object": ((pair.step, pair.init), lambda: None),
    "an object without a hash": (odd, lambda: None),
    "a dtype": (np.dtype("f4"), lambda: None),
    "another state of a registered class": (Position(jnp.ones(2)), lambda: setattr(UNRELATED_STATE, "x", jnp.zeros(2))),
}
UNRELATED_STATE = UNRELATED["another state of a registered class"][0]


@pytest.mark.parametrize("what", UNRELATED)
def test_nothing_is_forgotten_for_what_it_does_not_read(what, cleared):
    it, change = UNRELATED[what]
    for _ in range(3):
        forget_what_has_changed(it, {"alike": [it]})
        change()
    assert not cleared


def test_another_function_of_the_same_code_is_no_change(cleared):
    for value in (1.0, 2.0, 3.0):
        forget_what_has_changed(lambda x, value=value: value * x)
    assert not cleared


class Raises:
    def __getattr__(self, name):
        raise KeyError(name)


class Endless:
    def __getattr__(self, name):
        return Endless()


class Jitted:
    net = eqx.nn.Identity()

    @eqx.filter_jit
    def step(self, x):
        return x


def chained():
    it = None
    for _ in range(2000):
        it = [it]
    return it


STRANGE = {
    "raises": Raises(),
    "never ends": Endless(),
    "a method under Equinox's jit": Jitted().step,
    "a chain of 2000 lists": chained(),
    "times": np.zeros(2, "datetime64[s]"),
    "half floats of JAX": np.zeros(2, jnp.bfloat16),
    "objects": np.array([None, 1], object),
    "a key": jax.random.key(0),
}


@pytest.mark.parametrize("what", STRANGE)
def test_what_is_strange_does_no_harm(what, cleared):
    strange = STRANGE[what]
    for _ in range(2):
        forget_what_has_changed(lambda x: (strange, x), strange)
    assert not cleared


class Slots:
    __slots__ = ("by",)

    def __init__(self):
        self.by = 1.0

    def __call__(self, x):
        return self.by * x


@pytest.mark.parametrize("make", [lambda: weakref.proxy(Counter()), Slots], ids=["gone", "slots"])
def test_what_can_not_be_looked_at_may_have_changed(make, cleared):
    forget_what_has_changed([make()])
    assert cleared


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
    set_global("tilt", 1.0)
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
    set_global("slope", 0.0)
