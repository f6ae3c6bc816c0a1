"""Lasers of any noise: how near do a graph, located poses and a calibration from driving alone come to the truth?

    python -m benchmarks.noisy_lasers [--sigmas 5 10 20 30 50]

The shipped robot drives for four minutes in the arena `square`, close to its walls, with a laser of each noise [mm]. The graph is
built on the true poses, and its predicted ranges are compared with the walls. The run is then located without its poses and without
a map, after the best rigid motion, and the mount is calibrated on it. Mount and bearings are as stated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import logs
import sensorgraph as sg
from benchmarks.arguments import heads, parser_of
from planners.types import Floats
from sensorgraph.diagnosis.motion.calibration.estimate import calibrate
from sensorgraph.diagnosis.motion.calibration.laser_motion import laser_motion
from sensorgraph.localization.locate import locate, located_run
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import default_robot

ARENA, SECONDS = "square", 240.0
EVERY = 20
"""Number of scans from one compared with the walls to the next."""


def moved_together(poses: Floats, truth: Floats) -> float:
    """Return the r.m.s. error [m] of positions (n, 3) after the best rigid motion (Umeyama 1991)."""
    a, b = (p[:, :2] - p[:, :2].mean(axis=0) for p in (poses, truth))
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.sqrt(((a @ turn - b) ** 2).sum(axis=1).mean()))


def row(sigma: float) -> str:
    """Return the line of a noise [m]."""
    robot, arena = default_robot(), sg.load_arena(ARENA)
    robot = replace(robot, sensor=replace(robot.sensor, sigma=sigma))
    run = sg.record(sg.plan(arena, robot=robot, budget=SECONDS))
    truth = logs.pair(run).poses
    graph, some = sg.build(run), truth[::EVERY]
    said = graph.predict(some)
    there = cast_laser(
        arena.walls, laser_poses(some, run.sensor.mount), run.sensor.bearings, run.sensor.range_max
    )[0]
    off = (said.mode - there)[said.answered & np.isfinite(there)]
    found = locate(run)
    known = np.isfinite(found.poses[:, 0])
    ahead, error = calibrate(laser_motion(run, located_run(run, found))).of("mount_x")
    return (
        f"| {1000 * sigma:.0f} mm | {100 * said.answered.mean():.1f} % | {1000 * np.sqrt(np.median(off**2)):.2f} mm "
        f"| {1000 * moved_together(found.poses[known], truth[known]):.1f} mm "
        f"| {1000 * (ahead - run.sensor.mount[0]):+.1f} ± {1000 * error:.1f} mm | {'; '.join(found.notes) or 'none'} |"
    )


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--sigmas", type=float, nargs="+", default=[5, 10, 20, 30, 50], metavar="MM")
    print(heads("noise", "answered", "error of the graph, median", "error of located poses, r.m.s.", "error of the mount", "corrections"))  # fmt: skip
    for sigma in parser.parse_args().sigmas:
        print(row(sigma / 1000))


if __name__ == "__main__":
    main()
