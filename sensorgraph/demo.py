"""Run the whole loop on an arena: plan, record, build, evaluate, review, diagnose; compare with random driving."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import logs
from logs.run import Run
from logs.transforms import interpolate
from planners import Plan
from planners import plan as make_plan
from planners.arena import Arena
from planners.coverage import Coverage
from planners.maps import geojson
from planners.planning import WALL_MARGIN
from sensorgraph.building.build import build
from sensorgraph.demo_effect import HiddenEffect, hide_and_find
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.loading import attachments_of
from sensorgraph.models.faces.prediction import predict_rays
from sensorgraph.other_process import OtherProcess
from sensorgraph.planning.plan_folder import counted, save
from sensorgraph.recording.record import record
from sensorgraph.show.figures.drives import race_picture
from sensorgraph.show.review.review import review
from sensorgraph.types import Floats, Progress, ProgressBars
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import Robot, load_robot
from sensorgraph.world.scene import apply_range_limits
from sensorgraph.world.simulate import EPOCH_NS, occupancy_map
from sensorgraph.world.wall_distance import WallDistance

N_CHECK_POSES = 1000
BASELINE = "polynomial"
"""Model that is compared with the faces: the form of 2004."""
STAGES = ("plan", "run", "graph", "review", "diagnosis")
"""Stages with a file to look at, in their order."""
COMPARISON = "comparison"
"""Last stage of the full demo."""

ROOM = """{"type": "FeatureCollection", "features": [
{"type": "Feature", "properties": {"name": "room", "kind": "arena"}, "geometry": {"type": "Polygon",
 "coordinates": [[[0, 0], [2.4, 0], [2.4, 1.6], [0, 1.6], [0, 0]]]}},
{"type": "Feature", "properties": {"name": "box", "kind": "obstacle"}, "geometry": {"type": "Polygon",
 "coordinates": [[[1.4, 0.9], [1.8, 0.9], [1.8, 1.2], [1.4, 1.2], [1.4, 0.9]]]}}]}"""
"""A room so small that little but compiling takes time."""
N_SCANS, POSE_NOISE = 200, 0.003
"""Number of scans there, and noise of their poses [m, rad], so that these are refined."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoDrive:
    """One drive with the model fitted to it, and the errors of its predictions."""

    planner: str
    model: str
    drive_time: float
    """[s] Driving time."""
    coverage: Coverage
    """Coverage by the reference poses in the log, at the rate of the robot's scans."""
    growth: tuple[Floats, Floats]
    """Stamps (n,) [s] and share (n,) of the reachable bins visited by then."""
    graph: Sensorgraph
    checked: Evaluation
    """Evaluation at poses spread evenly over the arena, independent of all runs."""


def demo(
    folder: Path,
    arena: Arena,
    robot: Robot,
    *,
    seed: int,
    full: bool = False,
    progress: ProgressBars,
    show: Callable[[str, Path], None],
) -> tuple[list[DemoDrive], HiddenEffect]:
    """Run the loop; write plan, runs, graphs, review and diagnosis to `folder`.

    Another process hides an effect and finds it. Before that, if the cache is empty, it compiles the kernels of the graph
    while this process compiles those of the plan; the graph is built here later.

    Parameters
    ----------
    full : Compare with a random drive of the same length, and with the model of 2004.
    show : Called with the name of a stage of `STAGES` and the file to look at, as soon as it is written.

    Returns
    -------
    The planned drive and, if `full`, the random drive, and the planned drive with the model of 2004; and the hidden
    effect.
    """
    report, shown = folder / "diagnosis" / "report.html", set[Path]()
    report.unlink(missing_ok=True)  # of an earlier demo in this folder
    with OtherProcess(_side_work, folder / "diagnosis", arena, robot, seed) as side:

        @contextmanager
        def bars(title: str, unit: str) -> Iterator[Progress]:
            """Show the diagnosis between two bars, as soon as the other process has written it."""
            with progress(title, unit) as tick:
                yield tick
            if report.exists() and not shown:
                shown.add(report)
                show("diagnosis", report)

        plan = _plan(arena, robot, "coverage", None, seed, bars)
        save(plan, folder / "plan", arena, robot)
        show("plan", folder / "plan" / "plan.png")
        check = check_run(arena, robot, np.random.default_rng([seed, 99]))
        logs.write(check, folder / "check.mcap", occupancy=occupancy_map(arena))
        path = folder / "coverage.mcap"
        run = record(path, arena, robot, plan.trajectory, seed=seed, progress=bars)
        show("run", path)
        planned = _modelled(folder, "coverage", plan, run, arena, robot, check, bars)
        show("graph", folder / "coverage.sensorgraph")
        review(
            run,
            path=folder / "review.rrd",
            graph=planned.graph,
            plan=folder / "plan",
            arena=arena,
            name="coverage.mcap",
        )
        show("review", folder / "review.rrd")
        hidden = side.result(progress)
    if not shown:
        show("diagnosis", report)
    if not full:
        return [planned], hidden
    other = _plan(arena, robot, "random_bounce", plan.trajectory.duration, seed, progress)
    path = folder / "random_bounce.mcap"
    driven = record(path, arena, robot, other.trajectory, seed=seed, progress=progress)
    random = _modelled(folder, "random_bounce", other, driven, arena, robot, check, progress)
    plain = build([run], arena=arena, model=BASELINE, names=["coverage.mcap"], progress=progress)
    plain.save(folder / f"coverage.{BASELINE}.sensorgraph")
    races = {
        label: (drive.growth[0] / 60, drive.growth[1], drive.coverage)
        for label, drive in (("planned", planned), ("random", random))
    }
    race_picture(races, arena, folder / "coverage.png")
    show(COMPARISON, folder / "coverage.png")
    return [
        planned,
        random,
        replace(planned, model=BASELINE, graph=plain, checked=evaluate(plain, check)),
    ], hidden


