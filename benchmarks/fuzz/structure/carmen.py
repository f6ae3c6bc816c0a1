"""CARMEN text logs, in the dialects of several recorders."""

from __future__ import annotations

import numpy as np

from benchmarks.fuzz.structure.draft import EPOCH, Draft, Item, compose, mount_of
from benchmarks.fuzz.structure.drives import Floats

NO_RETURN = 81.91


def carmen(draft: Draft, *, words: str = "FLASER", trailer: str = "usual") -> str:
    """Return scans and odometry of a log as text; the laser has 180 or 181 rays from -90°.

    Parameters
    ----------
    words : FLASER, ROBOTLASER1 or RAWLASER1
    trailer : `usual` (time host time), `host_last` (time time host), `time_only`, `none` or `ranges_alone`
    """
    times, odometry, twists = draft.drive.odom_times, draft.drive.odometry, draft.drive.twists
    lines = ["# CARMEN Logfile", "PARAM robot_frontlaser_offset 0.12", "PARAM laser_front_laser_resolution 1"]
    first = EPOCH if words != "FLASER" else 0.0
    for item in draft.items:
        at, logged = item.stamp + first, item.log
        if item.kind == "Odometry" and trailer != "ranges_alone":
            x, y, _, _, _, s, c = item.content["pose"]
            v, omega = item.content["twist"][[0, 5]]
            pose = f"{x:.6f} {y:.6f} {2 * np.arctan2(s, c):.6f} {v:.6f} {omega:.6f} 0.0"
            lines.append(f"ODOM {pose}{_trailer(at, logged, trailer)}")
        elif item.scan >= 0:
            robot = np.array([np.interp(item.stamp, times, column) for column in odometry.T])
            speed = np.array([np.interp(item.stamp, times, column) for column in twists.T])
            poses = trailer != "ranges_alone"
            lines.append(_scan(item, draft, words, robot, speed, poses=poses) + _trailer(at, logged, trailer))
    return "\n".join(lines) + "\n"


def _trailer(at: float, logged: float, kind: str) -> str:
    """Return the end of a line: a time of the sensor, the host, and a time since the start."""
    return {
        "usual": f" {at:.6f} host {logged:.6f}",
        "host_last": f" {at:.6f} {logged:.6f} host",
        "time_only": f" {at:.6f}",
    }.get(kind, "")


def _scan(item: Item, draft: Draft, words: str, robot: Floats, speed: Floats, *, poses: bool) -> str:
    z = np.where(np.isfinite(item.content["ranges"]), item.content["ranges"], NO_RETURN)
    laser = compose(robot, mount_of(draft.laser))
    ranges = f"{len(z)} " + " ".join(f"{value:.3f}" for value in z)
    there = " ".join(f"{value:.6f}" for value in (*laser, *robot))
    if words == "FLASER":
        return f"FLASER {ranges}" + (f" {there}" if poses else "")
    about = f"0 {-np.pi / 2:.6f} {np.pi * len(z) / 181:.6f} {np.radians(1.0):.6f} {NO_RETURN} 0.010000 0"
    line = f"{words} {about} {ranges} 0"
    if words == "RAWLASER1":
        return line
    return f"{line} {there} {speed[0]:.6f} {speed[1]:.6f} 0.3 0.3 0.0"
