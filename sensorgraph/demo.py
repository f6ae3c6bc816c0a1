"""Run the whole loop on an arena: plan, record, build, evaluate, review; compare planned and random driving."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import logs
from logs.run import Run
from planners import Plan
from planners import plan as make_plan
from planners.arena import Arena
from planners.coverage import Coverage
from planners.maps import geojson
from sensorgraph.building.build import build
from sensorgraph.demo_effect import HiddenEffect, hide_and_find
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.other_process import OtherProcess
from sensorgraph.planning.plan_folder import counted, save
from sensorgraph.recording.record import record
from sensorgraph.show.figures.drives import race_picture
from sensorgraph.show.review.review import review
from sensorgraph.types import Floats, ProgressBars
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot
from sensorgraph.world.scene import apply_range_limits
from sensorgraph.world.simulate import EPOCH_NS, occupancy_map
from sensorgraph.world.wall_distance import WallDistance

N_CHECK_POSES = 1000
BASELINE = "polynomial"
"""Model that is compared with the faces: the form of 2004."""
MARGIN = 0.02
"""[m] Distance between checked poses and walls in addition to the robot's radius."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoDrive:
    """One drive with the model fitted to it, and the errors of its predictions."""

    planner: str
    model: str
    drive_time: float
    """[s] Driving time."""
    coverage: Coverage
    """Coverage by the poses of the scans in the log."""
    growth: tuple[Floats, Floats]
    """Stamps (n,) [s] and share (n,) of the reachable bins visited by then."""
    graph: Sensorgraph
    checked: Evaluation
    """Evaluation at poses spread evenly over the arena, independent of all runs."""


def demo(
    folder: Path, arena: Arena, robot: Robot, *, seed: int, progress: ProgressBars
) -> tuple[list[DemoDrive], HiddenEffect]:
    """Run the loop; write plan, runs, graphs, review and diagnosis to `folder`.

    The random drive and the hidden effect run in other processes, because they are independent of the planned run.

    Returns
    -------
    The planned drive, the random drive, and the planned drive with the model of 2004; and the hidden effect.
    """
    check = check_run(arena, robot, np.random.default_rng([seed, 99]))
    logs.write(check, folder / "check.mcap", occupancy=occupancy_map(arena))
    with OtherProcess(hide_and_find, folder / "diagnosis", arena, robot, seed) as hiding:
        plan = _plan(arena, robot, "coverage", None, seed, progress)
        duration = plan.trajectory.duration
        with OtherProcess(_random_drive, folder, arena, robot, seed, duration, check) as driving:
            run = record(
                folder / "coverage.mcap", arena, robot, plan.trajectory, seed=seed, progress=progress
            )
            planned = _modelled(folder, "coverage", plan, run, arena, check, progress)
            save(plan, folder / "plan", arena, robot)
            review(
                run,
                path=folder / "review.rrd",
                graph=planned.graph,
                plan=folder / "plan",
                arena=arena,
                name="coverage.mcap",
            )
            plain = build([run], arena=arena, model=BASELINE, names=["coverage.mcap"], progress=progress)
            plain.save(folder / f"coverage.{BASELINE}.sensorgraph")
            random = driving.result(progress)
        hidden = hiding.result(progress)
    drives = [planned, random, replace(planned, model=BASELINE, graph=plain, checked=evaluate(plain, check))]
    races = {
        label: (drive.growth[0] / 60, drive.growth[1], drive.coverage)
        for label, drive in zip(("planned", "random"), drives[:2], strict=True)
    }
    race_picture(races, arena, folder / "coverage.png")
    return drives, hidden


def _random_drive(
    folder: Path,
    arena: Arena,
    robot: Robot,
    seed: int,
    duration: float,
    check: Run,
    *,
    progress: ProgressBars,
) -> DemoDrive:
    """Drive at random for the duration of the plan."""
    plan = _plan(arena, robot, "random_bounce", duration, seed, progress)
    path = folder / "random_bounce.mcap"
    run = record(path, arena, robot, plan.trajectory, seed=seed, progress=progress)
    return _modelled(folder, "random_bounce", plan, run, arena, check, progress)


def _modelled(
    folder: Path, planner: str, planned: Plan, run: Run, arena: Arena, check: Run, progress: ProgressBars
) -> DemoDrive:
    """Build a sensorgraph from the run of a plan, and evaluate it."""
    graph = build([run], arena=arena, names=[f"{planner}.mcap"], progress=progress)
    graph.save(folder / f"{planner}.sensorgraph")
    poses = logs.pair(run).poses
    coverage = counted(planned.coverage, poses)
    return DemoDrive(
        planner=planner,
        model=graph.model.name,
        drive_time=planned.trajectory.duration,
        coverage=coverage,
        growth=coverage.growth(run.stamps, poses),
        graph=graph,
        checked=evaluate(graph, check),
    )


def _plan(
    arena: Arena, robot: Robot, planner: str, duration: float | None, seed: int, progress: ProgressBars
) -> Plan:
    """Plan a drive with one planner."""
    with progress(f"plan {planner}", "cells") as tick:
        return make_plan(
            arena,
            robot,
            planner=planner,
            seed=seed,
            rate=robot.sensor.rate,
            duration=duration,
            progress=tick,
        )


def check_run(
    arena: Arena, robot: Robot, rng: np.random.Generator, n: int = N_CHECK_POSES, poses: Floats | None = None
) -> Run:
    """Simulate scans at `poses` (n, 3), or at n poses spread evenly over the free space and all headings."""
    x0, y0, x1, y1 = arena.bounds
    clearance = WallDistance(arena)
    n, poses = (n, np.zeros((0, 3))) if poses is None else (len(poses), poses)
    while len(poses) < n:
        some = rng.uniform([x0, y0, -np.pi], [x1, y1, np.pi], (n, 3))
        free = [clearance(x, y) > robot.footprint_radius + MARGIN for x, y in some[:, :2]]
        poses = np.concatenate([poses, some[free & arena.contains(some[:, :2])]])
    poses = poses[:n]
    stamps: Floats = np.arange(n) / robot.sensor.rate
    noise = rng.normal(size=(n, robot.sensor.n_rays)) * robot.sensor.sigma
    ranges = apply_range_limits(cast(arena, poses, robot.sensor).ranges + noise, robot.sensor)
    return Run(
        sensor=robot.sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses, epoch_ns=EPOCH_NS,
        meta={"source": "check.mcap", "simulated": "true"},
        attachments={"arena.geojson": geojson.dumps(arena).encode(), "robot.yaml": robot.text.encode()},
    )  # fmt: skip


def to_dict(drives: list[DemoDrive]) -> dict[str, Any]:
    """Return the results of the demo as plain data."""
    return {
        drive.planner if drive.model != BASELINE else f"{drive.planner}_{BASELINE}": {
            "model": drive.model,
            "drive_time_s": drive.drive_time,
            "coverage": drive.coverage.fraction,
            "answered": drive.checked.answered,
            "all": drive.checked.all,
            "answered_only": drive.checked.answered_only,
        }
        for drive in drives
    }
