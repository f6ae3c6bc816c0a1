"""`sg.watch`: watch a run, its file, or scans as they arrive."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import logs
from logs.run import Run
from sensorgraph.errors import as_sensorgraph_error
from sensorgraph.graph import Sensorgraph
from sensorgraph.intake import check_ranges
from sensorgraph.watching.observation import Observation
from sensorgraph.watching.policy import WatchPolicy, load_policy
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.watcher import watch_run, watch_scans


@as_sensorgraph_error
def watch(
    graph: Sensorgraph | Path | str,
    scans: Run | Path | str | Iterable[Observation],
    *,
    policy: WatchPolicy | Path | str | None = None,
) -> Iterator[WatchStatus]:
    """Watch a robot in the place of a graph: yield a status about pose, place and robot once a second.

    Parameters
    ----------
    graph : Sensorgraph of faces or cells, or its file.
    scans : Run, its file, or observations as they arrive: stamp, ranges, odometry, and the pose that the robot believes.
    policy : Policy from good runs, or its yaml. Its baselines separate a healthy robot from a faulty one.

    Raises
    ------
    SensorgraphError : The graph has another model, the scans are of another sensor, or a file is missing or damaged.
        Errors of the scans are raised when the statuses are read.
    """
    model = graph if isinstance(graph, Sensorgraph) else Sensorgraph.load(graph)
    limits = load_policy(Path(policy)) if isinstance(policy, str | Path) else policy or WatchPolicy()
    if isinstance(scans, str | Path):
        scans = logs.read(scans)
    if isinstance(scans, Run):
        check_ranges(scans, str(scans.meta.get("source", "the run")))
        return watch_run(model, scans, baseline=limits.baseline)
    return watch_scans(model, scans, baseline=limits.baseline)
