"""Messages as bytes, in the layout of ROS 1 and in CDR of ROS 2; definitions of their types."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.fuzz.structure.draft import EPOCH, Item

PACKAGES = {
    "sensor_msgs": ("LaserScan", "MultiEchoLaserScan", "PointCloud2", "Range", "Imu"),
    "geometry_msgs": (
        "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Twist", "TwistStamped", "PointStamped",
    ),
    "nav_msgs": ("Odometry", "OccupancyGrid", "Path"),
    "tf2_msgs": ("TFMessage",),
    "std_msgs": ("String", "Float64"),
}  # fmt: skip
CODES = {"f4": 7, "f8": 8, "u1": 2, "u2": 4, "u4": 6, "i1": 1, "i2": 3, "i4": 5}
"""Numpy type -> datatype of a PointField."""
UNITS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")


def full(kind: str, *, ros1: bool = False) -> str:
    """Return the full name of a type; unknown kinds are full names already."""
    package = next((name for name, kinds in PACKAGES.items() if kind in kinds), None)
    name = kind if package is None else f"{package}/msg/{kind}"
    if ros1:
        name = name.replace("/msg/", "/")
    return name


def nanoseconds(at: float) -> int:
    """Return ROS time [ns] of a time since EPOCH."""
    whole = np.floor(at)
    return int(EPOCH + whole) * 10**9 + round((at - whole) * 1e9)


class Packer:
    """Appends values; CDR aligns each to its size."""

    def __init__(self, *, ros1: bool) -> None:
        self.ros1 = ros1
        self.data = bytearray()

    def align(self, size: int) -> None:
        if not self.ros1:
            self.data += b"\0" * (-len(self.data) % size)

    def number(self, kind: str, *values: Any) -> None:
        self.align(struct.calcsize(kind))
        self.data += struct.pack(f"<{len(values)}{kind}", *values)

    def text(self, value: str) -> None:
        raw = value.encode() + (b"" if self.ros1 else b"\0")
        self.number("I", len(raw))
        self.data += raw

    def array(self, kind: str, values: Any, *, sized: bool = True) -> None:
        raw = np.asarray(values, dtype=f"<{kind}")
        if sized:
            self.number("I", raw.size)
        if raw.size:
            self.align(raw.itemsize)
            self.data += raw.tobytes()

    def header(self, stamp: float, frame: str) -> None:
        if self.ros1:
            self.number("I", 7)
        self.time(stamp)
        self.text(frame)

    def time(self, stamp: float) -> None:
        sec, nanosec = divmod(nanoseconds(stamp), 10**9)
        self.number("I", sec % 2**32)
        self.number("I", nanosec)

    def bytes(self) -> bytes:
        return bytes(self.data) if self.ros1 else b"\0\1\0\0" + bytes(self.data)


def _scan(p: Packer, c: dict[str, Any]) -> None:
    p.array("f4", [c[name] for name in UNITS], sized=False)


def _laser_scan(p: Packer, c: dict[str, Any]) -> None:
    _scan(p, c)
    p.array("f4", c["ranges"])
    p.array("f4", c["intensities"])


def _multi_echo(p: Packer, c: dict[str, Any]) -> None:
    _scan(p, c)
    for name in ("ranges", "intensities"):
        p.number("I", len(c[name]))
        for echoes in c[name]:
            p.array("f4", echoes)


def _odometry(p: Packer, c: dict[str, Any]) -> None:
    p.text(c["child"])
    for name in ("pose", "twist"):
        p.array("f8", c[name], sized=False)
        p.array("f8", c.get(name + "_covariance", np.zeros(36)), sized=False)


def _cloud(p: Packer, c: dict[str, Any]) -> None:
    points: NDArray[Any] = c["points"]
    kinds = points.dtype.fields
    assert kinds is not None
    p.number("I", c["height"], len(points) // c["height"])
    p.number("I", len(kinds))
    for name, (kind, offset, *_) in kinds.items():
        p.text(name)
        p.number("I", offset)
        p.number("B", CODES[kind.str[1:]])
        p.number("I", 1)
    p.number("B", int(c.get("big", False)))
    p.number("I", points.dtype.itemsize, points.nbytes // c["height"])
    p.array("u1", points.view(np.uint8) if len(points) else [])
    p.number("B", 1)


def _grid(p: Packer, c: dict[str, Any]) -> None:
    p.time(0.0)
    p.number("f", c["resolution"])
    p.number("I", *c["data"].shape[::-1])
    p.array("f8", c["origin"], sized=False)
    p.array("i1", c["data"])


def _path(p: Packer, c: dict[str, Any]) -> None:
    p.number("I", len(c["poses"]))
    for pose in c["poses"]:
        p.header(0.0, "map")
        p.array("f8", pose, sized=False)


def _range(p: Packer, c: dict[str, Any]) -> None:
    p.number("B", 0)
    p.array("f4", [c[name] for name in ("field_of_view", "min_range", "max_range", "range")], sized=False)


def _imu(p: Packer, c: dict[str, Any]) -> None:
    p.array(
        "f8",
        [0, 0, 0, 1, *np.zeros(9), 0, 0, c["omega"], *np.zeros(9), 0, 0, 9.81, *np.zeros(9)],
        sized=False,
    )


def _columns(*names: str) -> Any:
    def pack(p: Packer, c: dict[str, Any]) -> None:
        for name in names:
            p.array("f8", c[name], sized=False)

    return pack


def _transform_stamped(p: Packer, c: dict[str, Any]) -> None:
    p.text(c["child"])
    p.array("f8", c["pose"], sized=False)


BODIES: dict[str, Any] = {
    "LaserScan": _laser_scan, "MultiEchoLaserScan": _multi_echo, "PointCloud2": _cloud, "Range": _range, "Imu": _imu,
    "Odometry": _odometry, "OccupancyGrid": _grid, "Path": _path, "TransformStamped": _transform_stamped,
    "PoseStamped": _columns("pose"), "PoseWithCovarianceStamped": _columns("pose", "covariance"),
    "TwistStamped": _columns("twist"), "PointStamped": _columns("point"),
}  # fmt: skip
"""Kinds with a header -> what follows it."""


def payload(item: Item, *, ros1: bool) -> bytes:
    """Return a message as bytes."""
    p, c = Packer(ros1=ros1), item.content
    if "payload" in c:
        p.data += c["payload"]
    elif item.kind == "TFMessage":
        p.number("I", len(c["transforms"]))
        for parent, child, value in c["transforms"]:
            p.header(item.stamp, parent)
            p.text(child)
            p.array("f8", value, sized=False)
    elif item.kind == "Twist":
        p.array("f8", c["twist"], sized=False)
    elif item.kind == "String":
        p.text(c["text"])
    elif item.kind == "Float64":
        p.array("f8", [c["value"]], sized=False)
    else:
        p.header(item.stamp, item.frame)
        BODIES[item.kind](p, c)
    return p.bytes()


@cache
def _store(ros1: bool) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return store


@cache
def definition(kind: str, own: str, *, ros1: bool) -> tuple[str, str]:
    """Return the definition of a type and its MD5 sum (ROS 1) or hash; `own` is that of a type of no typestore."""
    if own:
        return own, "0" * 32
    text, digest = _store(ros1).generate_msgdef(full(kind), ros_version=1 if ros1 else 2)
    return text, digest
