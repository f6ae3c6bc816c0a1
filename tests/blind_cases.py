"""What a case of a blind world reads, against its own map: no code of ours takes part."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml


def walls_of(arena: str) -> np.ndarray:
    """Return the walls (n, 4) [m] x0, y0, x1, y1 of a map's GeoJSON."""
    rings = [
        np.array(one["geometry"]["coordinates"][0], dtype=float) for one in json.loads(arena)["features"]
    ]
    return np.concatenate([np.column_stack([ring[:-1], ring[1:]]) for ring in rings])


def _cast(starts: np.ndarray, directions: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Return the range of each ray to the nearest wall."""
    nearest = np.full(len(starts), np.inf)
    dx, dy = np.cos(directions), np.sin(directions)
    for x0, y0, x1, y1 in walls:
        ax, ay, ex, ey = x0 - starts[:, 0], y0 - starts[:, 1], x1 - x0, y1 - y0
        cross = dx * ey - dy * ex
        cross = np.where(cross == 0, 1e-12, cross)
        t, share = (ax * ey - ay * ex) / cross, (ax * dy - ay * dx) / cross
        nearest = np.where((t > 0) & (share >= 0) & (share <= 1) & (t < nearest), t, nearest)
    return nearest


def spread_over_sigma(case: Path) -> float:
    """Return the robust spread of a case's readings about its own map at its own poses, over the stated noise."""
    reader = pytest.importorskip("mcap_ros2.reader")
    scans, stamps, poses = [], [], []
    for one in reader.read_ros2_messages(str(case / "run.mcap")):
        message = one.ros_msg
        if one.channel.topic not in ("/scan", "/pose"):
            continue
        stamp = message.header.stamp.sec % 10**6 + message.header.stamp.nanosec * 1e-9
        if one.channel.topic == "/scan":
            scans.append(message)
            stamps.append(stamp)
        else:
            at, turn = message.pose.position, message.pose.orientation
            poses.append((stamp, at.x, at.y, 2 * np.arctan2(turn.z, turn.w)))
    pose = np.array(sorted(poses)).T
    n = len(scans[0].ranges)
    taken = (np.array(stamps)[:, None] + scans[0].time_increment * np.arange(n)).ravel()
    x, y = np.interp(taken, pose[0], pose[1]), np.interp(taken, pose[0], pose[2])
    phi = np.interp(taken, pose[0], np.unwrap(pose[3]))
    sensor = yaml.safe_load((case / "robot.yaml").read_text())["sensor"]
    c, s, (mount_x, mount_y, mount_yaw) = np.cos(phi), np.sin(phi), sensor["mount"]
    bearings = np.tile(scans[0].angle_min + scans[0].angle_increment * np.arange(n), len(scans))
    starts = np.column_stack([x + c * mount_x - s * mount_y, y + s * mount_x + c * mount_y])
    walls = walls_of((case / "arena.geojson").read_text())
    simulated = _cast(starts, phi + mount_yaw + bearings, walls)
    measured = np.concatenate([one.ranges for one in scans])
    residual = (measured - simulated)[np.isfinite(measured)]
    # a few rays at edges may go either way
    return float(1.4826 * np.median(np.abs(residual)) / sensor["sigma"])
