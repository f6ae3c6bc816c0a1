"""Plan a drive for a robot in an arena: what the `plan` command and `sensorgraph.plan` share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import logs
import planners
from logs.html_table import html_table
from logs.run import Run
from planners.arena import Arena
from planners.errors import PlanError
from planners.maps.no_go import Zone, without
from planners.planning import WALL_MARGIN
from planners.settings import JOIN_PLANNERS
from planners.trajectory import Trajectory
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.files import atomic_folder
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import load_arena
from sensorgraph.planning import plan_folder
from sensorgraph.planning.priority import uncertainty
from sensorgraph.planning.resume import driven_poses, other_place_warnings
from sensorgraph.planning.survey import LaserSurvey, survey_of
from sensorgraph.planning.views import views_within
from sensorgraph.types import Floats, Progress
from sensorgraph.world.robot import Robot, load_robot


@dataclass(frozen=True, kw_only=True, eq=False)
class CoveragePlan:
    """A planned drive with the arena and the robot that it was planned for."""

    drive: planners.Plan
    arena: Arena
    robot: Robot

    @property
    def trajectory(self) -> Trajectory:
        """Stamps (n,) [s], poses (n, 3) [m, m, rad] and twists (n, 2) [m/s, rad/s]."""
        return self.drive.trajectory

    def to_dict(self) -> dict[str, Any]:
        """Return what `plan.json` holds: coverage, time, clearance, settings; plain data."""
        return dict(self.drive.report)

    def save(self, folder: Path | str) -> Path:
        """Write trajectory, waypoints, MCAP, report and pictures into a folder; all of it or nothing."""
        folder = Path(folder)
        if folder.exists() and not folder.is_dir():
            raise SensorgraphError(f"{folder} is a file; give a folder to write the plan to")
        with atomic_folder(folder) as part:
            plan_folder.save(self.drive, part, self.arena, self.robot)
            plan_folder.drop_runs(folder)
        return folder

    def __repr__(self) -> str:
        report = self.drive.report
        return (
            f"CoveragePlan({report['planner']}): {100 * report['coverage']:.2f} % of "
            f"{report['reachable_cells']:,} reachable (x, y, phi) bins\n"
            f"  {report['drive_time_s'] / 60:.1f} min, {report['path_m']:.0f} m, "
            f"clearance {report['min_clearance_m']:.3f} m"
        )

    def _repr_html_(self) -> str:
        """Return what a notebook shows: coverage, time and way."""
        report = self.drive.report
        rows = [
            ("planner", str(report["planner"])),
            ("coverage", f"{100 * report['coverage']:.2f} % of {report['reachable_cells']:,} (x, y, φ) bins"),
            (
                "drive time",
                f"{report['drive_time_s'] / 60:.1f} min, {report['ratio']:.2f} of the reference time",
            ),
            ("path", f"{report['path_m']:.0f} m"),
            ("clearance", f"{report['min_clearance_m']:.3f} m"),
            ("limit violations", str(report["limit_violations"])),
        ]
        return html_table(f"Coverage plan for {self.robot.name}", rows)


@as_sensorgraph_error
def plan(
    arena: Arena | Path | str,
    robot: Robot | Path | str | None = None,
    *,
    planner: str = "coverage",
    cell: float = 0.25,
    headings: int = 16,
    start: Floats | None = None,
    end: Floats | None = None,
    views: int | None = None,
    no_go: Sequence[Zone] = (),
    resume: Run | Path | str | Sequence[Run | Path | str] | None = None,
    priority: Sensorgraph | None = None,
    budget: float | None = None,
    battery: float | None = None,
    dock: Floats | None = None,
    duration: float | None = None,
    order: str | None = None,
    graph: Sensorgraph | None = None,
    margin: float = WALL_MARGIN,
    join_planner: str = JOIN_PLANNERS[0],
    seed: int = 0,
    progress: Progress | None = None,
    status: Callable[[str], None] | None = None,
) -> CoveragePlan:
    """Plan a drive that fills (x, y, phi): every reachable place, in every heading.

    Parameters
    ----------
    arena : an arena, its file, or the name of a shipped one
    robot : a robot or its robot.yaml; None: the shipped robot
    planner : `coverage`, `stop_and_spin`, or one of the baselines `random_bounce` and `wall_following`
    cell : [m] side of a position cell
    headings : count of heading bins of a full turn
    start, end : (3,) [m, m, rad] pose of base_link; None: where it suits the planner
    views : visit only so many poses, those that show most surface, instead of filling (x, y, phi)
    no_go : polygons [m, map] that the robot may not enter and its laser sees through
    resume : a run already driven, or its file, or several; their bins need no visit
    priority : first the places that this sensorgraph does not know, then those where it is unsure
    budget : [s] within which the drive ends
    battery : [s] of one run; the drive is parted into runs from `dock` (3,) [m, m, rad] and back to it
    duration : [s] of the baselines; None: the reference time of the coverage planner
    margin : [m] that the robot's rim keeps from walls
    join_planner : the planner of OMPL that finds ways round obstacles, by name, or one of your own as `module:Class`
    order : `fast`, the shortest drive; or `anytime`, of which every prefix is worth most. None: anytime for a robot that
        turns in place if a `budget` or a `graph` is given and no `priority`, else fast
    graph : for the order anytime: look first where this sensorgraph would not answer or be wrong
    seed : the same seed gives the same plan, byte for byte
    progress : is called with (bins done, bins in all)
    status : is told in a few words what is being planned, and how good it is already

    Raises
    ------
    SensorgraphError : the robot does not fit, a pose is in a wall, nothing is within reach, or two arguments contradict
    """
    world = arena if isinstance(arena, Arena) else load_arena(arena)
    machine = robot if isinstance(robot, Robot) else load_robot(robot)
    _check_views(views, planner, resume)
    targets = None if views is None else partial(
        views_within, n=views, arena=world, sensor=machine.sensor, graph=priority, seed=seed
    )  # fmt: skip
    visited = None if resume is None else _driven(resume, world)
    if order is None:
        has_own = priority is not None or views is not None
        order = _usual_order(
            planner, machine, is_cut=budget is not None or graph is not None, has_own=has_own
        )
    drive = planners.plan(
        without(world, no_go), machine, planner=planner if views is None else "views", cell=cell, headings=headings,
        seed=seed, start=start, end=end, dock=dock, budget=budget, battery=battery, duration=duration, margin=margin,
        sweep_time=machine.sensor.scan_duration, rate=machine.sensor.rate, visited=visited, targets=targets,
        priority=None if priority is None or targets is not None else partial(uncertainty, priority),
        order=order, survey=_survey(order, world, machine, graph, visited), join_planner=join_planner, progress=progress,
        status=status,
    )  # fmt: skip
    _note(drive.report, arena, world, [known for known in (priority, graph) if known is not None], no_go)
    return CoveragePlan(drive=drive, arena=world, robot=machine)


def _usual_order(planner: str, machine: Robot, *, is_cut: bool, has_own: bool) -> str:
    """Return anytime where the drive may be cut short or has a graph to ask, if it has no order of its own, else fast."""
    can = planner == "coverage" and machine.drive == "diff" and not has_own
    return "anytime" if can and is_cut else "fast"


def _note(
    report: dict[str, Any],
    arena: Arena | Path | str,
    world: Arena,
    graphs: Sequence[Sensorgraph],
    no_go: Sequence[Zone],
) -> None:
    """Note in plan.json what the planner does not know: the arena's name, graphs of other places, zones."""
    if not isinstance(arena, Arena):
        report["arena"] = Path(arena).name
    for known in graphs:
        report["warnings"] += other_place_warnings(known, world)
    if no_go:
        report["no_go"] = [[list(corner) for corner in zone.exterior.coords[:-1]] for zone in no_go]


