"""Runs that take minutes: saved as they go, and shown."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple
from zlib import crc32

import mcmc1d

Show = Callable[[str, int, int], None]
"""Called with a stage's name, the work done in it and the work in all."""

SECONDS = 20.0
"""Between two checkpoints; what a kill takes at most of a run that is saved."""


class _Here(NamedTuple):
    prefix: str | None = None
    show: Show | None = None


_HERE: ContextVar[_Here | None] = ContextVar("here", default=None)


@contextmanager
def at(prefix: str | None, show: Show | None) -> Iterator[None]:
    """Inside, long runs are saved in files of this prefix, if any, and shown."""
    token = _HERE.set(_Here(prefix, show))
    try:
        yield
    finally:
        _HERE.reset(token)


def long_run(name: str, *arguments: Any, saved: bool = True, **options: Any) -> "mcmc1d.Run":
    """`mcmc1d.run(*arguments, **options)`, which goes on from where an interrupted experiment has left it.

    `name` is what is shown; no other run of the experiment, or of the sweep's point, may have it. Unless `saved` it is
    shown alone: to describe a program, so that a run can be told from others, may take longer than to run it. Outside
    of an experiment it is `mcmc1d.run`.
    """
    prefix, show = _HERE.get() or _Here()
    if saved and prefix is not None:
        file = f"{re.sub('[^a-z0-9]+', '-', name.lower())}-{crc32(name.encode()):08x}"
        options |= {"checkpoint": f"{prefix}.{file}", "every": SECONDS, "resume": True}
    if show is not None:
        options["progress"] = lambda done, total: show(name, done, total)
    return mcmc1d.run(*arguments, **options)
