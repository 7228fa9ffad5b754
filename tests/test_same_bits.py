"""Another process gets the same bits from the same seed: the runner, a trace, and the transition operator."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = """
import hashlib
import jax, mcmc1d, numpy as np
from mcmc1d import moves, targets, techniques, verify
target = mcmc1d.Multiplexed(targets.Sinusoid(), (techniques.Tent(), techniques.Uniform()))
move = moves.Mixture({"small": (0.7, moves.SmallStep(0.1)), "jump": (0.3, moves.ReversibleJump())})
law = {"law": mcmc1d.Histogram(20, joint=True)}
run = mcmc1d.run(jax.random.key(3), move, target, steps=16, chains=64, blocks=4, estimators=law)
trace = mcmc1d.trace(jax.random.key(3), move, target, steps=16, chains=8)
operator = verify.transition_operator(move, target, points=2**14)
for part in (run.sums["law"], trace.x, operator.law_of(np.linspace(0, 1, 21)).masses):
    assert np.isfinite(part).all()
    print(hashlib.sha256(np.ascontiguousarray(part).tobytes()).hexdigest())
"""


@pytest.fixture(scope="module")
def found():
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax")}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", SCRIPT]
    runs = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    return [run.stdout.split() for run in runs]


@pytest.mark.slow
@pytest.mark.parametrize("part", range(3), ids=["run", "trace", "operator"])
def test_the_same_seed_gives_the_same_bits(part, found):
    first, second = found
    assert len(first) == len(second) == 3
    assert first[part] == second[part]
