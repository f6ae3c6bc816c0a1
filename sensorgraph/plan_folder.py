"""A plan's folder: trajectory.csv, waypoints.yaml, plan.mcap, plan.json, plan.png."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from logs.plan_file import write_plan
from logs.run import OccupancyMap
from planners import Plan
from planners.arena import Arena, Floats
from planners.coverage import Coverage
from planners.export import waypoints
from planners.maps import geojson
from sensorgraph import figures
from sensorgraph.files import whole
from sensorgraph.world.robot_file import RobotFile
from sensorgraph.world.simulate import EPOCH_NS, occupancy


def save(plan: Plan, folder: Path, arena: Arena, robot: RobotFile) -> None:
    """Write a plan into a folder, with the arena and the robot that made it; each file is whole or not there."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = {"arena.geojson": geojson.dumps(arena), "robot.yaml": robot.text}
    plan.trajectory.write_csv(folder / "trajectory.csv")
    write_plan(
        folder / "plan.mcap",
        plan.trajectory.stamps,
        plan.trajectory.poses,
        epoch_ns=EPOCH_NS,
        coverage=coverage_map(plan.coverage),
        occupancy=occupancy(arena),
        attachments={name: text.encode() for name, text in kept.items()},
    )
    figures.plan_picture(plan, arena, folder / "plan.png")
    texts = kept | {"waypoints.yaml": waypoints(plan), "plan.json": json.dumps(plan.report, indent=1) + "\n"}
    for name, text in texts.items():
        with whole(folder / name) as part:
            part.write_text(text, encoding="utf-8")


def coverage_map(coverage: Coverage) -> OccupancyMap:
    """Return the share of the reachable headings visited in each cell, 0 to 100; -1 where none is reachable."""
    reachable = coverage.reachable.sum(axis=2)
    share = 100 * coverage.covered.sum(axis=2) / np.maximum(reachable, 1)
    data = np.where(reachable > 0, np.floor(share), -1).astype(np.int8).T
    return OccupancyMap(data=data, resolution=coverage.cell, origin=np.array([*coverage.origin, 0.0]))


def counted(coverage: Coverage, poses: Floats) -> Coverage:
    """Count logged poses (n, 3) alone, on the grid of a plan."""
    fresh = Coverage.empty(
        origin=coverage.origin,
        cell=coverage.cell,
        cells=np.asarray(coverage.reachable.any(axis=2)),
        headings=coverage.headings,
    )
    fresh.add(poses)
    return fresh
