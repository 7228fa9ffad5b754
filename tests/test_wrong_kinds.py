"""A class for an instance, a bare target, a key of another generator: one line that says the fix.

In a process of its own: here the types are checked at run time, and would complain first.
"""

import json
import subprocess
import sys

import pytest

CALLS = {
    "run(key, moves.SmallStep, target, steps=1)": "run: the kernel: give an instance, SmallStep(...), not the class",
    "run(key, 3, target, steps=1)": "run: the kernel must be a Kernel, not an int; give a Kernel or a Move",
    "trace(key, moves.SmallStep, target, steps=1, chains=1)": "trace: the kernel: give an instance, SmallStep(...)",
    "run(key, move, targets.Sinusoid(), steps=1)": "wrap it: Multiplexed(target, techniques)",
    "trace(key, move, targets.Sinusoid(), steps=1, chains=1)": "wrap it: Multiplexed(target, techniques)",
    "Metropolis(moves.SmallStep)": "Metropolis: the move: give an instance, SmallStep(...)",
    "Cycle([moves.SmallStep])": "Cycle: a kernel: give an instance, SmallStep(...)",
    "moves.Mixture({'a': (1, moves.SmallStep)})": "Mixture: move 'a': give an instance, SmallStep(...)",
    "techniques.Mixture((techniques.Tent,), (1,))": "Mixture: a lobe: give an instance, Tent(...)",
    "moves.StepAndChange(moves.LargeStep)": "StepAndChange: the step: give an instance, LargeStep(...)",
    "targets.FromFunction(abs, (0, 0), (1, 1))": "it is of one coordinate, between two numbers",
    "exact_start(key, targets.Sinusoid(), 10)": "wrap it: Multiplexed(target, techniques)",
    "normalisation(key, targets.Sinusoid())": "wrap it: Multiplexed(target, techniques)",
    "flatland.Light(flatland.scenes.scene('box'))": "Light: the paths must be a Paths, not a Scene",
    "flatland.independent(key, flatland.Paths(flatland.scenes.scene('box'), 2), 8)": "independent: the target must be",
    "flatland.Wall('floor', pixels=10**7)": "Wall: pixels must be 1000000 at most, not 10000000",
    "compare(integrate(key, 'pt', flatland.scenes.scene('box'), lengths=2, samples=64), {})": "not a dict; of a Refer",
    "flatland.picture(3, 'image', 1.0)": "picture: the run must be a Run, not an int",
    "flatland.reference.image(flatland.scenes.scene('box'), 1, 5)": "resolution must be a Resolution, not an int",
    "verify.check_move(Returns())": "Returns.propose: what it returns must be a Proposal, not a State",
    "verify.step_operator(lambda k, x: x, log_density=lambda x: -x[0]**2, lower=0.0, upper=numpy.inf)": "give finite",
    "flatland.Material(exponent='20')": "Material: exponent must be a whole number",
    "flatland.Material(exponent=2.5)": "Material: exponent must be a whole number from 1 to 200, not 2.5",
    "flatland.Segment((0, 0, 1), (1, 1))": "Segment: start is a point, two numbers",
    "flatland.Segment((0, 0), (1, 1), name=5)": "Segment: the name must be a str",
    "flatland.Segment((0, 1j), (1, 2))": "Segment: start is a point, two numbers",
    "flatland.Segment((0, (1, 2)), (1, 2))": "Segment: start is a point, two numbers",
    "flatland.Segment((True, 0), (1, 2))": "Segment: start is a point, two numbers",
    "flatland.Material(lambert=True)": "Material: lambert is a number, not True",
    "flatland.Material(emission=10**400)": "Material: emission is a number, not 1000",
    "flatland.Pinhole((0.0, 0.0), (1.0, 0.0), half_angle=True)": "half_angle is a number, in radians, not True",
    "flatland.Material(lambert=1 + 1e-7)": "must sum to 1 at most, not 1.0000001",
    "flatland.Material(emission='1')": "Material: emission is a number, not '1'",
    "flatland.Pinhole((0.0, 0.0), (1.0, 0.0), 1e-12, 2)": "2 pixels in a half_angle of 1e-12 are narrower than 1e-09",
    "flatland.Pinhole((0.0, 0.0), (1.0, 0.0), pixels=2.5)": "Pinhole: pixels must be a whole number",
    "tempering.replicas(3, [1.0])": "replicas: the target must be a Target",
    "tempering.replicas(targets.Sinusoid(), [1.0], techniques.Tent)": "replicas: the technique: give an instance",
    "verify.check_move(moves.SmallStep)": "check_move: the move: give an instance, SmallStep(...)",
    "verify.check_move(move, targets.Sinusoid())": "wrap it: Multiplexed(target, techniques)",
    "verify.check_technique(techniques.Tent)": "check_technique: the technique: give an instance, Tent(...)",
    "run(key, move, target, steps=1, chains=8, start=3)": "run: start must be a State, not an int",
    "run(key, moves.SmallStep([0.1, 0.2]), target, steps=1)": "it proposes u of shape (2,), and a state's is (1,);",
    "run(key, move, target, steps=1, every='a')": "run: every is a number of seconds, not 'a'",
    "moves.SmallStep(1e6)": "SmallStep: sigma is a share of the unit interval, 100 at most, not 1000000.0",
    "moves.UniformStep(1e6)": "UniformStep: width is a share of the unit interval",
    "techniques.Ramp([1, 2])": "a parameter is one number here, not [1, 2]",
    "techniques.Mixture(techniques.Uniform(), 1.0)": "Mixture: the lobes are several: give a list of them",
    "Cycle(moves.LargeStep())": "Cycle: its kernels are several: give a list of them",
    "targets.FromFunction(abs, breaks=0.5)": "FromFunction: breaks are several: give a list of them",
    "targets.FromFunction(abs, breaks=(numpy.nan,))": "FromFunction: breaks are places, not (nan,)",
    "targets.FromFunction(3)": "FromFunction: f is a function of x, not 3",
    "Multiplexed(targets.FromFunction(lambda x: 1j * x), techniques.Tent())": "f returned a complex number",
    "targets.GaussianMixture([], [], [])": "must be lists of one length, not of shapes [(0,)]",
    "Histogram([0, 0.5, 1], domain=(0, 2))": "give no domain beside them",
    "Histogram(5, domain=(1, 0))": "Histogram: the edges must rise",
    "Expectation('x')": "Expectation: give a function of x, not 'x'",
    "verify.check_technique(techniques.Tent(), dtypes=(numpy.float16,))": "dtypes are float32 and float64, not float16",
    "run(0, move, target, steps=1)": "run: the key must be one of JAX, such as jax.random.key(0)",
    "exact_start(0.5, target, 1)": "exact_start: the key must be one of JAX, such as jax.random.key(0)",
    "run(jax.random.split(key), move, target, steps=1)": "run: the key must be one of JAX",
    "run(key, move, target, steps=1.5)": "run: steps must be a whole number, 1 at least, not 1.5",
    "run(key, move, target, steps=True)": "run: steps must be a whole number, 1 at least, not True",
    "run(key, move, target, steps=1, chains=8, blocks=2.0)": "run: blocks must be a whole number",
    "run(key, move, target, steps=1, estimators=[Histogram()])": "run: give estimators by name, a dict, not a list",
    "run(key, move, target, steps=1, estimators={'x': Histogram})": "estimator 'x': give an instance, Histogram(...)",
    "trace(key, move, target, steps=1.5, chains=1)": "trace: steps must be a whole number",
    "trace(key, move, target, steps=2**31, chains=1)": "trace: steps are counted in 32 bits, and 2147483648 are too",
    "trace(key, move, target, steps=1, chains=1, dtype=float)": "trace: dtype must be float32, or float64 with",
    "exact_start(key, target, 1, dtype=float)": "exact_start: dtype must be float32, or float64 with JAX's x64 on, not",
    "subchain.SubChain(move, move, 1.5)": "SubChain: length must be a whole number, 1 at least, not 1.5",
    "lazy.LazySampler(2, streams=1.5)": "LazySampler: streams must be a whole number, 1 at least, not 1.5",
    "lazy.chain_lengths(5.5, 2)": "chain_lengths: total must be a whole number, 0 at least, not 5.5",
    "pixels.Pixels(2.5)": "Pixels: side must be a whole number, 1 at least, not 2.5",
    "techniques.product.cube(2.5)": "cube: m must be a whole number, 1 at least, not 2.5",
    "verify.RingStep(2.5, {1: 1.0})": "RingStep: n must be a whole number, 1 at least, not 2.5",
    "verify.Ledger(expected=2.5)": "Ledger: expected must be a whole number, 1 at least, not 2.5",
    "verify.ledger.Scheme(stages=2.5)": "Scheme: stages must be a whole number, 1 at least, not 2.5",
    "verify.deposit_law(move, target, [0, 1], points=2048.0)": "points, a power of two, must be a whole number, 1024",
    "verify.deposit_law(move, target, [0, 1], points=2000)": "points must be a power of two, 1024 at least, not 2000",
    "verify.deposit_law(move, target, [0, 1], scrambles=1)": "scrambles, for an error estimate, must be a whole number",
    "normalisation(key, target, 2.5)": "normalisation: samples must be a whole number, 2 at least",
    "moves.SmallStep('a')": "a parameter is a number, or an array of them, not 'a'",
    "moves.Exchange('a')": "Exchange: width must be a whole number, 1 at least, not 'a'",
    "moves.ReplicaStep(moves.ScaledStep())": "ReplicaStep: the step must be an EachAlone, not a ScaledStep",
    "moves.CoordinateStep(0.1, 0.5)": "CoordinateStep: coordinate must be a whole number, 0 at least, not 0.5",
    "moves.Mixture({'a': move})": "Mixture: of move 'a' give (probability, move), not SmallStep",
    "moves.Mixture([move])": "Mixture: give moves by name",
    "moves.MultipleTry(move, 1.5)": "MultipleTry: tries must be a whole number, 1 at least, not 1.5",
    "moves.MultipleTry(move, candidates=moves.Stratified)": "the candidates: give an instance, Stratified(...)",
    "tempering.replicas(targets.Ring(), [1.0])": "name another: replicas(target, betas, technique)",
    "flatland.integrators.integrate(key, 'pt', flatland.scenes.scene('box'), lengths=1.5)": "must be a whole number",
    "flatland.Segment((0, 0), (1, 1), 3)": "Segment: the material must be a Material, not an int",
    "flatland.Pinhole(3, (1.0, 0.0))": "Pinhole: position is a point, two numbers, not 3",
    "flatland.Pinhole((0.0, 0.0), (1.0, 0.0), half_angle='0.6')": "half_angle is a number, in radians, not '0.6'",
    "flatland.integrators.MMLT(chains=1e3)": "MMLT: chains, for a standard error, must be a whole number, 2 at least",
    "flatland.integrators.MLT(chains=1e3)": "MLT: chains, for a standard error, must be a whole number, 2 at least",
    "flatland.integrators.MLT(bidirectional=0.9)": "the shares of its mutations must not be negative and sum to 1",
    "flatland.integrators.StagedMLT(chains=1e3)": "chains, for a standard error, must be a whole number",
    "flatland.integrators.InstantRadiosity(cameras=8.0)": "cameras must be a whole number, 1 at least, not 8.0",
    "flatland.integrators.PhotonDensity(photons=8.0)": "photons must be a whole number, 1 at least, not 8.0",
    "flatland.Exposure('box')": "Exposure: the paths must be a Paths, not a str",
    "flatland.Bidirectional(BOX, 2)": "lengths are several numbers t, such as (2,), not 2",
    "flatland.Paths(flatland.scenes.scene('box'), 65)": "65 edges; 64 at most, or the densities leave single precision",
    "OverPixels(flatland.Light(BOX), [1.0])": "one number for each of 16 pixels, not of shape (1,)",
    "OverPixels(flatland.Light(BOX), numpy.zeros(16))": "must be positive and finite, or a pixel's light is",
    "OverPixels(flatland.Light(BOX), numpy.ones(16), 'eye')": "the shader must be a Shader, not a str",
    "flatland.picture(None, 'x', 'b')": "picture: b is a number, or a Normalisation, not 'b'",
    "flatland.Wall(3)": "Wall: segment is a segment's name, not 3",
    "flatland.Scene('a', [3], flatland.Wall('b'))": "scene a: segment 0 must be a Segment, not an int",
    "flatland.Scene('a', [flatland.Segment((0, 0), (1, 1))], 4)": "the sensor must be a Pinhole or a Wall, not 4",
    "verify.verify(move, target, name=3)": "name is a text, not 3",
    "verify.enumerate_kernel(move, target, State([0], [[0.5]]), [0, None])": "an integer of `numbers` must be a whole",
    "verify.enumerate_kernel(move, target, State([0], [[0.5]]), inner=0)": "inner must be a whole number, 1 at least",
    "verify.check_technique(techniques.Tent(), points=0)": "points must be a whole number, 1 at least, not 0",
    "verify.step_operator(lambda k, x: x, log_density=lambda x: 0 * x, lower=0.0, upper=1.0)": "must be one number",
    "verify.verify(verify.HostKernel(walk), verify.laws.normal(1))": "walk takes a JAX key: give it without HostKernel",
    "verify.verify(walk, target)": "whose position is {index: int32[], u: float32[1], x: float32[]}",
    "verify.verify(walk, verify.Law(draws, scipy.special.ndtr, log_density=numpy.square))": "law: log_density, a",
    "Multiplexed(targets.FromFunction(numpy.exp), techniques.Uniform())": "f, or a weight, can not be traced by JAX",
    "run(key, move, target, steps=1, chains=8).mean('x')": "no estimator of this run is called 'x'; it has none",
    "run(key, Bare(), target, steps=1)": "Bare.propose: what it returns must be a Proposal, not a tuple",
    "run(key, Careless(), target, steps=1)": "Careless.propose: log_det must be one number for one state, not of",
    "run(key, move, target, steps=2**31)": "run: steps are counted in 32 bits, and 2147483648 are too many",
    "Multiplexed(targets.Sinusoid(), techniques.Uniform(), weights.Balance)": "the weights: give an instance, Balance",
    "Multiplexed(targets.Sinusoid(), techniques.Uniform(), 'balance')": "the weights must be a Weights, not a str, nor",
    "run(jax.random.key(0, impl='rbg'), move, target, steps=1)": "the random key must be one threefry key",
}
SCRIPT = """
import json, sys
import jax, numpy, scipy.special
from mcmc1d import *
import mcmc1d.flatland.reference
from mcmc1d import flatland, lazy, pixels, subchain, tempering
from mcmc1d.flatland.importance import OverPixels
from mcmc1d.flatland.integrators import integrate
from mcmc1d.flatland.integrators.compare import compare
key, move, target = jax.random.key(0), moves.SmallStep(), Multiplexed(targets.Sinusoid(), techniques.Uniform())
BOX = flatland.Paths(flatland.scenes.scene("box"), 2)
def walk(key, x): return x + jax.random.normal(key, x.shape)
def draws(rng, n): return rng.normal(size=n)
class Careless(moves.SmallStep):
    def propose(self, target, state, w):
        return moves.Proposal(state, w, jax.numpy.zeros(1))
class Bare(moves.SmallStep):
    def propose(self, target, state, w):
        return state, w, jax.numpy.zeros(())
class Returns(moves.SmallStep):
    def propose(self, target, state, w):
        return state
said = {}
for call in json.loads(sys.argv[1]):
    try:
        said[call] = f"no error but {eval(call)}"
    except Exception as error:  # one of another kind fails its own test, not all of them
        said[call] = f"{type(error).__name__}: {error}"
print(json.dumps(said))
"""


