"""A sweep: one function at many points, here, on a pinned process a core or a cluster; what is done outlives a kill."""

import fcntl
import hashlib
import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

import jax

from experiments.support.cluster import on_cluster
from experiments.support.long import Show, at
from mcmc1d.checks import require

CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "mcmc1d" / "jax"
"""Where compiled code is kept."""


class Sweep:
    """What an experiment's `run` is given: call it to show progress, `map` with it what takes long.

    Args:
        show: shows progress.
        journal: where finished points are kept; None keeps none.
        jobs: processes, each pinned to a core of its own; 1 works in this process, unpinned.
        dask: the address of a Dask scheduler, whose workers do it instead.

    """

    def __init__(self, show: Show, journal: "Journal | None" = None, jobs: int = 1, dask: str | None = None):
        require(jobs >= 1, f"jobs is a number of processes, at least 1, not {jobs}")
        require(
            dask is None or jobs == 1, "--dask has the cluster do the work, --jobs processes of this machine: say one"
        )
        self._show, self._journal, self._jobs, self._dask = show, journal, jobs, dask

    def __call__(self, stage: str, done: int, total: int) -> None:
        self._show(stage, done, total)

    def map(
        self, stage: str, work: Callable[..., Any], points: Sequence[tuple[Any, ...]], *, timed: bool = False
    ) -> list[Any]:
        """`[work(*point) for point in points]`, each as JSON gives it back; points in the journal are not done again.

        `work` is a function of a module, and its result depends on nothing but the point: then it does not matter which
        process did it, or when. Points and results are made of what JSON knows. A point's `long_run`s are saved as they
        go, but on a cluster, which need not share a disk. What is `timed` is done one after the other, in a process
        that was pinned to a core before JAX found out how many there are.
        """
        results: dict[int, Any] = {}
        todo: dict[int, tuple[Any, ...]] = {}
        for k, point in enumerate(points):
            found, result = (False, None) if self._journal is None else self._journal.read(stage, point)
            if found:
                results[k] = result
            else:
                todo[k] = point
        self(stage, len(results), len(points))
        for k, result in self._work(stage, work, todo, timed):
            results[k] = json.loads(json.dumps(result))
            if self._journal is not None:
                self._journal.append(stage, points[k], results[k])
            self(stage, len(results), len(points))
        return [results[k] for k in range(len(points))]

    def _work(
        self, stage: str, work: Callable[..., Any], points: dict[int, tuple[Any, ...]], timed: bool
    ) -> Iterator[tuple[int, Any]]:
        kept = {k: None if self._journal is None else self._journal.prefix(stage, point) for k, point in points.items()}
        if self._dask is not None and points:
            yield from on_cluster(self._dask, work, points, source())
            return
        jobs = 1 if timed else min(self._jobs, len(points))
        if not points or (jobs == 1 and not timed):
            for k, point in points.items():
                with at(kept[k], self._show):
                    result = work(*point)
                yield k, result
            return
        # JAX has threads, and a fork would copy their locks as they are.
        context = multiprocessing.get_context("spawn")
        cores = context.SimpleQueue()
        known = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
        for core in (known * jobs)[:jobs]:
            cores.put(core)
        with ProcessPoolExecutor(jobs, context, _pin, (cores, jax.config.values["jax_compilation_cache_dir"])) as pool:
            futures = {pool.submit(_inside, kept[k], work, point): k for k, point in points.items()}
            try:
                yield from ((futures[future], future.result()) for future in as_completed(futures))
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


