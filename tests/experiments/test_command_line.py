"""The command line: what it writes, what it refuses, and with which exit code."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments import __main__ as command_line

ROOT = Path(__file__).parents[2]
TINY = [f"--set={field}" for field in ("runs=16", "alarms=4", "confidence=0")]
"""Of `calibration`, which compiles one kernel. At no confidence every p-value counts as too small: both claims fail."""


def experiments(*arguments, cwd=ROOT):
    """The command as a user gives it, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(ROOT / ".cache"), "COLUMNS": "200"}
    command = [sys.executable, "-m", "experiments", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def inside(monkeypatch, capsys):
    """The command in this process, which has imported all that it needs: (exit code, output, errors)."""
    monkeypatch.setattr(command_line, "keep_compiled", lambda: None)  # the tests keep compiled code elsewhere

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["experiments", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            command_line.main()
        return ended.value.code, *capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Two runs at one seed, each of which finds what theory does not predict."""
    folders = [tmp_path_factory.mktemp("out") / "made" for _ in range(2)]
    return folders, [experiments("run", "calibration", "--seed", 3, "--out", folder, *TINY) for folder in folders]


@pytest.mark.slow
def test_a_verdict_that_theory_does_not_predict_exits_with_1(tiny):
    _, runs = tiny
    assert runs[0].returncode == 1, runs[0].stderr
    assert "and holds is expected" in runs[0].stderr


def test_it_writes_four_files_and_nothing_else(tiny):
    folders, _ = tiny
    assert sorted(path.name for path in folders[0].iterdir()) == [
        f"calibration.{suffix}" for suffix in ("json", "nc", "pdf", "png")
    ]


def test_the_same_seed_gives_the_same_numbers(tiny):
    folders, _ = tiny
    first, second = (xr.load_dataset(folder / "calibration.nc", engine="h5netcdf") for folder in folders)
    assert first.identical(second)
    assert np.isfinite(first.p_value).all()


def test_the_manifest_says_how_to_get_them_again(tiny):
    folders, _ = tiny
    record = json.loads((folders[0] / "calibration.json").read_text())
    assert record["seed"] == 3
    assert (record["config"]["runs"], record["config"]["replicas"]) == (16, 512)
    assert {"jax", "mcmc1d", "python"} <= set(record["versions"])
    assert [claim["verdict"] for claim in record["claims"]] == ["fails", "fails"]


def test_claims_are_read_from_the_results(tiny, inside):
    folders, _ = tiny
    code, shown, _ = inside("claims", "--out", folders[0])
    assert code == 0
    assert "verify.super-uniform" in shown
    as_json = json.loads(inside("claims", "--json", "--out", folders[0])[1])
    assert {claim["id"] for claim in as_json} >= {"verify.super-uniform", "verify.level"}


def test_draw_judges_the_committed_data_again_and_finds_the_same(inside, tmp_path):
    for suffix in ("nc", "json"):
        shutil.copy(ROOT / "figures" / f"rjmlt_fig3.{suffix}", tmp_path)
    code, shown, _ = inside("draw", "rjmlt_fig3", "--out", tmp_path)
    assert code == 0
    assert "rjmlt.full-aimed" in shown
    assert (tmp_path / "rjmlt_fig3.pdf").read_bytes().startswith(b"%PDF")
    now, before = (json.loads((folder / "rjmlt_fig3.json").read_text()) for folder in (tmp_path, ROOT / "figures"))
    assert now["claims"] == before["claims"]


def test_join_puts_together_what_ran_apart(inside, tmp_path):
    data = xr.load_dataset(ROOT / "figures" / "flatland_images.nc", engine="h5netcdf")
    record = json.loads((ROOT / "figures" / "flatland_images.json").read_text())
    names = [str(name) for name in data.integrator.to_numpy()]
    for folder, own in (("one", names[:1]), ("two", names[1:])):
        (tmp_path / folder).mkdir()
        data.sel(integrator=own).to_netcdf(tmp_path / folder / "flatland_images.nc", engine="h5netcdf")
        part = {**record, "config": {**record["config"], "integrators": " ".join(own)}, "commit": folder}
        (tmp_path / folder / "flatland_images.json").write_text(json.dumps(part))
    one, two, both = (tmp_path / name for name in ("one", "two", "both"))
    assert inside("join", "flatland_images", one, two, "--out", both)[0] == 0
    joined = json.loads((both / "flatland_images.json").read_text())
    assert (joined["commit"], joined["claims"]) == ("one, two", record["claims"])
    xr.testing.assert_equal(data, xr.load_dataset(both / "flatland_images.nc", engine="h5netcdf"))
    same = inside("join", "flatland_images", one, one, "--out", both)
    assert (same[0], "must differ in one list of names, such as scenes, not in none" in same[2]) == (2, True)
    part = {**part, "config": {**part["config"], "scenes": "elsewhere"}}
    (two / "flatland_images.json").write_text(json.dumps(part))
    other = inside("join", "flatland_images", one, two, "--out", both)
    assert (other[0], "not in integrators, scenes" in other[2]) == (2, True)


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
        (["run", "rjmlt_fig3", "--set", "replicas=1000"], "a multiple of 512, a block's chains, not 1000"),
        (["run", "flatland_regions", "--set", "scenes=ofice"], "there is no ofice; known: "),
        (["run", "flatland_regions", "--set", "scenes=box"], "no pixel of scene box sees glossy walls alone"),
        (["run", "flatland_mmlt", "--set", "shortest=5"], "shortest=5 must be 1 at least, and longest=4 no less"),
        (["run", "flatland_sds", "--set", "radii="], "radii takes positive numbers with spaces between them, not ''"),
        (["run", "flatland_sds", "--set", "widths=1 nan"], "widths takes positive numbers"),
        (["run", "flatland_sds", "--set", "radius=0.3"], "radius is one of the radii, 0.02 0.05 0.1 0.2, not 0.3"),
        (["run", "flatland_sds", "--set", "budgets=1e5"], "budgets takes positive whole numbers"),
        (["run", "flatland_speed", "--set", "integrators="], "there is no ''; known: pt, "),
        (["run"], "name the experiments to run, or say --all"),
        (["claims", "--out", "/nonexistent"], "no results in /nonexistent"),
    ],
)
def test_a_wrong_request_is_one_line_and_exit_code_2(arguments, message, tmp_path, inside):
    arguments = [*arguments, "--out", tmp_path] if arguments[0] == "run" and "--out" not in arguments else arguments
    code, _, err = inside(*arguments)
    assert code == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_wrong_request_as_a_user_makes_it():
    """Nothing else is printed, by an import or at the end, and the exit code is the process's."""
    refused = experiments("run", "nonsense")
    assert refused.returncode == 2
    assert refused.stderr.startswith("error: there is no experiment 'nonsense'; known: adaptation")
    assert len(refused.stderr.strip().splitlines()) == 1
