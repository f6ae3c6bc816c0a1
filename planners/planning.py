"""plan(): from an arena and a vehicle to a trajectory through the (x, y, phi) bins, checked and measured."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from planners import holes
from planners.arena import Arena
from planners.arguments import DriveEnds, check_join_planner, check_numbers, check_planner
from planners.battery import Session, battery_sessions, chain_sessions, check_battery
from planners.bound import lower_bound
from planners.cars.reachability import best_start, returnable_set
from planners.clearance import Barriers
from planners.coverage import CELL, HEADINGS, Coverage
from planners.curve import Curve
from planners.errors import PlanError
from planners.interrupt import defer_interrupt
from planners.joins.ompl_process import CLEARANCE_SLACK, JOIN_PLANNERS
from planners.methods import baselines
from planners.methods.coverage import plan_coverage
from planners.methods.stop_and_spin import plan_stop_and_spin
from planners.methods.views import plan_views
from planners.reach import MIN_SHARE, Reach, ReturnableSet, reach
from planners.report import plan_report, reference_time, session_report
from planners.sections import check_pose, end_poses, fit_to_budget
from planners.task import JoinCounts, PlannedDrive, Survey, Task
from planners.trajectory import Trajectory
from planners.types import Bools, Floats, Progress, Status
from planners.vehicle import Vehicle

PLANNERS: dict[str, Callable[[Task], PlannedDrive]] = {
    "coverage": plan_coverage,
    "random_bounce": baselines.random_bounce,
    "wall_following": baselines.wall_following,
    "views": plan_views,
    "stop_and_spin": plan_stop_and_spin,
}

FRAME = "planners.ompl_frame"
"""Module that is imported when a drive is planned; everything else works without OMPL."""
WALL_MARGIN = 0.02
"""[m] distance of the robot's rim from walls, added to its radius."""
MIN_DUBINS_SHARE = 0.05
"""Minimum share of the bins that a Dubins car must cover from its start; other starts are rejected."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """A drive and its coverage."""

    trajectory: Trajectory
    curve: Curve
    """The same drive in closed form, which can be sampled at any stamp."""
    coverage: Coverage
    """Coverage by a log at `rate`, including earlier runs."""
    reach: Reach
    joins: JoinCounts
    stops: Floats
    """(n, 4) [m, m, rad, rad] x, y, phi on arrival, and the angle turned there."""
    lost: Bools
    """(nx, ny, n_phi) bins to which no path was found."""
    report: dict[str, Any]
    """The content of plan.json."""
    sessions: tuple[Session, ...] = ()
    """The battery runs of the drive; empty without a battery."""

    def growth(self, n: int = 400) -> tuple[Floats, Floats]:
        """Return stamps (n,) [s] and the share (n,) of reachable bins covered by each stamp."""
        rate = self.report["rate"]
        poses = self.curve.log(rate)
        stamps, share = self.coverage.growth(np.arange(len(poses)) / rate, poses, n)
        return stamps, np.asarray(share + self.report["coverage"] - share[-1], dtype=np.float64)


def plan(
    arena: Arena,
    vehicle: Vehicle,
    *,
    planner: str = "coverage",
    cell: float = CELL,
    headings: int = HEADINGS,
    seed: int = 0,
    start: Floats | None = None,
    rate: float = 10.0,
    margin: float = WALL_MARGIN,
    priority: Floats | Callable[[Coverage], Floats] | None = None,
    visited: Floats | None = None,
    targets: Floats | Callable[[Reach], Floats] | None = None,
    duration: float | None = None,
    end: Floats | None = None,
    budget: float | None = None,
    battery: float | None = None,
    dock: Floats | None = None,
    sweep_time: float = 0.0,
    order: str = "fast",
    survey: Survey | None = None,
    join_planner: str = JOIN_PLANNERS[0],
    progress: Progress | None = None,
    status: Status | None = None,
) -> Plan:
    """Plan a drive through every reachable (x, y, phi) bin, as an OMPL problem (`planners.ompl_frame`).

    Parameters
    ----------
    planner : One of PLANNERS.
    cell : [m] Side of a position cell; `headings`: number of heading bins.
    start : (3,) [m, m, rad] Start pose; None: chosen by the planner in the largest part of the arena.
    rate : [Hz] Rate of the log; a bin is covered when a logged pose falls in it.
    margin : [m] Distance of the robot's rim from walls, at least 2 mm; the report gives its cost in reachable bins.
    priority : (nx, ny, n_phi) Higher comes earlier; or a function that computes it from the empty grid.
    visited : (n, 3) [m, m, rad] Poses of earlier runs, whose bins are already covered.
    targets : (n, 3) [m, m, rad] Poses to visit, for the planner `views`; or a function that chooses them
    within reach.
    duration : [s] Duration of a baseline; default: the reference time of the coverage planner.
    end : (3,) [m, m, rad] End pose; None: the pose in the last bin.
    budget : [s] Maximum duration of the drive; bins beyond it are left out.
    battery : [s] Duration of one run; the drive is cut into runs that start and end at `dock` (3,).
    dock : (3,) [m, m, rad] Start and end of battery runs; None: the start.
    sweep_time : [s] Duration of one scan, for the warning about motion smear.
    order : One of ORDERS, for the planner `coverage`: the shortest drive, or one with valuable prefixes.
    survey : What the sensor has seen, for the order `anytime`; None: coarse coverage comes first.
    join_planner : OMPL planner of paths around obstacles: one of JOIN_PLANNERS, or module:Class.
    progress : Called with (bins done, total bins) during the search.
    status : Called with a text on the current step and the quality of the plan so far.

    Raises
    ------
    PlanError : OMPL is not installed, an argument is invalid, or the robot fits nowhere. All bins are covered
    already. A pose is out of reach, or the budget or the battery is too small.
    KeyboardInterrupt : Ctrl-C came before any drive was found; later, Ctrl-C returns the plan so far.
    """
    began = time.perf_counter()
    check_planner(
        planner, PLANNERS, order, vehicle, has_duration=duration is not None, has_targets=targets is not None
    )
    check_numbers(cell=cell, rate=rate, headings=headings, seed=seed, margin=margin, duration=duration)
    ends = DriveEnds.of(start=start, end=end, dock=dock, budget=budget, battery=battery)
    task = _task(
        arena, vehicle, ends, cell=cell, headings=headings, seed=seed, rate=rate, margin=margin, visited=visited,
        join_planner=check_join_planner(join_planner),
    )  # fmt: skip
    task = replace(
        task, priority=_priority(priority, task.coverage), targets=targets(task.reach) if callable(targets) else targets,
        duration=task.duration if duration is None else duration, order=order, survey=survey, progress=progress,
        status=status,
    )  # fmt: skip
    drive = import_module(FRAME).drive_in_frame(task, PLANNERS[planner], planner)
    made, interrupted = defer_interrupt(partial(_finish, drive, task, planner, ends, sweep_time))
    if interrupted:
        made.report["interrupted"] = True
    made.report["planning_s"] = round(time.perf_counter() - began, 3)
    return made


def _task(
    arena: Arena,
    vehicle: Vehicle,
    ends: DriveEnds,
    *,
    cell: float,
    headings: int,
    seed: int,
    rate: float,
    margin: float,
    visited: Floats | None,
    join_planner: str,
) -> Task:
    """Return the task of covering the reachable bins that earlier runs have not visited."""
    start = ends.start
    free, barriers = _reachable_floor(
        arena, vehicle, cell, margin, start, "dock" if ends.is_dock else "start"
    )
    free = replace(free, join_planner=join_planner)
    grid = _empty_grid(free, headings)
    returnable: ReturnableSet | None = None
    if vehicle.drive == "dubins":
        start, returnable = _dubins_start(free, vehicle, grid, rate, start, seed)
        grid = replace(grid, reachable=grid.reachable & returnable.bins)
    if visited is not None:
        grid.add(np.asarray(visited, dtype=np.float64).reshape(-1, 3))
    if ends.end is not None:
        check_pose("end", ends.end, arena, barriers, free)
    task = Task(
        arena=arena,
        vehicle=vehicle,
        barriers=barriers,
        reach=free,
        coverage=grid,
        start=start,
        seed=seed,
        rate=rate,
        priority=None,
        duration=reference_time(grid, vehicle),
        progress=None,
        returnable=returnable,
        budget=ends.budget,
    )
    if ends.battery is not None and start is not None:
        check_battery(task, ends.battery, start)
    return task


def _priority(priority: Floats | Callable[[Coverage], Floats] | None, grid: Coverage) -> Floats | None:
    """Return the priority of each bin; a function is evaluated on the empty grid."""
    if callable(priority):
        empty = replace(grid, counts=np.zeros_like(grid.counts), core=np.zeros_like(grid.core))
        priority = priority(empty)
    if priority is not None and np.shape(priority) != grid.counts.shape:
        raise PlanError(f"priority has shape {np.shape(priority)}, expected {grid.counts.shape}")
    return priority


def _empty_grid(free: Reach, headings: int) -> Coverage:
    """Return the grid of reachable bins, without poses."""
    grid = Coverage.empty(origin=free.origin, cell=free.cell, cells=free.cells(), headings=headings)
    if not grid.reachable.any():
        raise PlanError(
            f"no {free.cell} m cell has {100 * MIN_SHARE:.0f} % of its area within reach; use a smaller cell"
        )
    return grid


def _reachable_floor(
    arena: Arena, vehicle: Vehicle, cell: float, margin: float, start: Floats | None, name: str
) -> tuple[Reach, Barriers]:
    """Return the reachable places of the vehicle, and the barriers it must avoid.

    Searches and joins keep the clearance up to `CLEARANCE_SLACK`, as distances are interpolated between nodes. So a smaller
    margin counts as this slack, and the robot touches no wall.
    """
    x0, y0, x1, y1 = arena.bounds
    if cell > max(x1 - x0, y1 - y0):
        raise PlanError(f"cell is {cell:g} m, larger than the whole arena; expected metres, such as 0.25")
    barriers = Barriers(arena)
    free = reach(
        arena,
        barriers,
        clearance=vehicle.footprint_radius + max(margin, CLEARANCE_SLACK),
        cell=float(cell),
        start=start,
        name=name,
    )
    return free, barriers


def _finish(drive: PlannedDrive, task: Task, planner: str, ends: DriveEnds, sweep_time: float) -> Plan:
    """Fit a drive into the budget or the battery, and measure it."""
    grid, rate = task.coverage, task.rate
    end, budget, battery = ends.end, ends.budget, ends.battery
    covered_before = grid.covered
    task.show_status("checking the drive")
    lost = np.zeros_like(grid.reachable) if drive.lost is None else drive.lost
    before, runs, ended = grid.fraction, list[Session](), dict[str, Any]()
    if battery is None:
        drive = fit_to_budget(drive, task, budget=budget, end=end)
        grid.add(drive.curve.log(rate))
    else:
        home = end_poses(drive.curve)[0] if task.start is None else task.start
        runs = battery_sessions(drive, task, battery=battery, dock=home)
        drive = chain_sessions(runs, drive)
        so_far = [session_report(grid, run, rate) for run in runs]
        ended = {"battery_s": battery, "dock": home.tolist(), "sessions": so_far}
    trajectory = drive.curve.trajectory()
    report = plan_report(task, drive, trajectory, planner, sweep_time) | {
        **({"interrupted": True} if drive.interrupted else {}),
        **({} if budget is None else {"budget_s": budget}),
        **({} if task.order == "fast" else {"order": task.order}),
        **({} if task.reach.join_planner == JOIN_PLANNERS[0] else {"join_planner": task.reach.join_planner}),
        **({} if end is None else {"end": end.tolist()}),
        **ended,
        **({} if task.targets is None else {"views": task.targets.round(6).tolist()}),
        "unreached": holes.count_unmet(grid, task.reach, lost),
        "coverage_before": before,
        "margin_m": round(task.reach.clearance - task.vehicle.footprint_radius, 6),
        "share_of_bare_footprint": _share_of_bare_footprint(task),
        "lower_bound_s": lower_bound(
            grid.covered & ~covered_before, task.vehicle, grid.cell, rate, drive.curve.duration
        ),
    }
    return Plan(
        trajectory=trajectory,
        curve=drive.curve,
        coverage=grid,
        reach=task.reach,
        joins=drive.joins,
        stops=drive.stops,
        lost=lost,
        report=report,
        sessions=tuple(runs),
    )


def _share_of_bare_footprint(task: Task) -> float:
    """Return the share of the cells in reach without a margin that the margin leaves."""
    bare = task.reach.with_clearance(task.vehicle.footprint_radius).cells()
    return float((task.reach.cells() & bare).sum() / max(int(bare.sum()), 1))


def _dubins_start(
    free: Reach, vehicle: Vehicle, grid: Coverage, rate: float, start: Floats | None, seed: int
) -> tuple[Floats, ReturnableSet]:
    """Return the start pose of a Dubins car, and the bins it can reach from there and return from."""
    limits, headings = vehicle.limits, grid.headings
    if start is None:
        start, found = best_start(free, limits, headings, rate, seed)
    else:
        found = returnable_set(free, limits, headings, rate, start)
    reachable = grid.reachable & found.bins
    if reachable.sum() < MIN_DUBINS_SHARE * grid.reachable.sum():
        better, _ = best_start(free, limits, headings, rate, seed)
        raise PlanError(
            f"from ({start[0]:.2f}, {start[1]:.2f}, {start[2]:.2f}) the car can reach and return from only "
            f"{int(reachable.sum()):,} of {int(grid.reachable.sum()):,} bins; "
            f"start at {better[0]:.2f},{better[1]:.2f},{better[2]:.2f}"
        )
    return start, found
