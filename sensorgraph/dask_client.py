"""A client of a Dask cluster that is already running."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from sensorgraph.errors import SensorgraphError

CONNECT_TIMEOUT = 10.0
"""[s]"""
TASKS_AHEAD = 2
"""Number of pending tasks for each thread of the workers; it bounds the memory."""


def connected(address: str) -> Any:
    """Return a client of the cluster whose scheduler is at `address`, such as tcp://10.0.0.5:8786.

    Raises
    ------
    SensorgraphError : Dask is not installed, no scheduler answers, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise SensorgraphError("a cluster needs Dask; install it with: pip install distributed") from None
    try:
        with ThreadPoolExecutor(1) as pool:  # a notebook has an event loop in its own thread
            pool.submit(asyncio.run, _greet(address)).result()
        client: Any = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (TimeoutError, MemoryError) as exc:  # Dask takes text for the length of a message
        raise SensorgraphError(
            f"Dask at {address}: what answers is no scheduler; give the address that `dask scheduler` prints, not that of "
            "its dashboard"
        ) from exc
    except (OSError, ValueError) as exc:
        raise SensorgraphError(
            f"Dask at {address}: no scheduler answers ({exc}); start one with `dask scheduler`"
        ) from exc
    if not n_threads(client):
        client.close()
        raise SensorgraphError(
            f"Dask at {address}: the scheduler has no workers; start some with `dask worker`"
        )
    return client


async def _greet(address: str) -> None:
    """Exchange greetings with a scheduler, because a client waits for them without a limit."""
    from distributed.comm.core import connect

    async with asyncio.timeout(2 * CONNECT_TIMEOUT):  # longer than the limit for the connection
        comm = await connect(address, timeout=CONNECT_TIMEOUT)  # type: ignore[no-untyped-call]
    await comm.close()


def n_threads(client: Any) -> int:
    """Return the number of threads of all workers of a client."""
    return sum(client.nthreads().values())


@contextmanager
def cluster_map(address: str) -> Iterator[Callable[..., Iterator[Any]]]:
    """Yield a `map` that runs on the cluster of `connected(address)`, in the order of the items."""
    with connected(address) as client:
        n_ahead = TASKS_AHEAD * n_threads(client)

        def mapped(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
            waiting = deque[Any]()
            for item in items:
                waiting.append(client.submit(function, item, pure=False))
                if len(waiting) >= n_ahead:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

        yield mapped