RETURNED = {
    "(u[0], z), (x[None], z), z": "Own.forward must return x, v, log_det, each an array; it returned an array",
    "(u[0], None, z), (x[None], z), z": "each an array; it returned an array, NoneType, an array",
    "(u[0], u, z), (x[None], z), z": "what x forgets of u must be returned as v, of shape (0,), not (1,)",
    "(u[0], u[1:], z[None]), (x[None], z), z": "Own.forward: log_det must have the shape (), not (1,)",
    "(u[0], u[1:], z), (x, z), z": "Own.inverse: u must have the shape (1,), not ()",
    "(u[0], u[1:], z), x[None], z": "Own.inverse must return u, log_det, each an array; it returned an array",
    "(u[0], u[1:], z), (x[None], z), z[None]": "Own.log_prob: log_density must have the shape (), not (1,)",
    "(u[0], u[1:], z), (x[None], z), None": "Own.log_prob must return log_density, each an array; it returned NoneType",
}
OWN = """
def own(text):
    def returned(k, **names):
        return eval(text, {"z": jax.numpy.zeros(())} | {"u": jax.numpy.zeros(1), "x": jax.numpy.zeros(())} | names)[k]
    class Own(techniques.Technique):
        dim_u = 1
        def forward(self, u): return returned(0, u=u)
        def inverse(self, x, v): return returned(1, x=x)
        def log_prob(self, x): return returned(2, x=x)
    return Own()
"""


@pytest.fixture(scope="module")
def said():
    command = [sys.executable, "-c", OWN + SCRIPT, json.dumps([*CALLS, *OWNS])]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


OWNS = {
    call: message
    for text, message in RETURNED.items()
    for call in (
        f"Multiplexed(targets.Sinusoid(), own({text!r}))",
        f"verify.check_technique(own({text!r}))",
        f"techniques.Product((own({text!r}), techniques.Tent()))",
        f"techniques.Compose((own({text!r}), techniques.Tent()))",
    )
}


@pytest.mark.parametrize("call", OWNS)
def test_what_a_technique_returns_in_a_wrong_shape_is_named(call, said):
    """A (1,) where a () is asked for broadcasts, and a run would go on with it."""
    assert said[call].startswith("ValueError: ")
    assert OWNS[call] in said[call]


@pytest.mark.parametrize("call", CALLS)
def test_the_wrong_kind_of_thing_is_told_with_the_fix(call, said):
    assert said[call].startswith("ValueError: ")
    assert CALLS[call] in said[call]
