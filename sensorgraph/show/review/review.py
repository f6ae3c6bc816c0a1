"""Write a review of a run as a file for rerun's viewer."""

from __future__ import annotations

from pathlib import Path

import logs
from logs.run import Run
from planners.arena import Arena
from planners.trajectory import read_csv
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import read_plan_report
from sensorgraph.planning.plan import CoveragePlan
from sensorgraph.show.review.contents import Review, collect
from sensorgraph.show.review.views import write
from sensorgraph.types import ProgressBars, no_progress

PLAN_STEP = 10
"""Step between the drawn poses of a plan."""


def review(
    run: Run | Path | str,
    *,
    path: Path | str,
    graph: Sensorgraph | Path | str | None = None,
    plan: CoveragePlan | Path | str | None = None,
    arena: Arena | None = None,
    ray: int | None = None,
    name: str | None = None,
    force: bool = True,
    progress: ProgressBars = no_progress,
) -> Review:
    """Write a review of a run, and of a sensorgraph on it, as a file for rerun's viewer.

    The file contains scans in the map, coverage, error by place, heading and ray, and a report. Writing needs no
    viewer; open the file with `rerun FILE`.

    Parameters
    ----------
    run : Run, or a file that `logs.read` opens.
    path : File to write, *.rrd.
    graph : Sensorgraph, or its file.
    plan : Plan or its folder, whose path is drawn.
    arena : Arena whose walls are drawn. None: no walls are drawn.
    ray : Index of the ray whose time series is shown. None: the ray straight ahead.
    name : Name of the run. None: the name of its source file.
    force : Accept a run whose poses jump. False: refuse it, as the commands do.
    progress : Opens a progress bar for each stage.

    Returns
    -------
    Review with the drawn contents as arrays.

    Raises
    ------
    SensorgraphError : The file is not named *.rrd, no scan has a pose, the ray does not exist, or graph and run differ.
    LogError : The run cannot be read.
    """
    path = Path(path)
    if path.suffix != ".rrd":
        raise SensorgraphError(
            f"{path}: a review is written as *.rrd; name it {path.with_suffix('.rrd').name}"
        )
    if not isinstance(run, Run):
        run = logs.read(Path(run))
    if isinstance(graph, Path | str):
        graph = Sensorgraph.load(Path(graph))
    planned, facts = None, None
    if isinstance(plan, CoveragePlan):
        planned, facts = plan.trajectory.poses[::PLAN_STEP, :2], plan.to_dict()
    elif plan is not None:
        if not (Path(plan) / "trajectory.csv").is_file():
            raise SensorgraphError(
                f"{plan} has no trajectory.csv, expected a plan's folder (from `sensorgraph plan`)"
            )
        planned = read_csv(Path(plan) / "trajectory.csv").poses[::PLAN_STEP, :2]
        facts = read_plan_report(Path(plan) / "plan.json")
    contents = collect(
        run,
        graph=graph,
        arena=arena,
        name=name,
        planned=planned,
        plan=facts,
        force=force,
        progress=progress,
    )
    with progress("writing", "scans") as tick:
        write(contents, path, ray=ray, progress=tick)
    return contents
