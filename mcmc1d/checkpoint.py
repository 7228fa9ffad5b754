"""Checkpoints of long runs: one file, whole at every moment, that only the run that it is of takes up."""

import hashlib
import io
import json
import os
import re
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checks import require
from mcmc1d.state import State

_MAGIC = b"mcmc1d checkpoint 1"


class Place(NamedTuple):
    """How far a block of chains has come: all that it takes to go on, to the bit.

    The position in its stream of random numbers is the step, of which they are a function.
    """

    step: int
    state: State
    totals: Any


class Saving(NamedTuple):
    """Where a run is saved, if anywhere, how often in seconds, and whether it may take up what is there."""

    path: str | os.PathLike[str] | None = None
    every: float = 60.0
    resume: bool = False


class Keeper:
    """The places of a run's blocks, saved as they change; kept in memory alone where there is no file."""

    def __init__(self, places: Sequence[Place], file: "_Locked | None" = None, head: Any = None, every: float = 0.0):
        self.places = list(places)
        self.stop = threading.Event()
        self._file, self._head, self._every = file, head, every
        self._saving = threading.Lock()
        self._saved = time.monotonic()

    @property
    def steps(self) -> int:
        """How many steps the blocks have made, all together."""
        return sum(place.step for place in self.places)

    def record(self, block: int, place: Place) -> None:
        """A block has come to `place`; saves all of them where it is time. Raises `CancelledError` after a stop."""
        self.places[block] = place  # blocks do not depend on each other: any mixture of their places is a whole
        if self._file is not None and time.monotonic() >= self._saved + self._every:
            self.save(wait=False)
        if self.stop.is_set():
            raise CancelledError

    def save(self, wait: bool = True) -> bool:
        """Save; not if another thread is at it and `wait` is false. Whether the file now holds these places.

        A disk that is full takes nothing from the checkpoint that stands, and the run goes on: a warning says so.
        """
        if self._file is None or not self._saving.acquire(blocking=wait):
            return False
        try:
            self._file.replace(encode(self._head, self.places))
        except OSError as error:
            stands = "nothing has been saved yet" if self._file.empty else "the checkpoint before this one stands"
            warnings.warn(
                f"can not save the checkpoint {self._file.path}: {error.strerror}; {stands}, the run goes on and tries "
                f"again in {self._every:g} s",
                stacklevel=2,
            )
            return False
        finally:
            self._saved = time.monotonic()
            self._saving.release()
        return True


@contextmanager
def kept(fresh: Sequence[Place], identity: Callable[[], dict[str, Any]], saving: Saving) -> Iterator[Keeper]:
    """The places of a run's blocks: `fresh`, or if asked to resume those of the checkpoint, where there is one.

    At the end the file stands and holds the result, so that a program of several runs that is killed in a later one
    finds it. Of several processes each has a file of its own. Where Ctrl-C ends the run its places are saved first, and
    the `KeyboardInterrupt` says how to go on.
    `identity` says what the run is; a checkpoint of another one is refused with what differs.

    Raises `ValueError` where the file can not be made, another run has it open, it is cut off, changed, or of another
    run, and where there is one and it was not asked to resume.
    """
    path, every, resume = saving
    if path is None:
        require(not resume, "run: resume=True needs checkpoint=PATH, the file to go on from")
        yield Keeper(fresh)
        return
    require(every >= 0, f"run: every is a time in seconds, not {every}")
    head, places = identity(), list(fresh)
    path = Path(path)
    if jax.process_count() > 1:
        head["processes"] = jax.process_count()
        path = path.with_name(f"{path.name}.{jax.process_index()}")
    with _locked(path) as file:
        content = file.read()
        if content:
            require(
                resume,
                f"the checkpoint {path} holds a run that was begun before; go on with resume=True, or delete the file",
            )
            places = decode(content, head, fresh, f"the checkpoint {path}")
        keeper = Keeper(places, file, head, every)
        try:
            yield keeper
        except KeyboardInterrupt:
            saved = f"all of it is in {path}" if keeper.save() else f"{path} holds what was saved before"
            share = keeper.steps / (len(places) * head["steps"])
            raise KeyboardInterrupt(
                f"interrupted when {share:.1%} was done; {saved}: go on with the same call and resume=True"
            ) from None
        keeper.save()


def describe(tree: Any) -> str:
    """A digest of a pytree: its structure, and every bit of its leaves. What a function does it can not tell."""
    leaves, structure = jax.tree.flatten(tree)
    digest = hashlib.sha256(_plain(structure).encode())
    for leaf in leaves:
        if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            digest.update(_plain(leaf.dtype).encode())
            digest.update(np.asarray(jax.random.key_data(leaf)).tobytes())
        elif isinstance(leaf, np.ndarray | np.generic | jax.Array):
            array = np.ascontiguousarray(leaf)
            digest.update(f"{array.dtype} {array.shape} ".encode() + array.tobytes())
        else:
            digest.update(_plain(leaf).encode())
    return digest.hexdigest()[:16]


