"""Blocks of chains over the threads and devices of a process, and over processes: no bit depends on who does which."""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from mcmc1d.checkpoint import Place, Saving, decode, encode, kept
from mcmc1d.checks import require

T = TypeVar("T")
Advance = Callable[[int, Any, Place, int], Place]


def devices() -> list[Any]:
    """The devices of this process that blocks are dealt over; `[None]`, which is JAX's choice, where there is one.

    All of the default kind, unless a device or a kind was chosen by `jax.default_device`: then it is named, because a
    worker thread does not inherit that choice.
    """
    chosen = jax.config.values["jax_default_device"]
    if isinstance(chosen, jax.Device):
        return [chosen]
    local = jax.local_devices(backend=chosen)
    return local if len(local) > 1 or chosen is not None else [None]


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def put(tree: T, device: Any) -> T:
    """The same pytree with its arrays on a device; as it is, where the choice is JAX's."""
    if device is None:
        return tree
    return jax.tree.map(lambda x: jax.device_put(x, device) if isinstance(x, np.ndarray | jax.Array) else x, tree)


def own(blocks: int) -> range:
    """The blocks of this process: every n-th of them, where n processes work together by `jax.distributed`."""
    n = jax.process_count()
    require(blocks >= n, f"run: {n} processes need as many blocks at least, not {blocks}; give blocks=")
    return range(jax.process_index(), blocks, n)


def run_blocks(
    advance: Advance,
    fresh: Sequence[Place],
    steps: int,
    per_look: int,
    progress: Callable[[int, int], None] | None,
    identity: Callable[[], dict[str, Any]],
    saving: Saving,
) -> list[Place]:
    """Every block's place after so many steps, in pieces of `per_look`, from the `fresh` ones or the checkpoint's.

    `advance(block, device, place, count)` is the place `count` steps after another. `identity` says what the run is.
    """
    mine, counting = own(len(fresh)), threading.Lock()
    chains = len(fresh[0].state.u)

    def work() -> list[Place]:
        with kept([fresh[block] for block in mine], identity, saving) as keeper:

            def whole(k: int, device: Any) -> None:
                place = keeper.places[k]
                while place.step < steps:
                    place = advance(mine[k], device, place, min(per_look, steps - place.step))
                    keeper.record(k, place)
                    if progress is not None:
                        with counting:
                            progress(keeper.steps * chains, steps * len(mine) * chains)

            todo = [k for k, place in enumerate(keeper.places) if place.step < steps]
            _spread(todo, lambda device: advance(mine[0], device, fresh[mine[0]], 0), whole, keeper.stop)
        return keeper.places

    return list(work()) if jax.process_count() == 1 else _gather(work, fresh, identity())


def _spread(
    todo: Sequence[int], compile_for: Callable[[Any], Any], whole: Callable[[int, Any], None], stop: threading.Event
) -> None:
    """`whole(k, device)` for every k of `todo`, in threads, dealt over the devices.

    `compile_for(device)` runs before, so that two threads do not compile one program, and no core waits while one
    block alone does more than that. What ends a block, or Ctrl-C, sets `stop` for the others, and is raised when they
    have stopped.
    """
    if not todo:
        return
    count = len(todo)
    at_hand = devices()[:count]
    wide = jnp.zeros(()).dtype == jnp.float64

    def alike(function: Callable[..., T]) -> Callable[..., T]:
        """A worker thread does not inherit a context such as `with jax.enable_x64(True)`."""

        def inside(*arguments: Any) -> T:
            with jax.enable_x64(wide):
                return function(*arguments)

        return inside

    with ThreadPoolExecutor(min(count, max(cores(), len(at_hand)))) as pool:
        futures: list[Future[None]] = []
        try:
            if count > len(at_hand):
                list(pool.map(alike(compile_for), at_hand))
            futures += [pool.submit(alike(whole), k, at_hand[j % len(at_hand)]) for j, k in enumerate(todo)]
            wait(futures, return_when=FIRST_EXCEPTION)
            for future in futures:
                if future.done() and future.exception() is not None:
                    future.result()
        finally:
            stop.set()
            for future in futures:
                future.cancel()


def _gather(work: Callable[[], Sequence[Place]], fresh: Sequence[Place], head: dict[str, Any]) -> list[Place]:
    """The last places of all blocks, in their order: `work` gives those of this process.

    A `ValueError` in one process is raised in all, and where the processes' heads differ, so that none waits in vain.
    """
    try:
        mine = b"+" + encode(head, work())
    except ValueError as error:
        mine = b"-" + str(error).encode()
    said = _exchange(mine)
    for process, content in enumerate(said):
        if content[:1] == b"-":
            raise ValueError(f"process {process}: {content[1:].decode()}")
    places = list(fresh)
    for process, content in enumerate(said):
        its = slice(process, None, jax.process_count())
        places[its] = decode(content[1:], head, places[its], f"what process {process} found")
    return places


def _exchange(mine: bytes) -> list[bytes]:
    """What every process has to say, in their order."""
    from jax.experimental import multihost_utils

    sizes = np.ravel(multihost_utils.process_allgather(np.array([len(mine)], np.int32)))
    padded = np.zeros(int(sizes.max()), np.uint8)
    padded[: len(mine)] = np.frombuffer(mine, np.uint8)
    rows = np.asarray(multihost_utils.process_allgather(padded)).reshape(len(sizes), -1)
    return [row[:size].tobytes() for row, size in zip(rows, sizes, strict=True)]
