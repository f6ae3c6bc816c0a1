"""Messages and bags of ROS 1 and 2, written by rosbags: apart from the code that reads them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import logs
from logs.ros import cdr
from logs.ros.recording import (
    ODOMETRY_TYPE,
    POSE_TYPE,
    RANGE_TYPE,
    SCAN_TYPE,
    TF_TYPE,
    TWIST_TYPE,
)

EPOCH = 1_600_000_000_000_000_000
Message = tuple[str, str, int, bytes]
HUMBLE = get_typestore(Stores.ROS2_HUMBLE)


def ns(stamp: float) -> int:
    return EPOCH + round(stamp * 1e9)


def message(
    topic: str, msgtype: str, stamp: float, strings: Mapping[str, str], *, log: float | None = None, parts: int = 0,
    **columns: Any,
) -> Message:  # fmt: skip
    at = ns(stamp)
    heads = [f"{i}." for i in range(parts)] or ([""] if msgtype != TWIST_TYPE else [])
    stamps = {
        f"{h}{k}": np.array([v]) for h in heads for k, v in (("sec", at // 10**9), ("nanosec", at % 10**9))
    }
    data = {k.replace("__", "."): np.asarray(v, dtype=np.float64) for k, v in columns.items()}
    row = cdr.pack(msgtype, 1, strings=strings, columns={**stamps, **data}, parts=parts)
    return topic, msgtype, ns(stamp if log is None else log), row[0].tobytes()


def scan(
    stamp: float, ranges: Any, *, topic: str = "/scan", frame: str = "laser", log: float | None = None,
    angle_min: float = -0.5, increment: float = 0.25, time_increment: float = 0.0,
    range_min: float = 0.1, range_max: float = 10.0, scan_time: float = 0.1,
) -> Message:  # fmt: skip
    ranges = np.asarray(ranges, dtype=np.float64)
    last = angle_min + increment * (len(ranges) - 1)
    limits = [angle_min, last, increment, time_increment, scan_time, range_min, range_max]
    return message(topic, SCAN_TYPE, stamp, {"frame_id": frame}, log=log, limits=limits, ranges=ranges)


def quaternion(yaw: float, roll: float = 0.0) -> list[float]:
    cy, sy, cr, sr = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(roll / 2), np.sin(roll / 2)
    return [cy * sr, sy * sr, sy * cr, cy * cr]


def transform(
    stamp: float, parent: str, child: str, x: float, y: float, yaw: float, *,
    z: float = 0.0, roll: float = 0.0, static: bool = False, topic: str = "/tf", log: float | None = None,
) -> Message:  # fmt: skip
    strings = {"0.frame_id": parent, "0.child_frame_id": child}
    values = [x, y, z, *quaternion(yaw, roll)]
    topic = "/tf_static" if static else topic
    return message(topic, TF_TYPE, stamp, strings, parts=1, log=log, **{"0__transform": values})


def pose(
    stamp: float, x: float, y: float, yaw: float, *, topic: str = "/pose", kind: str = POSE_TYPE,
    log: float | None = None,
) -> Message:  # fmt: skip
    return message(topic, kind, stamp, {"frame_id": "map"}, log=log, pose=[x, y, 0, *quaternion(yaw)])


def odometry(
    stamp: float, x: float, y: float, yaw: float, v: float = 0.0, omega: float = 0.5, *, topic: str = "/odom",
    log: float | None = None, left: float = 0.0,
) -> Message:  # fmt: skip
    strings = {"frame_id": "odom", "child_frame_id": "base_link"}
    columns = {"pose": [x, y, 0, *quaternion(yaw)], "twist": [v, left, 0, 0, 0, omega]}
    return message(topic, ODOMETRY_TYPE, stamp, strings, log=log, **columns)


def command(stamp: float, v: float, omega: float, *, topic: str = "/cmd_vel") -> Message:
    return message(topic, TWIST_TYPE, stamp, {}, twist=[v, 0, 0, 0, 0, omega])


def write_bag2(
    path: Path, messages: list[Message], storage: str = "MCAP", *, mode: str | None = None
) -> Path:
    bag = Writer2(path, version=8, storage_plugin=StoragePlugin[storage])
    if mode is not None:
        bag.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with bag as writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, at, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=HUMBLE)
            writer.write(connections[topic], at, data)
    return path


def to_ros1(store: Any, value: Any) -> Any:
    """Rebuild a ROS 2 message from ROS 1's classes; headers get their count."""
    if isinstance(value, list):
        return [to_ros1(store, item) for item in value]
    if not hasattr(value, "__msgtype__"):
        return value
    fields = {f.name: to_ros1(store, getattr(value, f.name)) for f in dataclasses.fields(value)}
    if value.__msgtype__ == "std_msgs/msg/Header":
        fields["seq"] = 7
    return store.types[value.__msgtype__](**fields)


def write_bag1(path: Path, messages: list[Message]) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF_TYPE))
    with Writer1(path) as writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, at, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=store)
            old = to_ros1(store, HUMBLE.deserialize_cdr(data, msgtype))
            writer.write(connections[topic], at, bytes(store.serialize_ros1(old, msgtype)))
    return path


def trip() -> list[Message]:
    """Ten scans of five rays while driving along x at 1 m/s, everything present."""
    out = [transform(0.0, "base_link", "laser", 0.2, 0.1, 0.3, z=0.4, static=True)]
    for i in range(10):
        t = i / 10
        out += [
            scan(t, [1, 2, 3, 4, 5 + t]),
            pose(t, t, 0, 0),
            odometry(t, t, 0.1, 0, 1.0),
            command(t, 1.0, 0.1),
        ]
    return out


def read(tmp_path: Path, messages: list[Message], **topics: str) -> logs.Run:
    return logs.read(write_bag2(tmp_path / "bag", messages), topics=topics or None)


def sonar(
    stamp: float, distance: float, *, topic: str, frame: str, cone: float = 0.5, reach: float = 4.0
) -> Message:
    limits = [cone, 0.02, reach, distance]
    return message(topic, RANGE_TYPE, stamp, {"frame_id": frame}, radiation_type=[0], limits=limits)


RING = [(0.2 * np.cos(a), 0.2 * np.sin(a), a) for a in np.radians([0, 90, 180, -90])]


def ring(n: int = 8, *, one_topic: bool = False) -> list[Message]:
    """Four sonars around the robot, each with a rate and a mount of its own."""
    out = [transform(0, "base_link", f"sonar_{k}", *at, static=True) for k, at in enumerate(RING)]
    for k in range(4):
        topic = "/sonar" if one_topic else f"/sonar/{k}"
        out += [
            sonar(
                0.05 * (k + 1) * i,
                1 + k + i / 10,
                topic=topic,
                frame=f"sonar_{k}",
                cone=0.1 * (k + 1),
                reach=8,
            )
            for i in range(n)
        ]
    return sorted([*out, *(pose(0.1 * i, 0.1 * i, 0, 0) for i in range(5))], key=lambda m: m[2])
