"""No run is lost: killed, interrupted, on a full disk, with a file that is damaged, of another run, or in use."""

import io
import os
import pickle
import random
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mcmc1d
from mcmc1d import chain, checkpoint, moves, parallel

ROOT = Path(__file__).parents[1]
TABLE = np.linspace(0, 1, 32, dtype=np.float32)


@pytest.fixture(autouse=True)
def many_pieces(monkeypatch):
    monkeypatch.setattr(chain, "_STEPS_PER_LOOK", 8)


SMALL = moves.SmallStep()


def short(path=None, *, seed=0, move=SMALL, function=lambda x: x, **changes):
    arguments = {"steps": 44, "chains": 64, "blocks": 4, "every": 0.0, **changes}
    estimators = {"h": mcmc1d.Histogram(20, joint=True), "e": mcmc1d.Expectation(function)}
    return mcmc1d.run(
        jax.random.key(seed), move, mcmc1d.verify.hard_target(), checkpoint=path, estimators=estimators, **arguments
    )


def same(one, other):
    return jax.tree.all(jax.tree.map(np.array_equal, (one.state, one.sums), (other.state, other.sums)))


def stop_at(share):
    """A progress that is interrupted as by Ctrl-C once that share is done."""

    def progress(done, total):
        if done >= share * total:
            raise KeyboardInterrupt

    return progress


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.checkpoint"


@pytest.fixture
def left(path):
    """The checkpoint of a run that was interrupted half-way."""
    with pytest.raises(
        KeyboardInterrupt, match=r"all of it is in .*run.checkpoint: go on with the same call and resume"
    ):
        short(path, every=1e9, progress=stop_at(0.5))
    return path


