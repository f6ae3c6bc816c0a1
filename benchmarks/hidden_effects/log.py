"""What a robot logs, and its file: MCAP with ROS 2 messages, so that any reader will do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]

STORE = get_typestore(Stores.ROS2_HUMBLE)
TOPICS = {
    "/scan": "sensor_msgs/msg/LaserScan", "/pose": "geometry_msgs/msg/PoseStamped", "/odom": "nav_msgs/msg/Odometry",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped", "/tf_static": "tf2_msgs/msg/TFMessage",
}  # fmt: skip
POSE_VARIANCE = 1e-3
"""[m2, rad2] that a driver states of its odometry's poses, where it states anything."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Odometry:
    """What a base makes of its encoders."""

    stamps: Floats
    """(n,) [s]"""
    poses: Floats
    """(n, 3) [m, m, rad]"""
    twists: Floats
    """(n, 2) [m/s, rad/s]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """What a robot logged; stamps (n,) [s] from the start of the run."""

    epoch_ns: int
    bearings: Floats
    """(n_rays,) [rad]"""
    range_limits: tuple[float, float]
    """[m]"""
    sweep_time: float = 0.0
    """[s] from the first ray of a scan to after its last."""
    scan_period: float = 0.0
    """[s], 0: not stated."""
    mount: tuple[float, float, float, float] | None = None
    """x, y, height [m] and yaw [rad] of the laser on the base; None: not logged."""
    scan_stamps: Floats
    ranges: Floats
    """(n_scans, n_rays) [m]; +inf nothing came back, -inf too near."""
    pose_stamps: Floats
    poses: Floats
    """(n, 3) [m, m, rad]"""
    odometry: Odometry
    twist_sigmas: tuple[float, float] | None = None
    """[m/s, rad/s] that the base states; None: nothing."""
    cmd_stamps: Floats
    commands: Floats
    """(n, 2) [m/s, rad/s]"""
    arrival_seed: tuple[int, int] | None = None
    """Of how late each message arrives; None: at once."""


def write_log(log: Log, path: Path, library: str) -> None:
    """Write all messages in the order in which they arrived, in the name of a library."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=library)
        channels = {}
        for topic, name in TOPICS.items():
            text, _ = STORE.generate_msgdef(name, ros_version=2)
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", text.encode())
            )
        counts = dict.fromkeys(TOPICS, 0)
        for arrival_ns, topic, stamp_ns, message in sorted(_messages(log), key=lambda one: one[0]):
            content = bytes(STORE.serialize_cdr(message, TOPICS[topic]))
            writer.add_message(channels[topic], arrival_ns, content, stamp_ns, counts[topic])
            counts[topic] += 1
        writer.finish()  # type: ignore[no-untyped-call]


def _messages(log: Log) -> Iterator[tuple[int, str, int, Any]]:
    """Yield when a message arrives [ns], its topic, its stamp [ns] and itself, topic by topic."""
    rng = None if log.arrival_seed is None else np.random.default_rng(log.arrival_seed)

    def sent(
        topic: str,
        stamps: Floats,
        frame: str,
        late: tuple[float, float],
        content: Callable[[int], tuple[Any, ...]],
    ) -> Iterator[tuple[int, str, int, Any]]:
        """Send a message at each stamp, of fields that follow its header; it arrives between so many seconds later."""
        for k, stamp in enumerate(stamps):
            stamp_ns = log.epoch_ns + round(stamp * 1e9)
            arrival_ns = stamp_ns + (0 if rng is None else int(rng.uniform(*late) * 1e9))
            yield arrival_ns, topic, stamp_ns, _of(TOPICS[topic], _header(stamp_ns, frame), *content(k))

    if log.mount is not None:
        x, y, height, yaw = log.mount
        transform = _geometry("Transform", _geometry("Vector3", x, y, height), _turn(yaw))
        link = _geometry("TransformStamped", _header(log.epoch_ns, "base_link"), "laser", transform)
        yield log.epoch_ns, "/tf_static", log.epoch_ns, _of(TOPICS["/tf_static"], [link])
    sweep, n = log.sweep_time, len(log.bearings)
    step = (log.bearings[-1] - log.bearings[0]) / (n - 1)
    facts = (log.bearings[0], log.bearings[-1], step, sweep / n, log.scan_period, *log.range_limits)
    ranges, none = log.ranges.astype(np.float32), np.zeros(0, np.float32)
    yield from sent(
        "/scan", log.scan_stamps, "laser", (sweep + 0.001, sweep + 0.004), lambda k: (*facts, ranges[k], none)
    )
    yield from sent("/pose", log.pose_stamps, "map", (0.001, 0.01), lambda k: (_pose(log.poses[k]),))
    sigma_v, sigma_omega = log.twist_sigmas or (0.0, 0.0)
    of_pose = _covariance(*[POSE_VARIANCE * (log.twist_sigmas is not None)] * 3)
    of_twist = _covariance(sigma_v**2, 0.0, sigma_omega**2)

    def state(k: int) -> tuple[Any, ...]:
        pose = _geometry("PoseWithCovariance", _pose(log.odometry.poses[k]), of_pose)
        return "base_link", pose, _geometry("TwistWithCovariance", _twist(log.odometry.twists[k]), of_twist)

    yield from sent("/odom", log.odometry.stamps, "odom", (0.0005, 0.003), state)
    yield from sent(
        "/cmd_vel", log.cmd_stamps, "base_link", (0.0002, 0.001), lambda k: (_twist(log.commands[k]),)
    )


def _of(name: str, *values: Any) -> Any:
    return STORE.types[name](*values)


def _geometry(name: str, *values: Any) -> Any:
    return _of(f"geometry_msgs/msg/{name}", *values)


def _header(stamp_ns: int, frame: str) -> Any:
    stamp = _of("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
    return _of("std_msgs/msg/Header", stamp, frame)


def _turn(yaw: float) -> Any:
    return _geometry("Quaternion", 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))


def _pose(pose: Floats) -> Any:
    return _geometry("Pose", _geometry("Point", pose[0], pose[1], 0.0), _turn(pose[2]))


def _twist(twist: Floats) -> Any:
    return _geometry(
        "Twist", _geometry("Vector3", twist[0], 0.0, 0.0), _geometry("Vector3", 0.0, 0.0, twist[1])
    )


def _covariance(first: float, second: float, yaw: float) -> Floats:
    return np.diag([first, second, 0.0, 0.0, 0.0, yaw]).ravel()
