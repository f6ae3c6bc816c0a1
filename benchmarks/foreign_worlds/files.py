"""Write what the robot logged as MCAP with ROS 2 messages, through the plain writer of `mcap-ros2-support`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer

from benchmarks.foreign_worlds.rooms import Floats

EPOCH = 1_700_000_000
"""[s] when every run begins."""
HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
GEOMETRY = """
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
TWIST = """
================================================================================
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
COVARIANCES = """
================================================================================
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
"""
SCHEMAS = {
    "/scan": (
        "sensor_msgs/LaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n"
        "float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\n"
        "float32[] intensities\n" + HEADER,
    ),
    "/pose": (
        "geometry_msgs/PoseStamped",
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n" + HEADER + GEOMETRY,
    ),
    "/odom": (
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n" + HEADER + GEOMETRY + TWIST + COVARIANCES,
    ),
    "/cmd_vel": (
        "geometry_msgs/TwistStamped",
        "std_msgs/Header header\ngeometry_msgs/Twist twist\n" + HEADER + TWIST,
    ),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """What a robot logged; stamps (n,) [s] from the start of the run."""

    bearings: Floats
    range_limits: tuple[float, float]
    scan_stamps: Floats
    ranges: Floats
    """(n_scans, n_rays) [m]; +inf nothing came back, -inf too near."""
    pose_stamps: Floats
    poses: Floats
    """(n, 3)"""
    odom_stamps: Floats
    odometry: Floats
    """(n, 3) integrated."""
    twists: Floats
    """(n, 2) [m/s, rad/s]"""
    cmd_stamps: Floats
    commands: Floats
    """(n, 2)"""


def write_log(log: Log, path: Path) -> None:
    """Write all messages in the order of their stamps."""
    messages = sorted(_messages(log), key=lambda one: one[0])
    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {topic: writer.register_msgdef(*names) for topic, names in SCHEMAS.items()}
        for k, (stamp, topic, content) in enumerate(messages):
            when = round((EPOCH + stamp) * 1e9)
            header = {"stamp": {"sec": when // 10**9, "nanosec": when % 10**9}, "frame_id": _frame(topic)}
            writer.write_message(topic, schemas[topic], {"header": header, **content}, when, when, k)
        writer.finish()


def _frame(topic: str) -> str:
    return {"/scan": "laser", "/pose": "map", "/odom": "odom", "/cmd_vel": "base_link"}[topic]


def _messages(log: Log) -> Iterator[tuple[float, str, dict[str, Any]]]:
    step = float(log.bearings[1] - log.bearings[0])
    for stamp, ranges in zip(log.scan_stamps, log.ranges, strict=True):
        yield (
            float(stamp),
            "/scan",
            {
                "angle_min": float(log.bearings[0]),
                "angle_max": float(log.bearings[-1]),
                "angle_increment": step,
                "time_increment": 0.0,
                "scan_time": 0.0,
                "range_min": log.range_limits[0],
                "range_max": log.range_limits[1],
                "ranges": ranges.astype(np.float32).tolist(),
                "intensities": [],
            },
        )
    for stamp, pose in zip(log.pose_stamps, log.poses, strict=True):
        yield float(stamp), "/pose", {"pose": _pose(pose)}
    zero = [0.0] * 36
    for stamp, pose, twist in zip(log.odom_stamps, log.odometry, log.twists, strict=True):
        content = {
            "child_frame_id": "base_link",
            "pose": {"pose": _pose(pose), "covariance": zero},
            "twist": {"twist": _twist(twist), "covariance": zero},
        }
        yield float(stamp), "/odom", content
    for stamp, command in zip(log.cmd_stamps, log.commands, strict=True):
        yield float(stamp), "/cmd_vel", {"twist": _twist(command)}


def _pose(pose: Floats) -> dict[str, Any]:
    half = float(pose[2]) / 2
    return {
        "position": {"x": float(pose[0]), "y": float(pose[1]), "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
    }


def _twist(twist: Floats) -> dict[str, Any]:
    return {
        "linear": {"x": float(twist[0]), "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": float(twist[1])},
    }
