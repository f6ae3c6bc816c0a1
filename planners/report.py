"""The content of plan.json: coverage, time relative to the reference time, constraint checks, and warnings."""

from __future__ import annotations

import logging
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from planners import holes
from planners.battery import Session
from planners.check import check_parts
from planners.coverage import Coverage
from planners.sampling import sampling_warnings
from planners.settings import STARTS
from planners.task import PlannedDrive, Task
from planners.trajectory import Trajectory
from planners.vehicle import Vehicle

logger = logging.getLogger(__name__)

CHECK_RATE = 100.0
"""[Hz] rate of the checked samples."""


def reference_time(grid: Coverage, vehicle: Vehicle) -> float:
    """Return the reference time [s]: a lower estimate of the time to visit all bin centres, without accelerations.

    In each cell the robot either enters once and turns to all other headings, or drives through at each
    heading. A car drives through each bin, or along an arc from one heading bin to the next.
    """
    k, limits = grid.headings, vehicle.limits
    if vehicle.drive != "diff":
        todo_bins = int((grid.reachable & (grid.counts == 0)).sum())
        return float(todo_bins * min(grid.cell, limits.turning_radius * 2 * np.pi / k) / limits.v)
    hop = grid.cell / limits.v
    todo = (grid.reachable & (grid.counts == 0)).any(axis=2)
    return float(todo.sum() * min((k - 1) * 2 * np.pi / k / limits.omega + hop, k * hop))


def session_report(grid: Coverage, run: Session, rate: float) -> dict[str, Any]:
    """Add a run's log to the grid and return its entry of plan.json."""
    curve, before = run.driven.curve, int(grid.covered.sum())
    grid.add(curve.log(rate))
    return {
        "drive_time_s": round(curve.duration, 6),
        "out_s": round(run.out_s, 6),
        "home_s": round(run.home_s, 6),
        "path_m": curve.trajectory().length,
        "new_bins": int(grid.covered.sum()) - before,
        "coverage": grid.fraction,
    }


def plan_report(
    task: Task, driven: PlannedDrive, trajectory: Trajectory, planner: str, sweep_time: float
) -> dict[str, Any]:
    """Return the content of plan.json; `task.coverage` already includes the log of the drive."""
    grid, vehicle = task.coverage, task.vehicle
    none = np.zeros_like(grid.counts)
    empty = Coverage(origin=grid.origin, cell=grid.cell, reachable=grid.reachable, counts=none, core=none)
    reference = reference_time(empty, vehicle)
    found = check_parts(driven.curve.parts(CHECK_RATE), task.arena, vehicle)
    gap_m, gap_rad = grid.dispersion()
    start = trajectory.poses[0]
    lines = []
    if task.reach.share < STARTS.warn_below:
        lines.append(holes.small_reach_warning(task.reach))
    if driven.interrupted:
        lines.append(f"planning was interrupted: this plan is shorter and covers {100 * grid.fraction:.1f} %")
    lines += sampling_warnings(
        trajectory, cell=grid.cell, headings=grid.headings, rate=task.rate, sweep_time=sweep_time
    )
    for line in lines:
        logger.warning("%s", line)
    return {
        "grid": {"origin": grid.origin.tolist(), "cell": grid.cell, "headings": grid.headings},
        "start": [round(float(value), 6) for value in start],
        "coverage": grid.fraction,
        "core_coverage": grid.core_fraction,
        "reachable_cells": int(grid.reachable.sum()),
        "covered_cells": int(grid.covered.sum()),
        "reachable_positions": int(grid.reachable.any(axis=2).sum()),
        "drive_time_s": round(trajectory.duration, 6),
        "t_ref_s": reference,
        "ratio": trajectory.duration / reference,
        "path_m": trajectory.length,
        "planning_s": 0.0,
        "seed": task.seed,
        "min_clearance_m": found.min_clearance,
        "limit_violations": found.count,
        "joins": {
            "direct": driven.joins.direct,
            "planned": driven.joins.planned,
            "failed": driven.joins.failed,
            "planned_m": driven.joins.planned_m,
            "flooded": driven.joins.by_wavefront,
        },
        "violations": dict(found.violations),
        "turned_rad": float(abs(driven.stops[:, 3]).sum()),
        "stops": len(driven.stops),
        "largest_gap": {"m": _finite(gap_m), "rad": _finite(gap_rad)},
        "warnings": lines,
        "planner": planner,
        "robot": vehicle.to_dict(),
        "rate": task.rate,
        "clearance": task.reach.clearance,
        "versions": {name: _version(name) for name in ("ompl", "numpy", "scipy", "shapely")},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
