"""A case as an entrant sees it: log, rings of the map and robot.yaml, read without any code of the worlds."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.reader import make_reader

from benchmarks.hidden_effects.log import STORE, TOPICS, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What an entrant sees; stamps (n,) [s], poses (n, 3) [m, m, rad], twists (n, 2) [m/s, rad/s]."""

    bearings: Floats
    """(n_rays,) [rad]"""
    scan_stamps: Floats
    ranges: Floats
    """(n_scans, n_rays) [m]"""
    pose_stamps: Floats
    poses: Floats
    odom_stamps: Floats
    odometry: Floats
    twists: Floats
    cmd_stamps: Floats
    commands: Floats
    rings: dict[str, Floats]
    """(n, 2) [m] of each ring of the map, the arena's first; none of a map of pixels."""
    robot: dict[str, Any]


def read_case(case: Path) -> Seen:
    """Read the files of a case."""
    rows: dict[str, list[tuple[Any, ...]]] = defaultdict(list)
    bearings: Floats = np.zeros(0)
    epoch = None
    topics = ("/scan", "/pose", "/odom", "/cmd_vel")
    with (case / "run.mcap").open("rb") as file:
        read = [(one.topic, message.data) for _, one, message in make_reader(file).iter_messages(topics)]
    for topic, data in read:
        message = STORE.deserialize_cdr(data, TOPICS[topic])
        epoch = message.header.stamp.sec if epoch is None else epoch
        stamp = message.header.stamp.sec - epoch + 1e-9 * message.header.stamp.nanosec
        if topic == "/scan":
            bearings = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
            rows[topic].append((stamp, *message.ranges))
        elif topic == "/pose":
            rows[topic].append((stamp, *_pose(message.pose)))
        elif topic == "/odom":
            rows[topic].append((stamp, *_pose(message.pose.pose), *_twist(message.twist.twist)))
        else:
            rows[topic].append((stamp, *_twist(message.twist)))
    scans, poses, odometry, commands = (np.array(rows[t]) for t in topics)
    arena = case / "arena.geojson"
    return Seen(
        bearings=bearings,
        scan_stamps=scans[:, 0],
        ranges=scans[:, 1:],
        pose_stamps=poses[:, 0],
        poses=poses[:, 1:],
        odom_stamps=odometry[:, 0],
        odometry=odometry[:, 1:4],
        twists=odometry[:, 4:],
        cmd_stamps=commands[:, 0],
        commands=commands[:, 1:],
        rings=_rings(arena.read_text()) if arena.exists() else {},
        robot=yaml.safe_load((case / "robot.yaml").read_text()),
    )


def _pose(pose: Any) -> tuple[float, float, float]:
    turn = pose.orientation
    return pose.position.x, pose.position.y, 2 * float(np.arctan2(turn.z, turn.w))


def _twist(twist: Any) -> tuple[float, float]:
    return twist.linear.x, twist.angular.z


def _rings(geojson: str) -> dict[str, Floats]:
    features = sorted(json.loads(geojson)["features"], key=lambda one: one["properties"]["kind"] != "arena")
    return {one["properties"]["name"]: np.array(one["geometry"]["coordinates"][0])[:-1] for one in features}
