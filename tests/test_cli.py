"""The command `mcmc1d`: its exit codes, what it writes, and what it refuses in one line. The seeds are fixed."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mcmc1d
from mcmc1d import cli

KERNELS = """
import numpy as np
from scipy.stats import norm
from mcmc1d.verify import HostKernel, Law

def make(shift):
    return HostKernel(lambda rng, x: 0.5 + shift + 0.5 * (x - 0.5) + np.sqrt(3) * rng.normal(size=len(x)), name="ar")

def law():
    return norm(0.5, 2)

right, wrong, number = make(0.0), make(2.0), 3
halves = HostKernel(lambda rng, x: np.where(rng.random(len(x)) < 2, x, x), name="stays")
liar = Law(lambda rng, n: rng.normal(size=n), cdf=norm(1).cdf, name="liar")

def broken():
    raise RuntimeError("no such machine")

def buggy(key, x):
    return x + undefined

def refuses(key, x):
    raise ValueError("only\\non Sundays")
"""
ROOT = Path(__file__).parents[1]
SMALL = ["--replicas", "16384"]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The current directory, with kernels in it; what a command does to the path and the modules is undone."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    (tmp_path / "bad_syntax.py").write_text("def f(:\n")
    (tmp_path / "exits.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    sys.modules.pop("kernels", None)


def verify(kernel, target="kernels.py:law", *options):
    try:
        return cli.main(["verify", kernel, "--target", target, *options])
    except SystemExit as error:
        return error.code


def test_pass_is_0_and_the_files_are_written(folder, capsys):
    assert verify("kernels.py:right", "kernels.py:law", *SMALL, "--json", "a.json", "--plot", "a.pdf", "--seed=4") == 0
    out, err = capsys.readouterr()
    assert out.startswith("PASS  ar on norm")
    assert not err
    certificate = json.loads((folder / "a.json").read_text())
    assert (certificate["verdict"], certificate["seed"], certificate["first_replicas"]) == ("PASS", 4, 16384)
    assert (folder / "a.pdf").read_bytes().startswith(b"%PDF")
    assert {path.suffix for path in folder.iterdir() if path.is_file()} == {".py", ".json", ".pdf"}


def test_fail_is_1(capsys):
    assert verify("kernels:wrong", "kernels:law", *SMALL) == 1
    assert "the law of x is wrong" in capsys.readouterr().out


def test_inconclusive_is_3(capsys):
    assert verify("kernels.py:right", "kernels.py:law", "--gap=1e-4", "--seconds=0.01", "--power=0.9") == 3
    assert "is out of reach" in capsys.readouterr().out


def test_options_reach_the_engine(capsys):
    assert verify("kernels.py:halves", "kernels.py:law", "--replicas=2048", "--level=1e-3") == 1
    assert "it never moves" in capsys.readouterr().out
    assert verify("kernels.py:right", "kernels.py:law", *SMALL, "--level=1e-3", "--reversible", "--not-ergodic") == 0
    out = capsys.readouterr().out
    assert "level      1.0e-03" in out
    assert "forgotten" not in out


@pytest.mark.parametrize(
    ("kernel", "target", "message"),
    [
        ("right", "kernels.py:law", "KERNEL must be MODULE:NAME or FILE.py:NAME, not 'right'"),
        ("nowhere:right", "kernels.py:law", "there is no module 'nowhere' in the current directory"),
        ("nowhere.py:right", "kernels.py:law", "there is no file nowhere.py"),
        ("kernels.py:rigth", "kernels.py:law", "kernels.py has no 'rigth'; did you mean right?"),
        ("kernels.py:right", "kernels.py:law.support.x", "kernels.py:law has no 'support'"),
        ("bad_syntax:x", "kernels.py:law", "bad_syntax can not be imported: SyntaxError"),
        ("exits.py:x", "kernels.py:law", "exits.py can not be imported: SystemExit: 0"),
        ("kernels.py:broken", "kernels.py:law", "kernels.py:broken() raised RuntimeError: no such machine"),
        ("kernels.py:right", "kernels.py:number", "a target to verify against must be"),
        ("kernels.py:number", "kernels.py:law", "3 is no kernel"),
        ("kernels.py:right", "kernels.py:liar", "liar: its sampler and its exact law of x disagree"),
        ("kernels.py:refuses", "kernels.py:law", "only on Sundays"),
    ],
)
def test_what_can_not_be_run_is_2_and_one_line(kernel, target, message, capsys):
    assert verify(kernel, target, *SMALL) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert len(err.splitlines()) == 1
    assert not out


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--replicas=many", "argument --replicas: invalid whole number value: 'many'"),
        ("--gap=-1", "argument --gap: over 0 and under 1: -1"),
        ("--replicas=3", "3 replicas are too few"),
        ("--power=2", "power is a probability from 0.5 to 1, not 2"),
        ("--repl=512", "unrecognized arguments: --repl=512"),
        ("--json=nowhere/a.json", "nowhere is no folder that can be written to"),
        ("--plot=a.nonsense", "end its name in one of ."),
    ],
)
def test_a_wrong_option_is_2_and_one_line(option, message, capsys):
    assert verify("kernels.py:right", "kernels.py:law", option) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1


def test_a_mistake_in_a_kernel_is_2_with_its_place(capsys):
    assert verify("kernels.py:buggy", "kernels.py:law", *SMALL) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert re.search(r"raised NameError: name 'undefined' is not defined \(\S*kernels.py, line \d+\)$", err)


def test_progress_is_for_a_terminal_and_the_patient(monkeypatch, capsys):
    monkeypatch.setattr(cli, "_PATIENCE", -1.0)
    cli._Progress()(1, 2)
    assert not capsys.readouterr().err
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    progress = cli._Progress()
    progress(1024, 4096)
    assert capsys.readouterr().err == "\r1,024 of 4,096 replicas, 25%"
    progress.clear()
    assert not capsys.readouterr().err.strip()


def installed(*command, **settings):
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax")}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", **settings}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_example_in_the_help_works(folder):
    """With the installed command, a JAX kernel, from the current directory, and in double precision."""
    code, command = re.search(r"current directory:\n\n(.*?)\n  mcmc1d (verify .*?)\n", cli._EXAMPLE, re.S).groups()
    (folder / "my_kernel.py").write_text(re.sub(r"^  ", "", code, flags=re.M))
    script = Path(sys.executable).with_name("mcmc1d")
    result = installed(str(script), *command.split(), "--x64", *SMALL)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("PASS  step on two modes")
    assert json.loads((folder / "step.json").read_text())["verdict"] == "PASS"
    assert not result.stderr


def test_a_reader_that_goes_away_changes_no_verdict():
    """As `mcmc1d verify ... | head -1` does."""
    command = [sys.executable, "-m", "mcmc1d", "verify", "kernels.py:wrong", "--target", "kernels.py:law", *SMALL]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert (process.wait(), process.stderr.read()) == (1, "")


def test_it_is_a_module_too_and_says_its_version():
    result = installed(sys.executable, "-m", "mcmc1d", "--version")
    assert (result.returncode, result.stderr) == (0, "")
    assert re.fullmatch(r"mcmc1d \d+\.\d+\S*\n", result.stdout)


def test_the_package_is_lazy_and_whole():
    lazy = installed(sys.executable, "-c", "import sys, mcmc1d, mcmc1d.cli; print(*{'jax', 'numpy'} & {*sys.modules})")
    assert (lazy.returncode, lazy.stdout.strip()) == (0, "")
    assert all(hasattr(mcmc1d, name) for name in mcmc1d.__all__)
    assert set(mcmc1d.__all__) <= set(dir(mcmc1d))
    assert set(mcmc1d.__all__) == set(mcmc1d._HOMES)
    with pytest.raises(AttributeError, match="module 'mcmc1d' has no attribute 'nonsense'"):
        _ = mcmc1d.nonsense
