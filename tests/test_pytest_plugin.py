"""The pytest plugin as a stranger has it: the built wheel, in a project of its own, in a process of its own.

All seeds are fixed, so that nothing here fails by chance; the wrong kernel's CDF is off by 0.38, and 16384 replicas
detect 0.031 with probability 0.99.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]

KERNELS = """
import numpy as np
import pytest
from scipy.stats import norm
from mcmc1d.verify import HostKernel

LAW = norm(0.5, 2)
FAST = {"replicas": 16384, "steps": (1, 2)}

def kernel(shift=0.0, name="autoregressive"):
    def step(rng, x):
        return 0.5 + shift + 0.5 * (x - 0.5) + np.sqrt(3) * rng.normal(size=len(x))
    return HostKernel(step, name=name)
"""
TESTS = f"""{KERNELS}
def test_right(verify_kernel):
    report = verify_kernel(kernel(), LAW, **FAST)
    assert report.passed and report.kernel == "autoregressive"

def test_wrong(verify_kernel):
    verify_kernel(kernel(2.0), LAW, **FAST)

def test_right_and_its_twin(verify_kernel):
    verify_kernel(kernel(), LAW, **FAST)
    assert not verify_kernel(kernel(2.0), LAW, must_fail=True, **FAST)
    verify_kernel(kernel(), LAW, **FAST)

def test_twin_that_survives(verify_kernel):
    verify_kernel(kernel(), LAW, must_fail=True, **FAST)

@pytest.mark.parametrize("name", ["a/b", "a-b"])
def test_each(verify_kernel, name):
    verify_kernel(kernel(name=name), LAW, **FAST)

@pytest.fixture
def indirect(verify_kernel):
    return verify_kernel

def test_by_a_fixture(indirect):
    indirect(kernel(), LAW, **FAST)

def test_the_level_is_the_runs(verify_kernel):
    with pytest.raises(TypeError, match="verify_kernel sets level itself"):
        verify_kernel(kernel(), LAW, level=0.4)

def test_a_law_that_is_none(verify_kernel):
    with pytest.raises(ValueError, match="a target to verify against"):
        verify_kernel(kernel(), 3)

def test_inconclusive(verify_kernel):
    verify_kernel(kernel(), LAW, gap=1e-4, seconds=0.01, steps=(1, 2))

def test_too_late(request):
    request.getfixturevalue("verify_kernel")

@pytest.mark.flaky(reruns=3)
def test_retried(verify_kernel):
    pass

def test_without():
    import mcmc1d
    assert mcmc1d.__file__.startswith(r"{{wheel}}")
"""
USING = 11  # of the tests above, with both parameters
INI = """[pytest]
addopts = --strict-markers --strict-config -q -p no:cacheprovider
filterwarnings = error
xfail_strict = true
markers = flaky: what the plugin below would register
mcmc1d_seed = 7
mcmc1d_certificates = by_ini
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Where the built wheel is installed."""
    built, installed = tmp_path_factory.mktemp("built"), tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(built)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    offline = ["--no-deps", "--no-index", "--no-compile", "--quiet", "--disable-pip-version-check"]
    install = [sys.executable, "-m", "pip", "install", *offline, "--target", str(installed), *map(str, built.iterdir())]
    subprocess.run(install, check=True, capture_output=True)
    return installed


@pytest.fixture(scope="module")
def project(tmp_path_factory, wheel):
    folder = tmp_path_factory.mktemp("project")
    (folder / "test_kernels.py").write_text(TESTS.replace("{wheel}", str(wheel)))
    (folder / "rerunfailures.py").write_text('"""Stands in for pytest-rerunfailures, by its name."""')
    (folder / "pytest.ini").write_text(INI)
    return folder


@pytest.fixture(scope="module")
def run(project, wheel):
    """Pytest, to which this repository is not there."""

    def run(*arguments):
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "COV"))}
        environment = {**kept, "PYTHONPATH": f"{wheel}{os.pathsep}{project}", "COLUMNS": "200"}
        command = [sys.executable, "-P", "-m", "pytest", *arguments]
        return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=False)

    return run


@pytest.fixture(scope="module")
def alone(run):
    return run("test_kernels.py", "--mcmc1d-certificates=alone")


@pytest.fixture(scope="module")
def spread(run):
    return run("test_kernels.py", "-n2", "--mcmc1d-certificates=spread", "--junitxml=junit.xml")


def summary(result):
    """The plugin's lines on each verification, less the one that depends on the clock; and its last."""
    lines = result.stdout.splitlines()
    start = next(i for i, line in enumerate(lines) if "mcmc1d: verified kernels" in line)
    stop = next(i for i, line in enumerate(lines) if line.startswith("spent"))
    return [line for line in lines[start + 1 : stop] if "test_inconclusive" not in line], lines[stop]


def test_right_kernels_pass_and_wrong_ones_fail(alone):
    failed = set(re.findall(r"^FAILED test_kernels.py::(\w+)", alone.stdout, re.M))
    wanted = {"test_wrong", "test_twin_that_survives", "test_inconclusive", "test_too_late"}
    assert failed == wanted, alone.stdout + alone.stderr
    assert "4 failed, 9 passed" in alone.stdout


