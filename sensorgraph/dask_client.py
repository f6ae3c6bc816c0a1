"""A client of a Dask cluster that is already running."""

from __future__ import annotations

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
        client: Any = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as exc:
        raise SensorgraphError(
            f"Dask at {address}: no scheduler answers ({exc}); start one with `dask scheduler`"
        ) from exc
    if not n_threads(client):
        client.close()
        raise SensorgraphError(
            f"Dask at {address}: the scheduler has no workers; start some with `dask worker`"
        )
    return client


def n_threads(client: Any) -> int:
    """Return the number of threads of all workers of a client."""
    return sum(client.nthreads().values())
