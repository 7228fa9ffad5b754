"""A sweep on a Dask cluster: points are sent to its workers, and to another where one dies."""

from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from typing import Any


def on_cluster(
    address: str, work: Callable[..., Any], points: Mapping[int, tuple[Any, ...]], source: str
) -> Iterator[tuple[int, Any]]:
    """(k, work(*points[k])) as they are done, by the workers of the scheduler at `address`.

    A worker that dies has its points done again by another. One with other code or another JAX refuses, because a
    result must not depend on who found it. Raises `ValueError` where nobody answers at the address.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise ValueError("--dask needs the package distributed: pip install 'mcmc1d[cluster]'") from None
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f"no Dask scheduler answers at {address}: {error}; start one with `dask scheduler`") from None
    with client:
        # Not pure: Dask would take a result of an earlier run for this one's, whatever has become of the code.
        futures = {
            client.submit(remote, work, point, versions(source), pure=False, retries=2): k
            for k, point in points.items()
        }
        try:
            for future in as_completed(list(futures), loop=client.loop):
                yield futures[future], future.result()
                future.release()
        finally:
            client.cancel(list(futures))


def versions(source: str) -> dict[str, str]:
    """What the bits of a result depend on, beside the point."""
    return {"source": source, **{name: version(name) for name in ("jax", "jaxlib", "numpy")}}


def remote(work: Callable[..., Any], point: tuple[Any, ...], expected: dict[str, str]) -> Any:
    """What a worker does."""
    from experiments.support import sweep

    found = versions(sweep.source())
    differs = [f"{name} {found[name]}, not {expected[name]}" for name in expected if found[name] != expected[name]]
    if differs:
        raise ValueError(f"a worker of the cluster has {', '.join(differs)}: give it what this process has")
    sweep.keep_compiled()
    return work(*point)
