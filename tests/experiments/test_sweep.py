"""A sweep killed at any moment, a journal cut or changed, two runs at once: no result is lost, none is made up."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest

import mcmc1d
from experiments.support import long
from experiments.support.long import long_run
from experiments.support.sweep import Sweep, checkpoints, journal
from mcmc1d import chain, moves, targets, techniques

ROOT = Path(__file__).parents[2]
KIND = {"experiment": "squares", "config": {"slow": False}, "seed": 3}
POINTS = [(k, 0.01) for k in range(40)]
SQUARES = [[k * k, "done"] for k, _ in POINTS]

SCRIPT = """
import sys
from pathlib import Path
from experiments.support.sweep import Sweep, journal
from tests.experiments.test_sweep import KIND, POINTS, slow_square
if __name__ == "__main__":
    with journal(Path(sys.argv[1]), KIND, resume=True) as kept:
        print(Sweep(lambda *_: None, kept, int(sys.argv[2])).map("squares", slow_square, POINTS))
"""


def slow_square(k, seconds):
    time.sleep(seconds)
    return k * k, "done"


def refuses(k, seconds):
    raise AssertionError(f"point {k} is done again")


def interrupts(k, seconds):
    raise KeyboardInterrupt


def quiet(stage, done, total):
    pass


def half(path, then):
    """Three points done, and then something else."""
    with journal(path, KIND, resume=False) as kept:
        Sweep(quiet, kept).map("squares", slow_square, POINTS[:3])
        Sweep(quiet, kept).map("others", then, POINTS)


def run(path, jobs):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    # A group of its own, so that a kill takes the workers too.
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(path), str(jobs)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def test_two_processes_give_what_one_gives():
    points = [(k, 0.0) for k in range(9)]
    seen = []
    two = Sweep(lambda *report: seen.append(report), jobs=2).map("squares", slow_square, points)
    assert two == Sweep(quiet).map("squares", slow_square, points)
    assert seen[0] == ("squares", 0, 9)
    assert seen[-1] == ("squares", 9, 9)


@pytest.mark.slow
def test_a_run_killed_again_and_again_ends_with_the_same_results(tmp_path):
    path = tmp_path / ".squares.journal"
    kills, dice = 0, random.Random(5)
    for _ in range(20):
        process = run(path, 1)
        try:
            out, err = process.communicate(timeout=dice.uniform(0.0, 2.5))
            break
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            kills += 1
    else:
        out, err = run(path, 1).communicate()
    assert kills > 0
    assert out.strip() == str(SQUARES), err
    assert not path.exists()


def test_what_is_finished_is_not_done_again(tmp_path):
    path = tmp_path / ".squares.journal"
    with pytest.raises(AssertionError, match="point 0 is done again"):
        half(path, refuses)
    with journal(path, KIND, resume=True) as kept:
        assert len(kept) == 3
        assert Sweep(quiet, kept).map("squares", refuses, POINTS[:3]) == SQUARES[:3]


@pytest.fixture
def left(tmp_path):
    """A journal of three points, as an interrupted run leaves it."""
    path = tmp_path / ".squares.journal"
    with pytest.raises(KeyboardInterrupt):
        half(path, interrupts)
    return path


def test_a_line_cut_short_is_done_again(left):
    left.write_bytes(left.read_bytes()[:-5])
    with journal(left, KIND, resume=True) as kept:
        assert len(kept) == 2
        assert Sweep(quiet, kept).map("squares", slow_square, POINTS[:3]) == SQUARES[:3]


def test_a_changed_line_is_found(left):
    left.write_text(left.read_text().replace('[4, "done"]', '[5, "done"]'))
    with pytest.raises(ValueError, match=r"line 4 of .* is damaged"), journal(left, KIND, resume=True):
        pass
    assert left.exists()


def test_results_are_not_thrown_away_unasked(left):
    with (
        pytest.raises(ValueError, match="left 3 finished parts and 0 checkpoints: go on with"),
        journal(left, KIND, False),
    ):
        pass


def test_another_configuration_is_another_run(left):
    with pytest.raises(ValueError, match="differs in its seed"), journal(left, {**KIND, "seed": 4}, resume=True):
        pass


def test_two_runs_do_not_write_to_one_place(tmp_path):
    path = tmp_path / ".squares.journal"
    refused = pytest.raises(ValueError, match="another run is writing")
    with journal(path, KIND, resume=False), refused, journal(path, KIND, resume=True):
        pass


def test_a_run_that_did_nothing_leaves_nothing(tmp_path):
    path = tmp_path / ".squares.journal"
    with pytest.raises(ZeroDivisionError), journal(path, KIND, resume=False):
        raise ZeroDivisionError
    assert not path.exists()


def long_point(seed):
    """A point of two runs, the second from where the first has ended."""
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Tent())
    arguments = {"steps": 64, "chains": 64, "blocks": 2, "estimators": {"h": mcmc1d.Histogram(10)}}
    first = long_run("first", jax.random.key(seed), moves.SmallStep(), target, **arguments)
    second = long_run("second", jax.random.key(9), moves.SmallStep(), target, start=first.state, **arguments)
    return (first.sums["h"] + second.sums["h"]).tolist()


def test_a_long_run_inside_of_a_point_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(chain, "_STEPS_PER_LOOK", 8)
    monkeypatch.setattr(long, "SECONDS", 0.0)
    path, seen = tmp_path / ".long.journal", []

    def stop(stage, done, total):
        if stage == "second" and done >= total / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="all of it is in"), journal(path, KIND, False) as kept:
        Sweep(stop, kept).map("long", long_point, [(1,)])
    assert len(checkpoints(path)) == 2
    with pytest.raises(ValueError, match="0 finished parts and 2 checkpoints: go on with"), journal(path, KIND, False):
        pass
    with journal(path, KIND, resume=True) as kept:
        found = Sweep(lambda *report: seen.append(report), kept).map("long", long_point, [(1,)])
        assert checkpoints(path) == []
    assert [report for report in seen if report[0] == "first"] == []
    assert next(done / total for stage, done, total in seen if stage == "second") > 0.5
    assert found == Sweep(quiet).map("long", long_point, [(1,)])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("saved", [False, True])
def test_only_a_run_that_is_to_be_saved_leaves_a_file(tmp_path, saved):
    target = mcmc1d.Multiplexed(targets.Sinusoid(), techniques.Tent())
    with long.at(str(tmp_path / "part"), quiet):
        long_run("one", jax.random.key(0), moves.SmallStep(), target, steps=2, chains=8, saved=saved)
    assert len(list(tmp_path.iterdir())) == saved


def test_checkpoints_whose_journal_was_deleted_are_not_taken_up(tmp_path):
    path = tmp_path / ".long.journal"
    Path(f"{path}.0123.first").write_bytes(b"of another time")
    with journal(path, KIND, resume=True) as kept:
        assert checkpoints(path) == []
        assert len(kept) == 0
