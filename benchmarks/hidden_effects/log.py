"""What a robot logs, and its file: MCAP with ROS 2 messages, packed into CDR by hand, so that any reader will do."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.writer import CompressionType, Writer

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]

SEPARATOR = "\n" + "=" * 80 + "\n"
HEADER = (
    f"MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id{SEPARATOR}"
    "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
)
VECTOR = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
POSE = (
    f"MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation{SEPARATOR}"
    f"MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z{SEPARATOR}{QUATERNION}"
)
TWIST = f"MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular{SEPARATOR}{VECTOR}"
SCAN = (
    "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\nfloat32 time_increment\n"
    "float32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities"
)
ODOMETRY = (
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist"
)
POSE_COVARIANCE = "MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance"
TWIST_COVARIANCE = "MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance"
TRANSFORM = (
    "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n"
    f"geometry_msgs/Transform transform{SEPARATOR}{HEADER}{SEPARATOR}MSG: geometry_msgs/Transform\n"
    f"geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation{SEPARATOR}{VECTOR}{SEPARATOR}{QUATERNION}"
)
SCHEMAS = {
    "/scan": ("sensor_msgs/msg/LaserScan", [SCAN, HEADER]),
    "/pose": (
        "geometry_msgs/msg/PoseStamped",
        ["std_msgs/Header header\ngeometry_msgs/Pose pose", HEADER, POSE],
    ),
    "/odom": ("nav_msgs/msg/Odometry", [ODOMETRY, HEADER, POSE_COVARIANCE, TWIST_COVARIANCE, POSE, TWIST]),
    "/cmd_vel": (
        "geometry_msgs/msg/TwistStamped",
        ["std_msgs/Header header\ngeometry_msgs/Twist twist", HEADER, TWIST],
    ),
    "/tf_static": ("tf2_msgs/msg/TFMessage", ["geometry_msgs/TransformStamped[] transforms", TRANSFORM]),
}
LITTLE_ENDIAN = b"\0\1\0\0"
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
    odom_stamps: Floats
    odometry: Floats
    """(n, 3) [m, m, rad]"""
    twists: Floats
    """(n, 2) [m/s, rad/s]"""
    twist_sigmas: tuple[float, float] | None = None
    """[m/s, rad/s] that the base states; None: nothing."""
    cmd_stamps: Floats
    commands: Floats
    """(n, 2) [m/s, rad/s]"""
    arrival_seed: tuple[int, int] | None = None
    """Of how late each message arrives; None: at once."""


@dataclass(frozen=True, kw_only=True)
class _Message:
    topic: str
    stamp_ns: int
    arrival_ns: int
    content: bytes


def write_log(log: Log, path: Path, library: str) -> None:
    """Write all messages in the order in which they arrived, in the name of a library."""
    messages = sorted(_messages(log), key=lambda message: message.arrival_ns)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=library)
        channels = {}
        for topic, (name, parts) in SCHEMAS.items():
            schema = writer.register_schema(name, "ros2msg", SEPARATOR.join(parts).encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        counts = dict.fromkeys(SCHEMAS, 0)
        for one in messages:
            writer.add_message(
                channels[one.topic], one.arrival_ns, one.content, one.stamp_ns, counts[one.topic]
            )
            counts[one.topic] += 1
        writer.finish()  # type: ignore[no-untyped-call]


def _messages(log: Log) -> Iterator[_Message]:
    """Yield all messages, topic by topic."""
    rng = None if log.arrival_seed is None else np.random.default_rng(log.arrival_seed)

    def message(
        topic: str, stamp: float, frame: str, content: bytes, late: tuple[float, float], align: int = 8
    ) -> _Message:
        stamp_ns = log.epoch_ns + round(stamp * 1e9)
        head = LITTLE_ENDIAN + _padded(_time(stamp_ns) + _text(frame), align)
        arrival_ns = stamp_ns + (0 if rng is None else int(rng.uniform(*late) * 1e9))
        return _Message(topic=topic, stamp_ns=stamp_ns, arrival_ns=arrival_ns, content=head + content)

    if log.mount is not None:
        yield _static(log.mount, log.epoch_ns)
    sweep, n = log.sweep_time, len(log.bearings)
    step = (log.bearings[-1] - log.bearings[0]) / (n - 1)
    head = struct.pack(
        "<7fI", log.bearings[0], log.bearings[-1], step, sweep / n, log.scan_period, *log.range_limits, n
    )
    for stamp, ranges in zip(log.scan_stamps, log.ranges, strict=True):
        content = head + ranges.astype("<f4").tobytes() + struct.pack("<I", 0)
        yield message("/scan", stamp, "laser", content, (sweep + 0.001, sweep + 0.004), align=4)
    for stamp, pose in zip(log.pose_stamps, log.poses, strict=True):
        yield message("/pose", stamp, "map", _pose(pose), (0.001, 0.01))
    states = log.twist_sigmas is not None
    pose_covariance = _covariance(*[POSE_VARIANCE * states] * 3)
    sigma_v, sigma_omega = log.twist_sigmas or (0.0, 0.0)
    twist_covariance = _covariance(sigma_v**2, 0.0, sigma_omega**2)
    head_odom = _padded(_time(0) + _text("odom"), 4)
    child = _padded(head_odom + _text("base_link"), 8)[len(head_odom) :]
    for stamp, pose, twist in zip(log.odom_stamps, log.odometry, log.twists, strict=True):
        content = child + _pose(pose) + pose_covariance + _twist(twist) + twist_covariance
        yield message("/odom", stamp, "odom", content, (0.0005, 0.003), align=4)
    for stamp, command in zip(log.cmd_stamps, log.commands, strict=True):
        yield message("/cmd_vel", stamp, "base_link", _twist(command), (0.0002, 0.001))


def _static(mount: tuple[float, float, float, float], epoch_ns: int) -> _Message:
    x, y, height, yaw = mount
    head = struct.pack("<I", 1) + _time(epoch_ns) + _text("base_link")
    head = LITTLE_ENDIAN + _padded(_padded(head, 4) + _text("laser"), 8)
    content = head + struct.pack("<7d", x, y, height, *_quaternion(yaw))
    return _Message(topic="/tf_static", stamp_ns=epoch_ns, arrival_ns=epoch_ns, content=content)


def _text(text: str) -> bytes:
    content = text.encode() + b"\0"
    return struct.pack("<I", len(content)) + content


def _padded(content: bytes, align: int) -> bytes:
    return content + b"\0" * (-len(content) % align)


def _time(stamp_ns: int) -> bytes:
    return struct.pack("<iI", stamp_ns // 10**9, stamp_ns % 10**9)


def _quaternion(yaw: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))


def _pose(pose: Floats) -> bytes:
    return struct.pack("<7d", pose[0], pose[1], 0.0, *_quaternion(pose[2]))


def _twist(twist: Floats) -> bytes:
    return struct.pack("<6d", twist[0], 0.0, 0.0, 0.0, 0.0, twist[1])


def _covariance(first: float, second: float, yaw: float) -> bytes:
    matrix = np.zeros((6, 6))
    matrix[0, 0], matrix[1, 1], matrix[5, 5] = first, second, yaw
    return matrix.tobytes()