def test_a_failure_shows_the_report_and_how_to_see_it_again(alone):
    assert "E         the law of x is wrong after" in alone.stdout
    assert f"pytest 'test_kernels.py::test_wrong' --mcmc1d-seed=7 --mcmc1d-level={1e-4 / USING!r}" in alone.stdout
    assert "pytest_plugin.py" not in alone.stdout


def test_a_twin_that_survives_is_named(alone):
    assert "this kernel must FAIL, and the verdict is PASS: the test is too weak" in alone.stdout


def test_the_summary_accounts_for_the_level(alone):
    lines, last = summary(alone)
    share, right, twins = 1e-4 / USING, 6, 2
    halves = [line for line in lines if f"level {share / 2:.1e}" in line]
    quarters = [line for line in lines if f"level {share / 4:.1e}" in line]
    errors = [line for line in lines if line.startswith("ERROR")]
    assert len(halves) == right + len(errors) == 7
    assert len(quarters) == 1
    assert "test_right_and_its_twin (call 3)" in quarters[0]
    assert len([line for line in lines if "which must fail  level 0.0e+00" in line]) == twins
    detects = re.compile(r"detects a gap of 0\.\d+ with probability 0\.99  [\d,]+ replicas  seed \d+$")
    assert all(detects.search(line) for line in lines if line not in errors)
    assert last.startswith(f"spent {share * (8 / 2 + 1 / 4):.1e} of the level 1.0e-04")
    assert last.endswith("(seed 7)")


def test_a_certificate_for_each_verification(alone, project):
    certificates = [json.loads(path.read_text()) for path in (project / "alone").iterdir()]
    assert len(certificates) == 10
    assert {path.suffix for path in (project / "alone").iterdir()} == {".json"}
    assert {c["test"] for c in certificates} >= {"test_kernels.py::test_each[a/b]", "test_kernels.py::test_each[a-b]"}
    assert all(c["run_seed"] == 7 and c["versions"]["mcmc1d"] for c in certificates)
    assert len({c["seed"] for c in certificates}) == len(certificates)
    spent = sum(c["level"] for c in certificates if not c["must_fail"])
    assert spent <= 1e-4


@pytest.mark.slow
def test_workers_of_xdist_say_the_same(alone, spread, project):
    assert summary(spread) == summary(alone)
    names = [sorted(path.name for path in (project / folder).iterdir()) for folder in ("alone", "spread")]
    assert names[0] == names[1]


def test_junit_has_the_verdicts(spread, project):
    found = ElementTree.parse(project / "junit.xml").findall(".//property[@name='mcmc1d']")
    assert len(found) == len(summary(spread)[0]) + 1  # which leaves one out
    assert {json.loads(each.get("value", ""))["verdict"] for each in found} == {"PASS", "FAIL", "INCONCLUSIVE", "ERROR"}


@pytest.fixture(scope="module")
def few(run):
    chosen = "test_right or test_without or inconclusive or retried"
    return run("test_kernels.py", "-k", chosen, "-p", "rerunfailures", "--mcmc1d-inconclusive=skip", "-rs")


def test_deselection_changes_no_level_and_the_ini_file_is_read(few, alone, project):
    assert summary(few)[0]
    assert set(summary(few)[0]) < set(summary(alone)[0])
    assert list((project / "by_ini").iterdir())


def test_inconclusive_fails_or_skips(few, alone):
    assert "INCONCLUSIVE  autoregressive on norm" in few.stdout
    assert "3 passed, 1 skipped" in few.stdout, few.stdout + few.stderr
    assert "is out of reach" in alone.stdout


def test_no_retries(few):
    assert "ERROR at setup of test_retried" in few.stdout
    assert "verify_kernel can not be retried, and pytest-rerunfailures, by the mark flaky, would" in few.stdout


def test_the_share_must_be_known_at_collection(alone):
    assert "must stand among the arguments of the test" in alone.stdout


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--mcmc1d-level=2", "--mcmc1d-level must be a probability between 0 and 0.5, not '2'"),
        ("--mcmc1d-inconclusive=warn", "--mcmc1d-inconclusive must be fail or skip, not 'warn'"),
        ("--mcmc1d-certificates=pytest.ini", "can not make the folder"),
        ("--override-ini=mcmc1d_level=x", "mcmc1d_level in the ini file must be a probability"),
    ],
)
def test_a_wrong_setting_is_refused_at_once(run, option, message):
    result = run(option)
    assert result.returncode == 4
    assert message in result.stderr


def test_loading_the_plugin_imports_nothing_heavy(wheel):
    code = "import sys, mcmc1d.pytest_plugin; print(*{'jax', 'numpy', 'scipy', 'equinox'} & sys.modules.keys())"
    environment = {**os.environ, "PYTHONPATH": str(wheel)}
    shown = subprocess.run(
        [sys.executable, "-P", "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert not shown.stdout.strip()
