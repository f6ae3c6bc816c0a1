"""Folder of a plan, with a subfolder for each run of a battery.

Files for driving are trajectory.csv, cmd_vel.csv, waypoints.yaml and plan.mcap. Files with results are
plan.json and holes.csv; pictures are plan.png, headings.png and reach.png.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from logs.files import atomic_file
from logs.plan_file import write_plan
from logs.run import OccupancyMap
from planners import Plan
from planners.arena import Arena
from planners.coverage import Coverage
from planners.curve import Curve
from planners.export import commands_csv, stops_yaml
from planners.holes import holes_csv
from sensorgraph.files import write_timing
from sensorgraph.loading import attachments_of
from sensorgraph.show.figures.headings import headings_picture
from sensorgraph.show.figures.plan import plan_picture, reach_picture
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot
from sensorgraph.world.simulate import EPOCH_NS, occupancy_map

RUN_FILES = ("trajectory.csv", "cmd_vel.csv", "waypoints.yaml", "plan.mcap", "plan.json")


def save(plan: Plan, folder: Path, arena: Arena, robot: Robot) -> None:
    """Write a plan with its arena and robot into a folder; each file is written completely or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    attached = attachments_of(arena, robot)
    grid = coverage_map(plan.coverage)
    _save_drive(folder, plan.curve, plan.stops, grid, occupancy_map(arena), attached)
    plan_picture(plan, arena, folder / "plan.png")
    reach_picture(plan, arena, folder / "reach.png")
    headings_picture(plan, arena, folder / "headings.png")
    left_out = holes_csv(plan.coverage, plan.reach, plan.lost)
    repeated = plan.report | {"planning_s": 0.0}  # the key is documented; the time is in timing.json
    _write(folder, attached | {"holes.csv": left_out.encode(), "plan.json": _json(repeated)})
    write_timing(folder, {"planning_s": plan.report["planning_s"]})
    logged = np.zeros((0, 3))
    for number, run in enumerate(plan.sessions):
        own = folder / f"run_{number + 1}"
        own.mkdir()
        logged = np.concatenate([logged, run.driven.curve.log(plan.report["rate"])])
        so_far = coverage_map(counted(plan.coverage, logged))
        _save_drive(own, run.driven.curve, run.driven.stops, so_far, occupancy_map(arena), attached)
        _write(own, {"plan.json": _json(_report_of_run(plan, number))})


def drop_runs(folder: Path) -> None:
    """Remove the runs of an older plan from a folder."""
    for run in folder.glob("run_[0-9]*"):
        for name in RUN_FILES:
            (run / name).unlink(missing_ok=True)
        if run.is_dir() and not any(run.iterdir()):
            run.rmdir()


def _save_drive(
    folder: Path,
    curve: Curve,
    stops: Floats,
    grid: OccupancyMap,
    world: OccupancyMap,
    attached: dict[str, bytes],
) -> None:
    """Write the files for driving: trajectory, commands, waypoints, and an MCAP with path and grids for viewers."""
    trajectory = curve.trajectory()
    trajectory.write_csv(folder / "trajectory.csv")
    write_plan(
        folder / "plan.mcap",
        trajectory.stamps,
        trajectory.poses,
        epoch_ns=EPOCH_NS,
        coverage=grid,
        occupancy=world,
        attachments=attached,
    )
    _write(
        folder,
        {
            "waypoints.yaml": stops_yaml(curve, stops, trajectory.poses[-1]).encode(),
            "cmd_vel.csv": commands_csv(curve).encode(),
        },
    )


def _write(folder: Path, files: dict[str, bytes]) -> None:
    for name, content in files.items():
        with atomic_file(folder / name) as part:
            part.write_bytes(content)


def _json(report: dict[str, Any]) -> bytes:
    return (json.dumps(report, indent=1) + "\n").encode()


def _report_of_run(plan: Plan, number: int) -> dict[str, Any]:
    """Return plan.json of one run: its own measures, and those shared with the whole plan."""
    shared = ("grid", "seed", "planner", "robot", "rate", "clearance", "reachable_cells", "dock", "warnings")
    run = plan.report["sessions"][number]
    covered = round(run["coverage"] * plan.report["reachable_cells"])
    return {key: plan.report[key] for key in shared} | {
        "start": plan.report["dock"],
        "run": number + 1,
        "of": len(plan.sessions),
        "covered_cells": covered,
        **run,
    }


def coverage_map(coverage: Coverage) -> OccupancyMap:
    """Return the share of the reachable headings visited in each cell, 0 to 100; -1 without a reachable heading."""
    reachable = coverage.reachable.sum(axis=2)
    share = 100 * coverage.covered.sum(axis=2) / np.maximum(reachable, 1)
    data = np.where(reachable > 0, np.floor(share), -1).astype(np.int8).T
    return OccupancyMap(data=data, resolution=coverage.cell, origin=np.array([*coverage.origin, 0.0]))


def counted(coverage: Coverage, poses: Floats) -> Coverage:
    """Return the coverage of logged poses (n, 3) alone, on the grid of a plan."""
    fresh = Coverage.empty(
        origin=coverage.origin,
        cell=coverage.cell,
        cells=np.asarray(coverage.reachable.any(axis=2)),
        headings=coverage.headings,
    )
    fresh.add(poses)
    return fresh
