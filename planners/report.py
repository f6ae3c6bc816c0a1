"""The content of plan.json: coverage, time relative to the reference time, constraint checks, and warnings.

`sampling_warnings` are for a drive that is too fast for its log: poses per bin, and motion during a scan. `steering_warnings`
are for a car that steers too slowly for its arcs.
"""

from __future__ import annotations

import logging
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from planners import holes
from planners.battery import Session
from planners.check import check_parts
from planners.coverage import Coverage
from planners.curve import RATE
from planners.task import PlannedDrive, Task
from planners.trajectory import Trajectory
from planners.vehicle import Vehicle

logger = logging.getLogger(__name__)

CHECK_RATE = 2 * RATE
"""[Hz] rate of the checked samples: between those that are exported, too."""
WARN_BELOW = 0.99
"""A warning is given if the start reaches a smaller share of the places where the robot fits."""


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
    if task.reach.share < WARN_BELOW:
        lines.append(holes.small_reach_warning(task.reach))
    if driven.interrupted:
        lines.append(f"planning was interrupted: this plan is shorter and covers {100 * grid.fraction:.1f} %")
    lines += sampling_warnings(
        trajectory, cell=grid.cell, headings=grid.headings, rate=task.rate, sweep_time=sweep_time
    )
    lines += steering_warnings(trajectory, vehicle, task.reach.clearance - vehicle.footprint_radius)
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


MIN_POSES = 2.0
"""Logged poses per passage through a bin, below which a warning is given: one lost scan would lose the bin."""


def sampling_warnings(
    trajectory: Trajectory, *, cell: float, headings: int, rate: float, sweep_time: float = 0.0
) -> list[str]:
    """Return one line for each limit that the drive exceeds.

    Parameters
    ----------
    cell : [m] Side of a cell.
    rate : [Hz] Rate of the log.
    sweep_time : [s] Duration of one scan.
    """
    twists = trajectory.twists
    v, omega = np.maximum(twists.max(axis=0), -twists.min(axis=0)).tolist()
    width, few, swept = 2 * np.pi / headings, list[str](), list[str]()
    cells, bins = f"a cell of {cell:g} m", f"a heading bin of {np.degrees(width):.3g}°"
    moves = f"drives {sweep_time * v:.2g} m", f"turns {np.degrees(sweep_time * omega):.3g}°"
    for speed, unit, size, where, what, how in (
        (v, "m/s", cell, cells, moves[0], ("drive", "use larger cells")),
        (omega, "rad/s", width, bins, moves[1], ("turn", "use fewer headings")),
    ):
        if speed > 0 and size * rate / speed < MIN_POSES:
            few.append(
                f"at {speed:.2f} {unit} a log of {rate:g} Hz has {_down(size * rate / speed)} poses in {where}; for "
                f"{MIN_POSES:g}, log at {_up(MIN_POSES * speed / size)} Hz or more, {how[0]} at "
                f"{_down(size * rate / MIN_POSES)} {unit} or less, or {how[1]}"
            )
        if sweep_time * speed > size / 2:
            swept.append(
                f"at {speed:.2f} {unit} the robot {what} while a scan of {sweep_time:g} s is measured, more than half "
                f"{where}; {how[0]} at {_down(size / 2 / sweep_time)} {unit} or less, or {how[1]}"
            )
    return [*few, *swept]


def steering_warnings(trajectory: Trajectory, vehicle: Vehicle, margin: float) -> list[str]:
    """Return a line if a car that keeps `limits.alpha` leaves its path by more than the margin [m] where two arcs meet.

    The turn rate of the path jumps by d at speed v. A car that changes its own at alpha needs T = d / alpha, and is then
    v (d T² / 2 - alpha T³ / 6) = v d³ / (3 alpha²) aside.
    """
    if vehicle.drive == "diff" or len(trajectory.stamps) < 2:
        return []
    v, omega = trajectory.twists.T
    alpha, jump = vehicle.limits.alpha, abs(np.diff(omega))
    speed = np.minimum(abs(v[1:]), abs(v[:-1]))
    aside = speed * jump**3 / (3 * alpha**2)
    k = int(aside.argmax())
    if aside[k] <= margin:
        return []
    return [
        f"where arcs meet, the turn rate jumps by up to {jump[k]:.2g} rad/s at {speed[k]:.2g} m/s; with limits.alpha of "
        f"{alpha:g} rad/s² the car is then about {aside[k]:.2g} m off its path, more than the margin of {margin:.2g} m; "
        "lower limits.v, or enlarge the margin"
    ]


def _up(value: float) -> str:
    """Round up to two digits, so that following the advice suffices."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.ceil(value / digit - 1e-9) * digit:.3g}"


def _down(value: float) -> str:
    """Round down to two digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / digit + 1e-9) * digit:.3g}"
