"""The command line: what it writes, what it refuses, and with which exit code."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

ROOT = Path(__file__).parents[2]
TINY = [
    f"--set={field}"
    for field in (
        "replicas=2048",
        "replica_steps=4",
        "chains=1024",
        "steps=8",
        "trace_steps=64",
        "blocks=4",
        "operator_points=262144",
    )
]


def experiments(*arguments, cwd=ROOT):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(ROOT / ".cache"), "COLUMNS": "200"}
    command = [sys.executable, "-m", "experiments", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Two runs at one seed, too short to tell right from wrong: the command must say so with exit code 1."""
    folders = [tmp_path_factory.mktemp("out") / "made" for _ in range(2)]
    return folders, [experiments("run", "rjmlt_fig3", "--seed", 3, "--out", folder, *TINY) for folder in folders]


def test_a_verdict_that_theory_does_not_predict_exits_with_1(tiny):
    _, runs = tiny
    assert runs[0].returncode == 1, runs[0].stderr
    assert "where theory says holds" in runs[0].stderr


def test_it_writes_four_files_and_nothing_else(tiny):
    folders, _ = tiny
    assert sorted(path.name for path in folders[0].iterdir()) == [
        f"rjmlt_fig3.{suffix}" for suffix in ("json", "nc", "pdf", "png")
    ]


def test_the_same_seed_gives_the_same_numbers(tiny):
    folders, _ = tiny
    first, second = (xr.load_dataset(folder / "rjmlt_fig3.nc", engine="h5netcdf") for folder in folders)
    assert first.identical(second)
    assert np.isfinite(first.joint).all()


def test_the_manifest_says_how_to_get_them_again(tiny):
    folders, _ = tiny
    record = json.loads((folders[0] / "rjmlt_fig3.json").read_text())
    assert record["seed"] == 3
    assert record["config"]["replicas"] == 2048
    assert {"jax", "mcmc1d", "python"} <= set(record["versions"])
    assert len(record["claims"]) == 8


def test_claims_are_read_from_the_results(tiny):
    folders, _ = tiny
    shown = experiments("claims", "--out", folders[0])
    assert shown.returncode == 0
    assert "rjmlt.full-aimed" in shown.stdout
    as_json = json.loads(experiments("claims", "--json", "--out", folders[0]).stdout)
    assert {claim["id"] for claim in as_json} >= {"rjmlt.no-jacobian", "rjmlt.fixed-point"}


def test_list_names_experiments_and_fields():
    shown = experiments("list").stdout
    assert "rjmlt_fig3" in shown
    assert "replica_steps" in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nonsense"], "no experiment 'nonsense'; known: adaptation"),
        (["run", "rjmlt_fig3", "--set", "sgima=1"], "no field 'sgima'; known: amplitude, sigma"),
        (["run", "rjmlt_fig3", "--set", "bins=many"], "'many' is not int"),
        (["run", "rjmlt_fig3", "--set", "sigma=-1"], "sigma must be positive"),
        (["run", "rjmlt_fig3", "--set", "amplitude=2"], "makes the target negative"),
        (["run", "rjmlt_fig3", "--profile", "huge"], "no profile 'huge'; known: quick, paper"),
        (["run", "rjmlt_fig3", "--out", "/proc/nowhere"], "can not write to /proc/nowhere"),
        (["run"], "name the experiments to run, or say --all"),
        (["claims", "--out", "/nonexistent"], "no results in /nonexistent"),
    ],
)
def test_a_wrong_request_is_one_line_and_exit_code_2(arguments, message, tmp_path):
    arguments = [*arguments, "--out", tmp_path] if arguments[0] == "run" and "--out" not in arguments else arguments
    refused = experiments(*arguments)
    assert refused.returncode == 2
    assert message in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())
