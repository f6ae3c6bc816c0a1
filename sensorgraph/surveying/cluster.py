"""Run one task for each log on a Dask cluster: a local one, or the one of a scheduler."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from sensorgraph.dask_client import TASKS_AHEAD, connected, n_threads
from sensorgraph.errors import SensorgraphError
from sensorgraph.surveying.limited import (
    TaskError,
    TaskKilledError,
    TaskLimitError,
    TaskLimits,
    end_all,
    run_limited,
    start_again,
)

DASHBOARD = "127.0.0.1:8787"
WORK = "sensorgraph.surveying.survey:survey"


def task(arguments: dict[str, Any], limits: TaskLimits) -> dict[str, Any]:
    """Survey one log in a process with limits; a failure becomes the `error` of its result.

    An error of the limits names them in `limits`. An error that may pass, as of a killed process, has `is_passing`.
    """
    try:
        result: dict[str, Any] = run_limited(WORK, arguments, limits)
    except TaskLimitError as exc:
        return {"error": str(exc), "limits": limits.as_list()}
    except TaskError as exc:
        return {"error": str(exc), "is_passing": isinstance(exc, TaskKilledError)}
    return result


@contextmanager
def cluster(address: str | None, n_workers: int | None) -> Iterator[Any]:
    """Yield a client of the cluster at an address, or of a local cluster.

    The local cluster has threads: each log has a process of its own anyway.

    Raises
    ------
    SensorgraphError : Dask is not installed, no scheduler answers, or it has no workers.
    """
    if address is not None:
        with connected(address) as client:
            yield client
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise SensorgraphError("fleet needs Dask; install it with: pip install distributed") from None
    n = n_workers or os.cpu_count() or 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # another cluster may use the port of the dashboard
        local: Any = LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=1, threads_per_worker=n, processes=False, dashboard_address=DASHBOARD,
            worker_dashboard_address="127.0.0.1:0", silence_logs=50, memory_limit=0,
        )  # fmt: skip
    try:
        with local, Client(local, set_as_default=False) as client:  # type: ignore[no-untyped-call]
            try:
                yield client
            finally:
                end_all()  # after Ctrl-C, the cluster would wait for the logs that its threads analyse
    finally:
        start_again()


def surveyed(
    client: Any, jobs: Iterable[tuple[str, dict[str, Any]]], limits: TaskLimits
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (key, result) of jobs as they finish; few are submitted ahead.

    A job whose worker dies repeatedly has an error as its result.
    """
    from distributed import as_completed

    waiting: Any = as_completed(loop=client.loop)  # type: ignore[no-untyped-call]
    keys: dict[str, str] = {}
    left = iter(jobs)
    n_ahead = TASKS_AHEAD * max(1, n_threads(client))

    def submit() -> bool:
        job = next(left, None)
        if job is None:
            return False
        future = client.submit(task, job[1], limits, pure=False)
        keys[future.key] = job[0]
        waiting.add(future)
        return True

    n_waiting = sum(submit() for _ in range(n_ahead))
    while n_waiting:
        future = next(waiting)
        n_waiting -= 1
        try:
            result = future.result()
        except Exception as exc:
            text = " ".join(str(exc).split())
            result = {"error": f"its worker was lost: {type(exc).__name__}: {text}", "is_passing": True}
        yield keys.pop(future.key), result
        del future
        n_waiting += submit()
