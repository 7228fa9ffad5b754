"""Side by side, since compiling uses one core: commands in processes that are pinned to one each, calls in threads."""

import itertools
import os
import queue
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextvars import copy_context
from typing import Any

from mcmc1d.checks import require

# The process pins itself: to have it done between fork and exec is not safe beside JAX's threads.
_PINNED = """
import os, runpy, sys
os.sched_setaffinity(0, map(int, sys.argv.pop(1).split(",")))
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""


def side_by_side(module: str, parts: Sequence[Sequence[str]], jobs: int, done: Callable[[int, str, str], None]) -> int:
    """Run `python -m module ARGUMENTS` for each list of arguments, `jobs` at a time; the largest exit code.

    One at a time has all cores. `done` is called as each ends, with its number, its output and its errors. Ctrl-C
    reaches all of them.
    """
    require(jobs >= 1, f"jobs is a number of processes, at least 1, not {jobs}")
    every = sorted(os.sched_getaffinity(0))
    shares = [[core] for core in (every * jobs)[:jobs]] if jobs > 1 else [every]
    cores: queue.SimpleQueue[list[int]] = queue.SimpleQueue()
    for share in shares:
        cores.put(share)

    def one(arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
        own = cores.get()
        try:
            command = [sys.executable, "-c", _PINNED, ",".join(map(str, own)), module, *arguments]
            return subprocess.run(command, capture_output=True, text=True, check=False)
        finally:
            cores.put(own)

    codes = [0]
    with ThreadPoolExecutor(jobs) as pool:
        futures = {pool.submit(one, arguments): k for k, arguments in enumerate(parts)}
        try:
            for future in as_completed(futures):
                ended = future.result()
                done(futures[future], ended.stdout, ended.stderr)
                # A process that a signal has ended says so by a negative code.
                codes.append(abs(ended.returncode))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return max(codes)


def both_cores(work: Callable[[Any], Any], items: Iterable, progress: Callable[[int, int], None]) -> list[Any]:
    """`work` on each item, two at once: most of it is compiling, which takes one core."""
    todo, done = list(items), itertools.count(1)

    def one(item: Any) -> Any:
        result = work(item)
        progress(next(done), len(todo))
        return result

    with ThreadPoolExecutor(2) as pool:
        # Each in the context of here, where long runs learn where they are kept.
        return [part.result() for part in [pool.submit(copy_context().run, one, item) for item in todo]]


__all__ = ["both_cores", "side_by_side"]
