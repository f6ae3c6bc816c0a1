"""Figure of a run: the path, and the end points of scans in map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from logs.arguments import check_scan
from logs.motion import Recorded, motion_of, to_ray_starts
from logs.transforms import compose
from logs.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_POINTS = 200_000
"""Maximum number of end points in a figure."""


def run_figure(run: Recorded, scan: int | None = None) -> Figure:
    """Draw the path with the end points of all scans, or of one scan with its rays.

    Each ray starts where the robot was at its time. Without reference poses the odometry is drawn, and one scan in the
    frame of the laser.

    Raises
    ------
    ValueError : `scan` is not a whole number.
    IndexError : The run has no such scan.
    """
    from matplotlib.figure import Figure  # imported here, since it takes long

    if scan is not None:
        check_scan(scan, len(run.stamps))
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    axes = figure.subplots()
    has_poses = bool(np.isfinite(run.poses).all(axis=1).any())
    path = run.poses if has_poses else run.odometry
    scans = np.arange(len(run.stamps))[:: max(1, len(run.stamps) * run.sensor.n_rays // MAX_POINTS)]
    if scan is not None:
        scans = np.arange(len(run.stamps))[[scan]]
        title = f"scan {int(scans[0])}, t = {run.stamps[scans[0]] - run.stamps[0]:.1f} s"
    else:
        title = f"{len(run.stamps):,} scans, {float(np.ptp(run.stamps)):.0f} s"
    if len(path) and (scan is None or has_poses):
        axes.plot(path[:, 0], path[:, 1], color="0.6", lw=0.8, label="path" if has_poses else "odometry")
    if has_poses or scan is not None:
        starts, ends = _rays(run, scans, has_poses)
        if scan is not None:
            lines = np.stack([starts, ends, np.full_like(ends, np.nan)], axis=2).reshape(-1, 2)
            axes.plot(*lines.T, color="C0", lw=0.3, alpha=0.5)
        axes.plot(
            *ends.reshape(-1, 2).T, "." if scan is not None else ",", color="C0", ms=3, label="end points"
        )
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(title, loc="left", fontsize="medium")
    axes.legend(loc="upper right", fontsize="small")
    return figure


def _rays(run: Recorded, scans: np.ndarray, has_poses: bool) -> tuple[Floats, Floats]:
    """Return start and end points (n, n_rays, 2) [m] of the rays of scans; nan where a ray did not return."""
    sensor = run.sensor
    poses = np.zeros((len(scans), sensor.n_rays, 3))
    if has_poses:
        poses = motion_of(run).at(run.stamps[scans][:, None] + sensor.ray_delays)
    lasers = to_ray_starts(poses, sensor, run.pose_frame)
    if run.pose_frame != "laser":
        lasers = compose(lasers, sensor.mount)
    angle = lasers[..., 2] + sensor.bearings
    ranges = np.where(np.isfinite(run.ranges[scans]), run.ranges[scans], np.nan)
    ends = lasers[..., :2] + ranges[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return lasers[..., :2], ends