def _survey(
    order: str, world: Arena, machine: Robot, graph: Sensorgraph | None, visited: Floats | None
) -> LaserSurvey | None:
    """Return what the order anytime asks where to look: what no pose has seen, and of that what a graph does not know.

    Rays that a graph cannot know, as those that graze edges, would draw every run to the same places if poses did not count.
    """
    if order != "anytime":
        if graph is not None:
            raise PlanError("a graph says where to look first in the order anytime; or give it as priority")
        return None
    survey = survey_of(world, machine.sensor, graph)
    if visited is not None:
        survey.mark(visited)
    return survey


def _check_views(views: int | None, planner: str, resume: object | None) -> None:
    """Refuse what contradicts a plan of views."""
    if views is None:
        if planner == "views":
            raise PlanError("the planner views needs to know how many; give `views`")
        return
    if planner not in ("coverage", "views"):
        raise PlanError(f"`views` has a planner of its own; leave out `planner` {planner}")
    if resume is not None:
        raise PlanError(
            "`views` cannot resume a run; leave out `resume`, build a graph from that run, and give it as `priority`"
        )


def _driven(resume: Run | Path | str | Sequence[Run | Path | str], arena: Arena) -> Floats:
    """Return the poses (n, 3) [m, m, rad] of runs already driven."""
    if isinstance(resume, Run):
        return driven_poses(resume, arena)
    if isinstance(resume, Path | str):
        return driven_poses(logs.read(resume), arena, name=str(resume))
    return np.concatenate([_driven(run, arena) for run in resume])
