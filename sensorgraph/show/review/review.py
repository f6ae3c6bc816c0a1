"""`review`: one call from a run to a file for rerun's viewer."""

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
"""Every so many poses of a plan are drawn."""


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
    """Write what there is to see of a run, and of a sensorgraph against it, as a file for rerun's viewer.

    Scans in the map, coverage, error by place, heading and ray, and a report. No viewer is needed to write it; open
    it with `rerun FILE`.

    Parameters
    ----------
    run : a run, or a file that `logs.read` opens
    path : the file to write, *.rrd
    graph : a sensorgraph, or its file
    plan : a plan or its folder, whose path is drawn, too
    arena : walls to draw; None: those that the run keeps, if it keeps any
    ray : index of the ray whose series is shown; None: the one that looks straight ahead
    name : what to call the run; None: the file it says it came from
    force : take a run whose poses jump, too; False: refuse it, as the commands do
    progress : opens a bar for each stage

    Returns
    -------
    Review with everything that is drawn, as arrays

    Raises
    ------
    SensorgraphError : the file is not named *.rrd, no scan has a pose, the ray does not exist, or graph and run do not fit
    LogError : the run cannot be read
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
