"""A sweep on a real Dask cluster of two workers, one of which is killed half-way: the output is what it was."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from experiments.support.cluster import remote, versions
from experiments.support.sweep import Sweep, source
from tests.experiments.test_sweep import POINTS, SQUARES, quiet, slow_square

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
ROOT = Path(__file__).parents[2]
SCRIPT = """
import sys
from pathlib import Path
from experiments.support.sweep import Sweep, journal
from tests.experiments.test_cluster import half_a_second, say
from tests.experiments.test_sweep import KIND, POINTS
if __name__ == "__main__":
    with journal(Path(sys.argv[1]), KIND, resume=False) as kept:
        print(Sweep(say, kept, dask=sys.argv[2]).map("squares", half_a_second, [(k, sys.argv[3]) for k, _ in POINTS]))
"""


def half_a_second(k, folder):
    """A tenth of one; and a trace of who did it."""
    with (Path(folder) / str(os.getpid())).open("a") as file:
        file.write(f"{k} ")
    return slow_square(k, 0.1)


def say(stage, done, total):
    print(stage, done, total, file=sys.stderr, flush=True)


def start(*arguments):
    # Without a nanny, which would start another worker in the place of the one that is killed.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command, pipe = [sys.executable, *map(str, arguments)], subprocess.PIPE
    return subprocess.Popen(command, env=environment, text=True, stdout=pipe, stderr=pipe)


def wait_for(condition, process, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def cluster(tmp_path):
    """The address of a scheduler, its two workers, and the folder in which they leave their traces."""
    file, traces = tmp_path / "scheduler.json", tmp_path / "traces"
    traces.mkdir()
    options = ["--scheduler-file", file, "--no-dashboard"]
    processes = [start("-m", "distributed.cli.dask_scheduler", *options, "--host", "127.0.0.1", "--port", 0)]
    try:
        wait_for(file.exists, processes[0])
        address = json.loads(file.read_text())["address"]
        worker = ["-m", "distributed.cli.dask_worker", address, "--nthreads", 1, "--no-nanny", "--no-dashboard"]
        worker += ["--local-directory", tmp_path]
        processes += [start(*worker), start(*worker)]
        yield address, processes[1:], traces
    finally:
        for process in processes:
            process.kill()
            process.communicate()


@pytest.mark.slow
def test_a_worker_killed_half_way_changes_nothing(cluster, tmp_path):
    address, workers, traces = cluster
    sweep = start("-c", SCRIPT, tmp_path / ".squares.journal", address, traces)
    wait_for(lambda: len(list(traces.iterdir())) == 2, sweep)
    wait_for(lambda: sum(len(path.read_text().split()) for path in traces.iterdir()) > len(POINTS) / 3, sweep)
    workers[0].send_signal(signal.SIGKILL)
    out, err = sweep.communicate(timeout=120)
    assert out.strip() == str(SQUARES), err
    done = {int(path.name): path.read_text().split() for path in traces.iterdir()}
    assert set(done) == {worker.pid for worker in workers}  # both had work, nobody else had
    assert len(POINTS) <= sum(map(len, done.values())) <= len(POINTS) + 2  # what died with the worker is done again
    assert len(done[workers[0].pid]) < len(POINTS) / 2


def test_nobody_at_the_address_is_told(monkeypatch):
    with pytest.raises(ValueError, match="no Dask scheduler answers at nonsense://here"):
        Sweep(quiet, dask="nonsense://here").map("squares", slow_square, POINTS)


def test_a_worker_with_other_code_refuses():
    assert remote(slow_square, (3, 0.0), versions(source())) == (9, "done")
    with pytest.raises(ValueError, match=r"a worker of the cluster has source \w+, not other: give it what"):
        remote(slow_square, (3, 0.0), versions("other"))


def test_a_cluster_or_processes():
    with pytest.raises(ValueError, match="say one"):
        Sweep(quiet, jobs=2, dask="tcp://localhost:1")
