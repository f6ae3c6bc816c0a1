"""Reduction of blocks on a Dask cluster; same work and order as locally, so the graph has the same bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from sensorgraph.errors import SensorgraphError
from sensorgraph.models.faces.reduction import Block, MapBlocks, Reduction

CONNECT_TIMEOUT = 10.0  # [s]
BLOCKS_AHEAD = 2
"""Number of pending blocks for each thread of the workers; it bounds the memory."""


@contextmanager
def cluster(address: str) -> Iterator[MapBlocks]:
    """Yield a `map` that runs on the Dask cluster whose scheduler is at `address`, such as tcp://10.0.0.5:8786."""
    try:
        from distributed import Client
    except ImportError:
        raise SensorgraphError("a cluster needs Dask; install it with: pip install distributed") from None
    try:
        client: Any = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as exc:
        raise SensorgraphError(
            f"Dask at {address}: no scheduler answers ({exc}); start one with `dask scheduler`"
        ) from exc
    with client:
        n_threads = sum(client.nthreads().values())
        if n_threads == 0:
            raise SensorgraphError(
                f"Dask at {address}: the scheduler has no workers; start some with `dask worker`"
            )

        def map_blocks(function: Callable[[Block], Reduction], items: Iterable[Block]) -> Iterator[Reduction]:
            waiting = deque[Any]()
            for item in items:
                waiting.append(client.submit(function, item, pure=False))
                if len(waiting) >= BLOCKS_AHEAD * n_threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

        yield map_blocks
