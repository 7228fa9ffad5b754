"""A class for an instance, a bare target, a key of another generator: one line that says the fix.

In a process of its own: here the types are checked at run time, and would complain first.
"""

import json
import subprocess
import sys

import pytest

CALLS = {
    "run(key, moves.SmallStep, target, steps=1)": "run: the kernel: give an instance, SmallStep(...), not the class",
    "run(key, 3, target, steps=1)": "run: the kernel must be a Kernel, not a int; give a Kernel or a Move",
    "trace(key, moves.SmallStep, target, steps=1, chains=1)": "trace: the kernel: give an instance, SmallStep(...)",
    "run(key, move, targets.Sinusoid(), steps=1)": "wrap it: Multiplexed(target, techniques)",
    "trace(key, move, targets.Sinusoid(), steps=1, chains=1)": "wrap it: Multiplexed(target, techniques)",
    "Metropolis(moves.SmallStep)": "Metropolis: the move: give an instance, SmallStep(...)",
    "Cycle([moves.SmallStep])": "Cycle: a kernel: give an instance, SmallStep(...)",
    "moves.Mixture({'a': (1, moves.SmallStep)})": "Mixture: move 'a': give an instance, SmallStep(...)",
    "techniques.Mixture((techniques.Tent,), (1,))": "Mixture: a lobe: give an instance, Tent(...)",
    "moves.StepAndChange(moves.LargeStep)": "StepAndChange: the step: give an instance, LargeStep(...)",
    "exact_start(key, targets.Sinusoid(), 10)": "wrap it: Multiplexed(target, techniques)",
    "normalisation(key, targets.Sinusoid())": "wrap it: Multiplexed(target, techniques)",
    "flatland.Material(exponent='20')": "Material: exponent must be a whole number",
    "flatland.Material(exponent=2.5)": "Material: exponent must be a whole number from 1 to 200, not 2.5",
    "flatland.Segment((0, 0, 1), (1, 1))": "Segment: start is a point, two numbers",
    "flatland.Material(emission='1')": "Material: emission is a number, not '1'",
    "flatland.Pinhole((0.0, 0.0), (1.0, 0.0), pixels=2.5)": "Pinhole: pixels must be a whole number",
    "tempering.replicas(3, [1.0])": "replicas: the target must be a Target",
    "tempering.replicas(targets.Sinusoid(), [1.0], techniques.Tent)": "replicas: the technique: give an instance",
    "verify.check_move(moves.SmallStep)": "check_move: the move: give an instance, SmallStep(...)",
    "verify.check_move(move, targets.Sinusoid())": "wrap it: Multiplexed(target, techniques)",
    "verify.check_technique(techniques.Tent)": "check_technique: the technique: give an instance, Tent(...)",
    "run(jax.random.key(0, impl='rbg'), move, target, steps=1)": "the random key must be one threefry key",
}
SCRIPT = """
import json, sys
import jax
from mcmc1d import *
from mcmc1d import flatland, tempering
key, move, target = jax.random.key(0), moves.SmallStep(), Multiplexed(targets.Sinusoid(), techniques.Uniform())
said = {}
for call in json.loads(sys.argv[1]):
    try:
        said[call] = f"no error but {eval(call)}"
    except ValueError as error:
        said[call] = f"{type(error).__name__}: {error}"
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said():
    command = [sys.executable, "-c", SCRIPT, json.dumps(list(CALLS))]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.parametrize("call", CALLS)
def test_the_wrong_kind_of_thing_is_told_with_the_fix(call, said):
    assert said[call].startswith("ValueError: ")
    assert CALLS[call] in said[call]
