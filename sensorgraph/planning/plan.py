"""Plan a drive for a robot in an arena; used by the `plan` command and `sensorgraph.plan`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import logs
import planners
from logs.html_table import html_table
from logs.run import Run
from logs.transforms import compose
from planners.arena import Arena
from planners.coverage import CELL, HEADINGS
from planners.errors import PlanError
from planners.joins.ompl_process import JOIN_PLANNERS
from planners.maps.no_go import Zone, without
from planners.planning import WALL_MARGIN
from planners.trajectory import Trajectory
from sensorgraph.arguments import Count
from sensorgraph.errors import SensorgraphError, as_sensorgraph_error
from sensorgraph.files import atomic_folder
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import load_arena
from sensorgraph.planning import plan_folder
from sensorgraph.planning.priority import uncertainty
from sensorgraph.planning.resume import driven_poses, other_place_warnings
from sensorgraph.planning.survey import LaserSurvey, survey_of
from sensorgraph.planning.views import views_within
from sensorgraph.quantities import ANGLE, quantity
from sensorgraph.sensor_model_input import numbers_of
from sensorgraph.types import Floats, Progress
from sensorgraph.world.robot import Robot, load_robot


@dataclass(frozen=True, kw_only=True, eq=False)
class CoveragePlan:
    """A planned drive with its arena and robot."""

    drive: planners.Plan
    arena: Arena
    robot: Robot

    @property
    def trajectory(self) -> Trajectory:
        """Stamps (n,) [s], poses (n, 3) [m, m, rad] and twists (n, 2) [m/s, rad/s]."""
        return self.drive.trajectory

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `plan.json` as plain data: coverage, time, clearance, settings."""
        return dict(self.drive.report)

    @as_sensorgraph_error
    def save(self, folder: Path | str) -> Path:
        """Write trajectory, waypoints, MCAP, report and pictures into a folder, completely or not at all."""
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
        """Return an HTML table for notebooks: coverage, time and path length."""
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
    cell: float = CELL,
    headings: int = HEADINGS,
    start: ArrayLike | None = None,
    end: ArrayLike | None = None,
    views: int | None = None,
    no_go: Sequence[Zone] = (),
    resume: Run | Path | str | Sequence[Run | Path | str] | None = None,
    priority: Sensorgraph | Path | str | None = None,
    budget: float | None = None,
    battery: float | None = None,
    dock: ArrayLike | None = None,
    duration: float | None = None,
    order: str | None = None,
    graph: Sensorgraph | Path | str | None = None,
    margin: float = WALL_MARGIN,
    join_planner: str = JOIN_PLANNERS[0],
    seed: Count = 0,
    progress: Progress | None = None,
    status: Callable[[str], None] | None = None,
) -> CoveragePlan:
    """Plan a drive that covers (x, y, phi): every reachable place, in every heading.

    Parameters
    ----------
    arena : An arena, its file, or the name of a shipped one.
    robot : A robot or its robot.yaml; None: the shipped robot.
    planner : `coverage`, `stop_and_spin`, or one of the baselines `random_bounce` and `wall_following`.
    cell : [m] Side of a position cell.
    headings : Number of heading bins of a full turn.
    start, end : (3,) [m, m, rad] Pose of base_link; None: chosen by the planner.
    views : Visit only this number of poses, those that show most surface, instead of covering (x, y, phi).
    no_go : Polygons [m, map] that the robot must not enter; its laser sees through them.
    resume : One or several runs already driven, or their files; their bins need no visit.
    priority : Sensorgraph, or its file; unobserved bins come first, then those with the highest expected error.
    budget : [s] Maximum duration of the drive.
    battery : [s] Maximum duration of one run; all runs start and end at `dock` (3,) [m, m, rad].
    duration : [s] Duration of the baselines; None: the reference time of the coverage planner.
    margin : [m] Minimum distance between the footprint and walls; below 2 mm it is 2 mm.
    join_planner : Name of the OMPL planner that finds paths around obstacles, or your own as `module:Class`.
    order : `fast`, the shortest drive; or `anytime`, where every prefix is as useful as possible. None:
        anytime for a robot that turns in place if a `budget` or a `graph` is given and no `priority`;
        otherwise fast.
    graph : Sensorgraph, or its file, for the order anytime: look first where its expected error is highest.
    seed : The same seed gives the same plan, byte for byte.
    progress : Called with (bins done, total bins).
    status : Called with a short text about the current step and the plan so far.

    Raises
    ------
    SensorgraphError : The robot does not fit, a pose is in a wall, no bin is reachable, or two arguments contradict.
    """
    world = arena if isinstance(arena, Arena) else load_arena(arena)
    machine = robot if isinstance(robot, Robot) else load_robot(robot)
    _check(views, planner, resume)
    start, end, dock = _pose("start", start), _pose("end", end), _pose("dock", dock)
    priority, graph = _opened(priority), _opened(graph)
    targets = None if views is None else partial(
        views_within, n=views, arena=world, sensor=machine.sensor, graph=priority, seed=seed
    )  # fmt: skip
    visited = None if resume is None else _driven(resume, world)
    if order is None:
        has_other_order = priority is not None or views is not None
        order = _default_order(
            planner, machine, is_cut=budget is not None or graph is not None, has_other_order=has_other_order
        )
    drive = planners.plan(
        without(world, no_go), machine, planner=planner if views is None else "views", cell=cell, headings=headings,
        seed=seed, start=start, end=end, dock=dock, budget=budget, battery=battery, duration=duration, margin=margin,
        sweep_time=machine.sensor.scan_duration, rate=machine.sensor.rate, visited=visited, targets=targets,
        priority=None if priority is None or targets is not None else partial(uncertainty, priority),
        order=order, survey=_survey(order, world, machine, graph, visited), join_planner=join_planner, progress=progress,
        status=status,
    )  # fmt: skip
    _add_notes(drive.report, machine, arena, world, (priority, graph), no_go)
    return CoveragePlan(drive=drive, arena=world, robot=machine)


