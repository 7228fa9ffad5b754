"""One device, two devices, two processes: the same seed gives the same bits, and what fails in one is told in all."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from mcmc1d import parallel

ROOT = Path(__file__).parents[1]

SCRIPT = """
import hashlib, sys
import jax, numpy as np
role, path, cores, address = sys.argv[1:]
if role.isdigit():
    jax.distributed.initialize(address, num_processes=2, process_id=int(role))
import mcmc1d
from mcmc1d import chain, moves, parallel, targets, techniques
chain._STEPS_PER_LOOK = 16
target = mcmc1d.Multiplexed(targets.Sinusoid(), (techniques.Tent(), techniques.Uniform()))
start = mcmc1d.State(np.arange(96) % 2, np.linspace(0, 1, 96, endpoint=False)[:, None])
used = set()
put = parallel.put
parallel.put = lambda tree, device: used.add(str(device)) or put(tree, device)

def run(seed=5, **changes):
    law = {"h": mcmc1d.Histogram(20, joint=True)}
    arguments = {"steps": 100, "chains": 96, "blocks": 3, "start": start, "estimators": law, **changes}
    return mcmc1d.run(jax.random.key(seed), moves.SmallStep(), target, **arguments)

def show(run):
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves((run.state, run.sums))]
    print(hashlib.sha256(b"".join(leaf.tobytes() for leaf in leaves)).hexdigest(), run.sums["h"].sum().round(3))

class Stop(Exception):
    pass

def stop(done, total):
    if done > total / 2:
        raise Stop

print(jax.process_count(), len(jax.local_devices()))
show(run())
print(*sorted(used))
try:
    run(checkpoint=path, every=0.0, progress=stop)
except Stop:
    show(run(checkpoint=path, resume=True))
if role.isdigit():
    for wrong in ({"seed": int(role)}, {"blocks": 1}, {"checkpoint": path, "resume": role == "0"}):
        try:
            run(**wrong)
        except ValueError as error:
            print(error)
"""


def start(role, path, *, devices=1, address=""):
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax"), "PYTHONPATH": str(ROOT)}
    environment |= {"XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}", "JAX_PLATFORMS": "cpu"}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    command = [sys.executable, "-c", SCRIPT, role, str(path), "", address]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finished(process):
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [line for line in out.splitlines() if not line.startswith("[Gloo]")]


def test_a_device_that_was_chosen_is_named_to_the_threads():
    """Also where it is the only one of its kind: they do not know of the choice."""
    cpu = jax.local_devices(backend="cpu")
    assert parallel.devices() == ([None] if len(jax.local_devices()) == 1 else jax.local_devices())
    for chosen, found in (("cpu", cpu), (cpu[0], cpu[:1])):
        with jax.default_device(chosen):
            assert parallel.devices() == found


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """One process with one device."""
    return finished(start("alone", tmp_path_factory.mktemp("alone") / "run"))


def test_one_device_and_a_resumed_run(alone):
    assert alone[0] == "1 1"
    assert alone[1].endswith(" 9600.0")
    assert alone[2] == "None"
    assert alone[3] == alone[1]


def test_two_devices_give_the_same_bits(alone, tmp_path):
    two = finished(start("two", tmp_path / "run", devices=2))
    assert two[0] == "1 2"
    assert two[2] == "cpu:0 cpu:1"
    assert two[1] == two[3] == alone[1]


def test_two_processes_give_the_same_bits(alone, tmp_path):
    with socket.socket() as free:
        free.bind(("localhost", 0))
        address = f"localhost:{free.getsockname()[1]}"
    processes = [start(str(k), tmp_path / "run", address=address) for k in range(2)]
    both = [finished(process) for process in processes]
    for found in both:
        assert found[0] == "2 1"
        assert found[1] == found[3] == alone[1]
        assert "what process 1 found is of another run: its key differs" in found[4] + both[0][4]
        assert found[5] == "run: 2 processes need as many blocks at least, not 1; give blocks="
        assert "process 1: the checkpoint" in found[6]
        assert "holds a run that was begun before" in found[6]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.0", "run.1"]
