"""Experiments side by side: every one runs, on a core of its own, and the worst exit code is the whole's."""

import json
import os

import pytest

from experiments import __main__ as command_line
from experiments.support.beside import side_by_side

PROGRAM = """
import json, os, sys
print(json.dumps([sys.argv[1], sorted(os.sched_getaffinity(0))]))
sys.exit(int(sys.argv[2]))
"""


def test_each_runs_once_pinned_and_the_worst_exit_code_counts(tmp_path, monkeypatch):
    (tmp_path / "program.py").write_text(PROGRAM)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    outputs = {}
    parts = [("a", "0"), ("b", "3"), ("c", "1")]
    code = side_by_side("program", parts, 2, lambda k, out, err: outputs.update({k: (out, err)}))
    assert code == 3
    said = {k: json.loads(out) for k, (out, err) in outputs.items() if not err}
    assert [said[k][0] for k in range(3)] == ["a", "b", "c"]
    assert all(len(cores) == 1 and cores[0] in os.sched_getaffinity(0) for _, cores in said.values())


def test_the_command_gives_each_experiment_its_own_process_but_those_that_measure_time(monkeypatch, tmp_path):
    """The long ones come first, the lone ones last, when nothing else runs; every option is handed on."""
    calls = []

    def stub(module, parts, jobs, done):
        calls.append((module, [list(part) for part in parts], jobs))
        for k in range(len(parts)):
            done(k, "", "")
        return 1

    monkeypatch.setattr(command_line, "side_by_side", stub)
    monkeypatch.setattr(command_line, "keep_compiled", lambda *_: None)
    names = ["verification_speed", "calibration", "cmlt_deposit_bias"]
    options = ["--profile", "paper", "--seed", "3", "--out", str(tmp_path), "--resume"]
    monkeypatch.setattr("sys.argv", ["experiments", "run", *names, "--jobs", "2", *options])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 1
    together, alone = calls
    assert together == ("experiments", [["run", name, *options] for name in (names[2], names[1])], 2)
    assert alone == ("experiments", [["run", names[0], "--jobs", "2", *options]], 1)
