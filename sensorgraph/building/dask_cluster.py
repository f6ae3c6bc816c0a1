"""Reduction of blocks on a Dask cluster; same work and order as locally, so the graph has the same bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from sensorgraph.dask_client import TASKS_AHEAD, connected, n_threads
from sensorgraph.models.faces.reduction import Block, MapBlocks, Reduction


@contextmanager
def cluster(address: str) -> Iterator[MapBlocks]:
    """Yield a `map` that runs on the Dask cluster whose scheduler is at `address`, such as tcp://10.0.0.5:8786."""
    with connected(address) as client:
        n_ahead = TASKS_AHEAD * n_threads(client)

        def map_blocks(function: Callable[[Block], Reduction], items: Iterable[Block]) -> Iterator[Reduction]:
            waiting = deque[Any]()
            for item in items:
                waiting.append(client.submit(function, item, pure=False))
                if len(waiting) >= n_ahead:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

        yield map_blocks