def _pin(cores: Any, cache: str | None) -> None:
    """What a process of a sweep does first: take a core for itself, and find what others have compiled."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {cores.get()})
    keep_compiled(cache)


def _inside(prefix: str | None, work: Callable[..., Any], point: tuple[Any, ...]) -> Any:
    """A point, in another process: its long runs are saved, and shown to nobody."""
    with at(prefix, None):
        return work(*point)


def keep_compiled(folder: str | None = str(CACHE)) -> None:
    """Keep all compiled code in a folder, between processes and runs: a program's setting, not the library's."""
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


class Journal:
    """The finished points of one run, a line each, in a file that only this run has open.

    Beside it stand the checkpoints of its long runs, whose names begin with the file's.
    """

    def __init__(self, path: Path, file: IO[str], lines: list[dict[str, Any]]):
        self.path, self._file = path, file
        self._known = {_key(line["stage"], line["point"]): line["result"] for line in lines}

    def __len__(self) -> int:
        return len(self._known)

    def read(self, stage: str, point: tuple[Any, ...]) -> tuple[bool, Any]:
        """Whether a point is finished, and its result."""
        key = _key(stage, point)
        return key in self._known, self._known.get(key)

    def prefix(self, stage: str, point: tuple[Any, ...]) -> str:
        """What the names of the checkpoints of a point's long runs begin with."""
        return f"{self.path}.{_digest(_key(stage, point))}"

    def append(self, stage: str, point: tuple[Any, ...], result: Any) -> None:
        """Keep a result; it stands in the file, whole, when this returns, and its checkpoints are gone."""
        self._file.write(_line({"stage": stage, "point": point, "result": result}))
        self._file.flush()
        os.fsync(self._file.fileno())
        self._known[_key(stage, point)] = result
        for checkpoint in checkpoints(Path(self.prefix(stage, point))):
            checkpoint.unlink()


def checkpoints(path: Path) -> list[Path]:
    """The files whose names go on where `path` ends."""
    return [found for found in path.parent.iterdir() if found.name.startswith(f"{path.name}.")]


@contextmanager
def journal(path: Path, run: dict[str, Any], resume: bool) -> Iterator[Journal]:
    """The journal of a run at `path`, gone when the run has ended well.

    Args:
        path: the file.
        run: what the results depend on: the experiment, its configuration and seed. The source is added.
        resume: take up what an interrupted run has left.

    Raises `ValueError` where another run has the file open, where a line is damaged, where there is something to take
    up and `resume` is false, and where it is of a run that differs. A last line without its end is what a kill leaves,
    and is done again.

    """
    head = {**run, "source": source()}
    with path.open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ValueError(f"another run is writing to {path.parent}; wait for it, or name another --out") from None
        file.seek(0)
        text = file.read()
        text = text[: text.rfind("\n") + 1]
        lines = _lines(path, text)
        unfinished = checkpoints(path) if lines else []
        if len(lines) > 1 or unfinished:
            start_over = f"delete {path} to start over"
            left = f"an interrupted run has left {len(lines) - 1} finished parts and {len(unfinished)} checkpoints"
            require(resume, f"{left}: go on with --resume, or {start_over}")
            differs = [name for name in head if lines[0].get(name) != head[name]]
            require(not differs, f"the interrupted run differs in its {', '.join(differs)}; {start_over}")
            file.truncate(len(text.encode()))
        else:
            file.truncate(0)
            file.write(_line(head))
            file.flush()
            for orphan in checkpoints(path):  # their journal was deleted, to start over
                orphan.unlink()
        kept = Journal(path, file, lines[1:])
        try:
            yield kept
        except BaseException:
            if not len(kept) and not checkpoints(path):
                path.unlink()
            raise
        # Only a run that has written its results forgets how it came to them.
        for checkpoint in checkpoints(path):
            checkpoint.unlink()
        path.unlink()


@cache
def source() -> str:
    """A digest of every Python file of the library and the experiments: results of other code are other results."""
    digest = hashlib.sha256()
    for package in ("mcmc1d", "experiments"):
        for file in sorted((Path(__file__).parents[2] / package).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _key(stage: str, point: Any) -> str:
    return json.dumps([stage, point])


def _line(content: dict[str, Any]) -> str:
    text = json.dumps(content)
    return f"{_digest(text)} {text}\n"


def _lines(path: Path, text: str) -> list[dict[str, Any]]:
    lines = [line.partition(" ") for line in text.splitlines()]
    for number, (digest, _, content) in enumerate(lines, 1):
        require(digest == _digest(content), f"line {number} of {path} is damaged; delete the file to start over")
    return [json.loads(content) for _, _, content in lines]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
