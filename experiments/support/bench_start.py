"""What one process costs: importing, compiling with and without a cache, memory by steps, one core against two."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from experiments.support.sweep import Show

STEPS = (64, 512, 4096, 16384)

CHILD = """
import json, os, resource, sys, time
order = json.loads(sys.argv[1])
if order["cores"]:
    os.sched_setaffinity(0, order["cores"])
begin = time.perf_counter()
import mcmc1d
mcmc1d.run
imported = time.perf_counter() - begin
import jax
from experiments.support import bench_steps, sweep
sweep.keep_compiled(order["cache"])
target, move = bench_steps.multiplexed_step()
start = mcmc1d.exact_start(jax.random.key(0), target, order["chains"])
def run(steps):
    begin = time.perf_counter()
    done = mcmc1d.run(jax.random.key(1), move, target, steps=steps, chains=order["chains"], blocks=order["blocks"],
                      start=start, estimators={"x": mcmc1d.Histogram(100)})
    jax.block_until_ready(done.state)
    return time.perf_counter() - begin
compiled = run(1)
seconds = run(order["steps"])
# Linux hands a parent's ru_maxrss on to its children; the peak of this program's own memory is VmHWM.
try:
    memory = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")) / 1024
except OSError:
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"import": imported, "compile": compiled, "seconds": seconds, "memory": memory}))
"""


def measure(show: Show) -> dict[str, Any]:
    """Import and compile time in seconds, cold and cached; peak memory in MiB by steps; the gain of a second core."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    pairs = 5 if len(cores) >= 2 else 0
    total, done = 1 + len(STEPS) + 2 * pairs, 0

    with tempfile.TemporaryDirectory(prefix="mcmc1d-") as cache:

        def child(**order: Any) -> dict[str, float]:
            nonlocal done
            order = {"cores": cores[-1:], "chains": 2048, "blocks": 1, "steps": 1, "cache": cache, **order}
            result = _child(order)
            done += 1
            show("processes", done, total)
            return result

        cold = child()
        cached = [child(steps=steps) for steps in STEPS]
        both = [
            tuple(child(cores=which, chains=16384, blocks=2, steps=24576)["seconds"] for which in (cores[-1:], cores))
            for _ in range(pairs)
        ]
    found: dict[str, Any] = {
        "import_s": median(result["import"] for result in [cold, *cached]),
        "compile_cold_s": cold["compile"],
        "compile_cached_s": median(result["compile"] for result in cached),
        "memory_mib": ("memory_steps", [result["memory"] for result in cached]),
        "memory_steps": ("memory_steps", list(STEPS)),
    }
    if both:
        found["two_cores"] = median(one / two for one, two in both)
    return found


def _child(order: dict[str, Any]) -> dict[str, float]:
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-c", CHILD, json.dumps(order)]
    made = subprocess.run(command, cwd=root, env=environment, check=True, capture_output=True, text=True)
    return json.loads(made.stdout.splitlines()[-1])
