"""What the documents say works: every Python block of README and CONTRIBUTING is run."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import experiments
from experiments.support import framework
from mcmc1d.flatland import files
from mcmc1d.flatland.reference import image
from mcmc1d.verify import check_move, check_technique, verify

ROOT = Path(__file__).parents[1]


def blocks(name):
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(), re.S)


def module(tmp_path, name, text):
    path = tmp_path / f"{name}.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location(name, path)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.mark.slow
def test_readme_examples_run_and_pass(capsys):
    names = {}
    for block in blocks("README.md"):
        exec(block, names)
    out = capsys.readouterr().out
    assert "technique Cubic: PASS" in out
    assert "move FactorStep on GaussianMixture: PASS" in out
    assert check_technique(names["Disk"](), points=2000)
    run, exact = names["run"], names["exact"]
    # 40 cells within 5 standard errors from 8 blocks (t, 7 degrees of freedom): a false alarm has probability 0.06 at
    # another seed and none at this one; the smallest error seen is 5 standard errors, 0.002 of the whole.
    assert abs((run.mean("law") - exact) / run.standard_error("law")).max() < 5


@pytest.mark.slow
def test_the_scene_of_the_readme_is_the_same_from_python_and_from_a_file(tmp_path):
    (text,) = re.findall(r"```toml\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    (tmp_path / "mine.toml").write_text(text)
    names: dict[str, Any] = {"image": image}
    exec(next(block for block in blocks("README.md") if "import Material" in block), names)
    read, made = files.read(tmp_path / "mine.toml"), names["seen"]
    assert (read.name, read.sensor) == (made.name, made.sensor)
    walls = [[(wall.start, wall.end, wall.material) for wall in scene.segments] for scene in (read, made)]
    assert walls[0] == walls[1]


def test_technique_skeleton_is_one_file(tmp_path):
    for name, technique in module(tmp_path, "power_law", blocks("CONTRIBUTING.md")[0]).EXAMPLES.items():
        assert check_technique(technique, points=2000), name


@pytest.mark.slow
def test_move_skeleton_is_one_file(tmp_path):
    for name, move in module(tmp_path, "reverse", blocks("CONTRIBUTING.md")[1]).EXAMPLES.items():
        assert check_move(move, points=2000), name


@pytest.mark.slow
def test_mutant_skeleton_is_one_file(tmp_path):
    found = module(tmp_path, "at_walls", blocks("CONTRIBUTING.md")[3])
    for mutant in found.MUTANTS.values():
        report = verify(mutant.subject, mutant.law)
        assert mutant.layer in {failure.layer for failure in report.failures}
    for trap in found.TRAPS.values():
        assert verify(trap.subject, trap.law, replicas=2**14).passed


def test_experiment_skeleton_is_one_file(tmp_path, monkeypatch):
    (tmp_path / "step_size.py").write_text(blocks("CONTRIBUTING.md")[2])
    monkeypatch.setattr(experiments, "__path__", [*experiments.__path__, str(tmp_path)])
    monkeypatch.delitem(sys.modules, "experiments.step_size", raising=False)
    assert "step_size" in framework.names()
    skeleton = framework.load("step_size")
    config = framework.configure(skeleton, "quick", ["steps=20", "chains=64"])
    data = skeleton.run(config, 0, lambda *_: None)
    framework.style()
    record = framework.manifest("step_size", "quick", config, 0, skeleton.judge(data))
    paths = framework.write(tmp_path, "step_size", data, skeleton.draw(data), record)
    assert all(path.stat().st_size > 0 for path in paths)


def test_the_table_is_written_between_the_marks(tmp_path):
    claims = framework.read_claims(ROOT / "figures")
    document = tmp_path / "document.md"
    document.write_text("before\n<!-- claims -->\nold\n<!-- /claims -->\nafter\n")
    framework.rewrite(document, claims, "from there")
    first, *table, last = document.read_text().splitlines()
    assert (first, last) == ("before", "after")
    assert table == ["<!-- claims -->", *framework.markdown(claims, "from there"), "<!-- /claims -->"]
    document.write_text("no marks")
    with pytest.raises(ValueError, match="has no lines <!-- claims -->"):
        framework.rewrite(document, claims, "from there")


def _redrawn():
    """Whether figures were drawn since, as by `make reproduce`, which README names before `make test`."""
    try:
        command = ["git", "status", "--porcelain", "figures"]
        changed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return False
    return changed.returncode == 0 and changed.stdout.strip() != ""


def test_readme_shows_the_claims_of_the_committed_figures():
    if not list((ROOT / "figures").glob("*.json")):
        pytest.fail("figures/ has no results: run `make reproduce` and commit them")
    if _redrawn():
        pytest.skip("figures/ is not as committed; `python -m experiments claims --write README.md` renews the table")
    lines = framework.markdown(framework.read_claims(ROOT / "figures"), framework.origins(ROOT / "figures"))
    assert "\n".join(lines) in (ROOT / "README.md").read_text()


def test_no_two_claims_have_one_name():
    ids = [claim.id for claim in framework.read_claims(ROOT / "figures")]
    assert sorted(set(ids)) == sorted(ids)


def test_the_house_names_every_module():
    house = (ROOT / "README.md").read_text().partition("## The house")[2]
    parts = (path.name + "/" * path.is_dir() for path in (ROOT / "mcmc1d").iterdir() if not path.name.startswith("_"))
    assert [part for part in parts if not re.search(rf"(?<!\w){re.escape(part)}", house)] == []