@pytest.fixture(scope="module")
def whole():
    """The run without a break and without a file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chain, "_STEPS_PER_LOOK", 8)
        return short()


def test_an_interrupted_run_goes_on_to_the_same_bits(left, whole):
    seen = []
    assert same(short(left, resume=True, progress=lambda done, total: seen.append(done / total)), whole)
    assert seen[0] > 0.5
    assert seen[-1] == 1
    assert [path.name for path in left.parent.iterdir()] == [left.name]


def test_a_finished_run_is_read_and_not_done_again(path, whole, monkeypatch):
    assert same(short(path), whole)
    monkeypatch.setattr(chain, "require_defined", lambda *_: pytest.fail("a step was made"))
    assert same(short(path, resume=True), whole)


def test_where_there_is_nothing_to_resume_the_run_begins(path, whole):
    path.touch()  # as a kill before the first checkpoint leaves it
    assert same(short(path, resume=True), whole)


def test_a_checkpoint_is_not_overwritten_unasked(left):
    before = left.read_bytes()
    with pytest.raises(ValueError, match=r"run.checkpoint holds a run that was begun before; go on with resume=True"):
        short(left)
    assert left.read_bytes() == before


@pytest.mark.parametrize(
    ("changes", "differs"),
    [
        ({"seed": 1}, "its key differs, its start differs;"),
        ({"steps": 45}, "its steps is 44, here 45;"),
        ({"blocks": 2}, "its blocks is 4, here 2, its program differs;"),
        ({"move": moves.SmallStep(0.2)}, "its kernel differs;"),
        ({"function": lambda x: x * jnp.asarray(TABLE)[0]}, "its program differs;"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_another_run_is_refused_with_what_differs(left, changes, differs):
    before = left.read_bytes()
    with pytest.raises(ValueError, match=r"is of another run: .*call run as it was called then") as refused:
        short(left, resume=True, **changes)
    assert differs in str(refused.value)
    assert left.read_bytes() == before


def test_tables_inside_of_a_function_are_told_apart(path):
    """What no leaf and no name shows: the program is compared too."""
    first, second = TABLE, TABLE.copy()
    second[7] += 2**-10
    short(path, function=lambda x: x * jnp.asarray(first)[(x * 31).astype(int)])
    with pytest.raises(ValueError, match="of another run: its program differs;"):
        short(path, function=lambda x: x * jnp.asarray(second)[(x * 31).astype(int)], resume=True)


def test_cut_off_at_any_length_it_is_refused(left, whole):
    content, dice = left.read_bytes(), random.Random(1)
    for size in [1, 30, len(content) - 1, *(dice.randrange(1, len(content)) for _ in range(20))]:
        with pytest.raises(ValueError, match=r"cut off|lost"):
            checkpoint.decode(content[:size], {}, [], "it")
    left.write_bytes(content[:-1])
    with pytest.raises(ValueError, match=r"run.checkpoint is cut off or changed: .* delete it to start over"):
        short(left, resume=True)
    assert left.exists()


def test_every_changed_bit_is_found(left):
    content, dice = left.read_bytes(), random.Random(2)
    for _ in range(300):
        changed, at = bytearray(content), dice.randrange(len(content))
        changed[at] ^= 1 << dice.randrange(8)
        with pytest.raises(ValueError, match="; delete it to start over"):
            checkpoint.decode(bytes(changed), {}, [], "it")


def forged(arrays):
    """A checkpoint whose checksum is right, made of other arrays."""
    buffer, state = io.BytesIO(), mcmc1d.State(np.zeros(2, np.int32), np.zeros((2, 1)))
    np.savez(buffer, *arrays)
    body = b"{}\n" + buffer.getvalue()
    digest = checkpoint.hashlib.sha256(body).hexdigest().encode()
    return b"mcmc1d checkpoint 1 %d %s\n%s" % (len(body), digest, body), [checkpoint.Place(0, state, {})]


class Evil:
    def __reduce__(self):
        return pytest.fail, ("it was unpickled",)


def test_nothing_is_unpickled_and_shapes_are_checked():
    content, like = forged([np.array([Evil()], dtype=object)])
    assert b"it was unpickled" in content
    assert pickle.dumps(Evil()) is not None
    with pytest.raises(ValueError, match="allow_pickle=False"):
        checkpoint.decode(content, {}, like, "it")
    content, like = forged([np.zeros(1, int), np.zeros((1, 2), np.int32), np.zeros((1, 3, 1))])
    with pytest.raises(ValueError, match="it has arrays of other shapes"):
        checkpoint.decode(content, {}, like, "it")


def test_two_runs_do_not_write_to_one_file(path, whole):
    def second(done, total):
        if done < total:
            return
        with pytest.raises(ValueError, match=r"another run has the checkpoint .* open: wait for it, or name another"):
            short(path, resume=True)

    assert same(short(path, progress=second), whole)


def test_a_full_disk_takes_nothing(path, whole, monkeypatch):
    """/dev/full in the place of the file that is written: a write fails as on a full disk."""
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: {0}, raising=False)  # no other thread is at it
    beside, full, content = path.with_name(".run.checkpoint.part"), [], []

    def fill(done, total):
        if done > total / 2 and not full:
            full.append(True)
            content.append(path.read_bytes())
            beside.symlink_to("/dev/full")

    with pytest.warns(
        UserWarning, match=r"No space left on device; the checkpoint before this one stands, the run goes"
    ):
        assert same(short(path, progress=fill), whole)
    # It has gone on, and saved its end when there was space again; what stood at the time was whole.
    assert same(short(path, resume=True), whole)
    path.write_bytes(content[0])
    assert same(short(path, resume=True), whole)


@pytest.mark.parametrize("bad", ["/proc/nowhere/run", "{tmp}"])
def test_a_place_that_can_not_be_written_is_told_at_once(bad, tmp_path):
    with pytest.raises(ValueError, match=r"can not write the checkpoint .*; name another path"):
        short(bad.format(tmp=tmp_path))


def test_a_run_that_fails_at_once_leaves_nothing(path):
    with pytest.raises(ZeroDivisionError):
        short(path, every=1e9, progress=lambda *_: 1 // 0)
    assert not path.exists()


def test_resume_needs_a_file():
    with pytest.raises(ValueError, match="resume=True needs checkpoint=PATH"):
        short(resume=True)


KILLS = """
import hashlib, os, random, signal, sys, time, warnings
import equinox, jax, numpy as np, scipy.special
warnings.filterwarnings("ignore", ".*os.fork")  # the parent only imports, and has no thread when it forks
assert len(os.listdir("/proc/self/task")) == 1
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would ignore it
path, log, kills, dice = sys.argv[1], sys.argv[2], int(sys.argv[3]), random.Random(int(sys.argv[4]))