def _plain(thing: Any) -> str:
    """Its text without addresses, which are others in every process."""
    return re.sub(r" at 0x[0-9a-f]+", "", str(thing))


def encode(head: dict[str, Any], places: Sequence[Place]) -> bytes:
    """A line with length and checksum of what follows: a line of JSON that says whose it is, and NumPy's npz."""
    leaves = [[np.asarray(leaf) for leaf in jax.tree.leaves(place)] for place in places]
    buffer = io.BytesIO()
    np.savez(buffer, *(np.stack(parts) for parts in zip(*leaves, strict=True)))
    body = json.dumps(head).encode() + b"\n" + buffer.getvalue()
    return b"%s %d %s\n%s" % (_MAGIC, len(body), hashlib.sha256(body).hexdigest().encode(), body)


def decode(content: bytes, head: dict[str, Any], like: Sequence[Place], who: str) -> list[Place]:
    """The places in `content`, of the shapes of `like`; nothing is unpickled.

    Raises `ValueError` where the content is cut off, changed, or of a run with another head, and says what differs.
    """
    over = "; delete it to start over"
    first, _, body = content.partition(b"\n")
    require(
        first.startswith(_MAGIC + b" "), f"{who} is none of this version of mcmc1d, or its first line is lost{over}"
    )
    length, _, digest = first[len(_MAGIC) + 1 :].decode("ascii", "replace").partition(" ")
    require(length == str(len(body)), f"{who} is cut off or changed: {len(body)} bytes where it names {length}{over}")
    require(digest == hashlib.sha256(body).hexdigest(), f"{who} is damaged: its checksum is another{over}")
    text, _, arrays = body.partition(b"\n")
    theirs = json.loads(text)
    differs = [_difference(name, theirs.get(name), head.get(name)) for name in {**head, **theirs}]
    differs = [difference for difference in differs if difference]
    require(
        not differs,
        f"{who} is of another run: {', '.join(differs)}; call run as it was called then, or delete the file to start "
        "over",
    )
    wanted = [np.stack([np.asarray(part) for part in parts]) for parts in zip(*map(jax.tree.leaves, like), strict=True)]
    with np.load(io.BytesIO(arrays), allow_pickle=False) as archive:
        found = [archive[name] for name in archive.files]
    fits = [(a.shape, a.dtype) for a in found] == [(a.shape, a.dtype) for a in wanted]
    require(fits, f"{who} has arrays of other shapes than the run's{over}")
    structure = jax.tree.structure(like[0])
    rows = [jax.tree.unflatten(structure, [a[k] for a in found]) for k in range(len(like))]
    return [row._replace(step=int(row.step)) for row in rows]


def _difference(name: str, theirs: Any, ours: Any) -> str:
    """In what two heads differ: numbers and names are shown, digests would say nothing."""
    if theirs == ours:
        return ""
    shown = all(
        isinstance(value, int | str) and not re.fullmatch("[0-9a-f]{16}", str(value)) for value in (theirs, ours)
    )
    return f"its {name} is {theirs}, here {ours}" if shown else f"its {name} differs"


class _Locked:
    """A file that this run alone may replace, while it has it open."""

    def __init__(self, path: Path):
        self.path = path
        self.file = _claim(path)

    @property
    def empty(self) -> bool:
        return os.fstat(self.file.fileno()).st_size == 0

    def read(self) -> bytes:
        self.file.seek(0)
        return self.file.read()

    def replace(self, content: bytes) -> None:
        """Put `content` in the place of the file's: at any moment the one or the other stands there, whole.

        The new file is locked before it takes the name, so that the name is never free for another run.
        """
        beside = self.path.with_name(f".{self.path.name}.part")
        new = beside.open("w+b")
        try:
            _lock(new)
            new.write(content)
            new.flush()
            os.fsync(new.fileno())
            beside.replace(self.path)
        except BaseException:
            beside.unlink(missing_ok=True)
            with suppress(OSError):
                new.close()  # tries once more to write what a full disk has not taken
            raise
        self.file.close()
        self.file = new
        # Without it a power cut may undo the renaming.
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def _locked(path: Path) -> Iterator[_Locked]:
    file = _Locked(path)
    try:
        yield file
    finally:
        if file.empty:
            path.unlink(missing_ok=True)
        file.file.close()


def _claim(path: Path) -> Any:
    """The file at `path`, made if need be, and locked."""
    while True:
        try:
            file = path.open("a+b")
        except OSError as error:
            raise ValueError(f"can not write the checkpoint {path}: {error.strerror}; name another path") from None
        try:
            _lock(file)
            if os.fstat(file.fileno()).st_ino == path.stat().st_ino:
                return file
        except BlockingIOError:
            file.close()
            raise ValueError(f"another run has the checkpoint {path} open: wait for it, or name another path") from None
        except FileNotFoundError:
            pass
        # Between opening and locking it the run that had it has put another in its place.
        file.close()


def _lock(file: Any) -> None:
    import fcntl  # where there is none, the library still does all but this

    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
