"""Convert arrays to ROS 2 messages, a whole topic per call."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.ros import cdr
from logs.ros.recording import (
    ODOMETRY_TYPE,
    POSE_COVARIANCE_TYPE,
    POSE_TYPE,
    SCAN_TYPE,
    TF_TYPE,
    TWIST_STAMPED_TYPE,
)
from logs.run import OccupancyMap, RangeSensor
from logs.transforms import Stamps, to_translation_quaternion
from logs.types import Floats

GRID_TYPE = "nav_msgs/msg/OccupancyGrid"
PLANAR = np.array([0, 1, 5])
"""Indices of x, y and yaw in the six rows of a ROS covariance."""


def zero_time(epoch_ns: int, first: float) -> int:
    """Return the time [ns] of stamp 0 in the file; MCAP has no time before 1970, so earlier runs start at 0."""
    start = epoch_ns + round(first * 1e9)
    return epoch_ns - min(start, 0)


def to_ns(stamps: Floats, zero: int) -> Stamps:
    """Convert stamps [s] to int64 nanoseconds."""
    if not np.isfinite(stamps).all():
        raise LogError("a stamp is not finite; remove such samples before writing")
    ns: Stamps = np.rint(stamps * 1e9).astype(np.int64) + zero
    if len(ns) and ns.max() >= 2**31 * 10**9:
        raise LogError(
            f"a stamp is {ns.max() / 1e9:.0f} s after 1970, but ROS time ends at {2**31} s; check epoch_ns"
        )
    return ns


def header(ns: Stamps) -> dict[str, Stamps]:
    """Return the columns of the header stamps."""
    return {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}


def scan_messages(
    sensor: RangeSensor, ns: Stamps, ranges: Floats, intensities: Floats | None = None
) -> cdr.Bytes:
    """Pack LaserScan messages (n, size); `intensities` (n, n_rays) or (0, n_rays), as in a run."""
    n = sensor.n_rays
    increment = (sensor.bearings[-1] - sensor.bearings[0]) / (n - 1) if n > 1 else 0.0
    limits = np.array([
        sensor.bearings[0], sensor.bearings[-1], increment, sensor.sweep_time / n, 1.0 / sensor.rate,
        sensor.range_min, sensor.range_max,
    ])  # fmt: skip
    columns = {**header(ns), "limits": limits, "ranges": ranges}
    if intensities is not None and len(intensities):
        columns["intensities"] = intensities
    return cdr.pack(SCAN_TYPE, len(ns), strings={"frame_id": "laser"}, columns=columns)


def pose_messages(ns: Stamps, poses: Floats) -> cdr.Bytes:
    """Pack PoseStamped messages in map (n, size)."""
    columns = {**header(ns), "pose": to_translation_quaternion(poses)}
    return cdr.pack(POSE_TYPE, len(ns), strings={"frame_id": "map"}, columns=columns)


def pose_covariance_messages(ns: Stamps, poses: Floats, covariances: Floats) -> cdr.Bytes:
    """Pack PoseWithCovarianceStamped messages in map (n, size); covariances (n, 3, 3) of x, y, phi."""
    six = np.zeros((len(poses), 6, 6))
    six[:, PLANAR[:, None], PLANAR] = covariances
    columns = {**header(ns), "pose": to_translation_quaternion(poses), "covariance": six.reshape(-1, 36)}
    return cdr.pack(POSE_COVARIANCE_TYPE, len(ns), strings={"frame_id": "map"}, columns=columns)


def planar_covariances(rows: Floats) -> Floats:
    """Extract the covariances (n, 3, 3) of x, y, phi from ROS covariances (n, 36) of x, y, z and three rotations."""
    return rows.reshape(-1, 6, 6)[:, PLANAR[:, None], PLANAR].astype(np.float64)


def odometry_messages(ns: Stamps, poses: Floats, twists: Floats) -> cdr.Bytes:
    """Pack Odometry messages (n, size)."""
    columns = {**header(ns), "pose": to_translation_quaternion(poses), "twist": _six(twists)}
    strings = {"frame_id": "odom", "child_frame_id": "base_link"}
    return cdr.pack(ODOMETRY_TYPE, len(ns), strings=strings, columns=columns)


def command_messages(ns: Stamps, twists: Floats) -> cdr.Bytes:
    """Pack TwistStamped messages (n, size)."""
    columns = {**header(ns), "twist": _six(twists)}
    return cdr.pack(TWIST_STAMPED_TYPE, len(ns), strings={"frame_id": "base_link"}, columns=columns)


def transform_messages(ns: Stamps, *edges: tuple[str, str, Floats], z: float = 0.0) -> cdr.Bytes:
    """Pack TFMessage messages (n, size) with one transform per edge (parent, child, poses (n, 3))."""
    strings: dict[str, str] = {}
    columns: dict[str, NDArray[Any]] = {}
    for i, (parent, child, poses) in enumerate(edges):
        strings |= {f"{i}.frame_id": parent, f"{i}.child_frame_id": child}
        columns |= {f"{i}.{name}": values for name, values in header(ns).items()}
        columns[f"{i}.transform"] = to_translation_quaternion(poses, z)
    return cdr.pack(TF_TYPE, len(ns), strings=strings, columns=columns, parts=len(edges))


def map_message(ns: Stamps, occupancy: OccupancyMap) -> cdr.Bytes:
    """Pack one OccupancyGrid message (1, size)."""
    ny, nx = occupancy.data.shape
    columns = {
        **header(ns),
        **{f"load_{name}": values for name, values in header(ns).items()},
        "resolution": np.array([occupancy.resolution]),
        "size": np.array([nx, ny]),
        "origin": to_translation_quaternion(occupancy.origin[None]),
        "data": occupancy.data.reshape(1, ny * nx),
    }
    return cdr.pack(GRID_TYPE, 1, strings={"frame_id": "map"}, columns=columns)


def _six(twists: Floats) -> Floats:
    out = np.zeros((len(twists), 6))
    out[:, 0], out[:, 5] = twists[:, 0], twists[:, 1]
    return out