def start(checkpoint, cores):
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        os.sched_setaffinity(0, cores)
        import mcmc1d
        from mcmc1d import chain, moves, targets, techniques
        chain._STEPS_PER_LOOK = 64
        target = mcmc1d.Multiplexed(targets.Sinusoid(), (techniques.Tent(), techniques.Uniform()))
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        run = mcmc1d.run(
            jax.random.key(3), moves.SmallStep(), target, steps=64 * 400, chains=1024, blocks=4,
            start=mcmc1d.State(np.arange(1024) % 2, np.linspace(0, 1, 1024, endpoint=False)[:, None]),
            estimators={"h": mcmc1d.Histogram(20)}, checkpoint=checkpoint, every=0.0, resume=checkpoint is not None,
            progress=lambda done, total: os.write(file, b"%d %d\\n" % (done, total)),
        )
        arrays = [np.asarray(array).tobytes() for array in jax.tree.leaves((run.state, run.sums))]
        print(hashlib.sha256(b"".join(arrays)).hexdigest())
        code = 0
    except KeyboardInterrupt as stopped:
        print(stopped)
    sys.stdout.flush()
    os._exit(code)

def reported():
    return [int(line.split()[0]) for line in open(log) if line.endswith("\\n")] if os.path.exists(log) else []

cores = os.sched_getaffinity(0)
os.waitpid(start(None, cores), 0)
piece, before, lost = 64 * 256, 0, []
for k in range(kills):
    if os.path.exists(log):
        os.unlink(log)
    alone = k % 2 == 0  # then no thread goes on while another saves: nothing is lost but the piece at work
    pid, began = start(path, set(list(cores)[:1]) if alone else cores), time.monotonic()
    while not reported() and time.monotonic() < began + 200:
        time.sleep(0.005)
    if not alone:
        lost.append((before - (reported()[0] - piece)) / piece)
    time.sleep(dice.uniform(0, 0.25))
    os.kill(pid, signal.SIGINT if k == 1 else signal.SIGKILL)
    os.waitpid(pid, 0)
    before = reported()[-1]
print("lost", max(lost), "reached", before / (64 * 400 * 1024), flush=True)  # or the next child says it too
os.waitpid(start(path, cores), 0)
"""


@pytest.mark.slow
def test_killed_again_and_again_it_ends_with_the_same_bits(tmp_path):
    """`MCMC1D_KILLS=20` for more of them."""
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".cache" / "jax"), "PYTHONPATH": str(ROOT)}
    environment |= {"OPENBLAS_NUM_THREADS": "1"}
    environment |= {
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    arguments = [tmp_path / "run.checkpoint", tmp_path / "log", environment.get("MCMC1D_KILLS", "4"), "1"]
    command = [sys.executable, "-c", KILLS, *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=1500)
    lines = done.stdout.split("\n")
    print(done.stdout, done.stderr)
    assert len(lines) == 5, done.stdout + done.stderr
    whole, interrupted, lost, resumed = lines[:4]
    assert "go on with the same call and resume=True" in interrupted
    assert float(lost.split()[1]) <= 1  # piece
    assert 0 < float(lost.split()[3]) < 1
    assert resumed == whole