def _default_order(planner: str, machine: Robot, *, is_cut: bool, has_other_order: bool) -> str:
    """Return anytime if the drive may be cut short or has a graph, and nothing else defines its order; otherwise fast."""
    can = planner == "coverage" and machine.drive == "diff" and not has_other_order
    return "anytime" if can and is_cut else "fast"


def laser_outside_footprint(robot: Robot) -> list[str]:
    """Return a warning if a sensor of the robot lies outside its footprint; otherwise nothing."""
    sensor = robot.sensor
    starts = (
        np.column_stack([sensor.origins, np.zeros(sensor.n_rays)])
        if sensor.is_composite
        else np.zeros((1, 3))
    )
    x, y, _ = compose(sensor.mount, starts).T
    far = float(np.hypot(x, y).max())
    if far <= robot.footprint_radius:
        return []
    return [
        f"a sensor is {far:.2f} m from the centre of the robot, outside its footprint_radius of "
        f"{robot.footprint_radius:.2f} m; it may touch or pass walls. Increase footprint_radius"
    ]


def _add_notes(
    report: dict[str, Any],
    robot: Robot,
    arena: Arena | Path | str,
    world: Arena,
    graphs: Sequence[Sensorgraph | None],
    no_go: Sequence[Zone],
) -> None:
    """Add to plan.json what the planner does not know: name of the arena, warnings about sensors and graphs, and zones."""
    report["warnings"] += laser_outside_footprint(robot)
    if not isinstance(arena, Arena):
        report["arena"] = Path(arena).name
    for known in filter(None, graphs):
        report["warnings"] += other_place_warnings(known, world)
    if no_go:
        report["no_go"] = [[list(corner) for corner in zone.exterior.coords[:-1]] for zone in no_go]


def _survey(
    order: str, world: Arena, machine: Robot, graph: Sensorgraph | None, visited: Floats | None
) -> LaserSurvey | None:
    """Return the survey for the order anytime: unobserved space, weighted by the expected error of a graph if given.

    Poses already driven count as observed. Otherwise rays that a graph cannot learn, such as those grazing
    edges, would attract every run to the same places.
    """
    if order != "anytime":
        if graph is not None:
            raise PlanError(
                "`graph` requires the order anytime; use `order` anytime, or give the graph as `priority`"
            )
        return None
    survey = survey_of(world, machine.sensor, graph)
    if visited is not None:
        survey.mark(visited)
    return survey


def _opened(graph: Sensorgraph | Path | str | None) -> Sensorgraph | None:
    return Sensorgraph.load(graph) if isinstance(graph, Path | str) else graph


def _pose(name: str, pose: ArrayLike | None) -> Floats | None:
    """Return a pose as numbers; headings of more than a full turn, as degrees are, are rejected."""
    if pose is None:
        return None
    numbers = numbers_of(pose, name)
    if numbers.shape == (3,):
        quantity(float(numbers[2]), f"`{name}`: phi", ANGLE)
    return numbers


def _check(views: int | None, planner: str, resume: object | None) -> None:
    """Reject arguments that contradict a plan of views."""
    if views is None:
        if planner == "views":
            raise PlanError("the planner views needs the number of poses; give `views`")
        return
    if planner not in ("coverage", "views"):
        raise PlanError(f"`views` excludes `planner` {planner}; leave out one of them")
    if resume is not None:
        raise PlanError(
            "`views` excludes `resume`; build a sensorgraph from that run, and give it as `priority`"
        )


def _driven(resume: Run | Path | str | Sequence[Run | Path | str], arena: Arena) -> Floats:
    """Return the poses (n, 3) [m, m, rad] of runs already driven."""
    if isinstance(resume, Run):
        return driven_poses(resume, arena)
    if isinstance(resume, Path | str):
        return driven_poses(logs.read(resume), arena, name=str(resume))
    return np.concatenate([_driven(run, arena) for run in resume])