def _side_work(
    folder: Path, arena: Arena, robot: Robot, seed: int, *, progress: ProgressBars
) -> HiddenEffect:
    """Compile what the graph takes, unless it is in the cache; then hide an effect and find it."""
    if not _is_compiled(predict_rays):
        rng = np.random.default_rng(0)
        exact = check_run(
            geojson.loads(ROOM), load_robot(), rng, N_SCANS
        )  # the robot of the demo may not fit
        noisy = replace(exact, poses=exact.poses + rng.normal(0, POSE_NOISE, exact.poses.shape))
        evaluate(build([noisy]), exact)
    return hide_and_find(folder, arena, robot, seed, progress=progress)


def _is_compiled(kernel: Any) -> bool:
    """Return whether a kernel is in the cache, or cannot be kept in one."""
    folder = kernel.stats.cache_path
    return folder is None or any(Path(folder).glob(f"*{kernel.__qualname__}*"))


def _modelled(
    folder: Path,
    planner: str,
    planned: Plan,
    run: Run,
    arena: Arena,
    robot: Robot,
    check: Run,
    progress: ProgressBars,
) -> DemoDrive:
    """Build a sensorgraph from the run of a plan, and evaluate it."""
    graph = build([run], arena=arena, names=[f"{planner}.mcap"], progress=progress)
    graph.save(folder / f"{planner}.sensorgraph")
    stamps = np.arange(float(run.pose_stamps[0]), float(run.pose_stamps[-1]), 1 / robot.sensor.rate)
    poses = interpolate(stamps, run.pose_stamps, run.poses)
    coverage = counted(planned.coverage, poses)
    return DemoDrive(
        planner=planner,
        model=graph.model.name,
        drive_time=planned.trajectory.duration,
        coverage=coverage,
        growth=coverage.growth(stamps, poses),
        graph=graph,
        checked=evaluate(graph, check),
    )


def _plan(
    arena: Arena, robot: Robot, planner: str, duration: float | None, seed: int, progress: ProgressBars
) -> Plan:
    """Plan a drive with one planner."""
    with progress(f"plan {planner}", "bins") as tick:
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
        free = [clearance(x, y) > robot.footprint_radius + WALL_MARGIN for x, y in some[:, :2]]
        poses = np.concatenate([poses, some[free & arena.contains(some[:, :2])]])
    poses = poses[:n]
    stamps: Floats = np.arange(n) / robot.sensor.rate
    noise = rng.normal(size=(n, robot.sensor.n_rays)) * robot.sensor.sigma
    ranges = apply_range_limits(cast(arena, poses, robot.sensor).ranges + noise, robot.sensor)
    return Run(
        sensor=robot.sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses, epoch_ns=EPOCH_NS,
        meta={"source": "check.mcap", "simulated": "true"},
        attachments=attachments_of(arena, robot),
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
