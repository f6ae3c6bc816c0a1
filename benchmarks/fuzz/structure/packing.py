"""Messages as bytes of ROS 1 and of ROS 2 by rosbags, from values in the order of their fields; definitions of their types."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.fuzz.structure.draft import EPOCH, Item

CODES = {"f4": 7, "f8": 8, "u1": 2, "u2": 4, "u4": 6, "i1": 1, "i2": 3, "i4": 5}
"""Numpy type -> datatype of a PointField."""
UNITS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
TIME, SEQ = "builtin_interfaces/msg/Time", "seq"


@cache
def full(kind: str, *, ros1: bool = False) -> str:
    """Return the full name of a type; one that no typestore has is a full name already."""
    name = next((name for name in _store(False).types if name.endswith(f"/{kind}")), kind)
    return name.replace("/msg/", "/") if ros1 else name


def nanoseconds(at: float) -> int:
    """Return ROS time [ns] of a time since EPOCH."""
    whole = np.floor(at)
    return int(EPOCH + whole) * 10**9 + round((at - whole) * 1e9)


def _columns(*names: str) -> Callable[[dict[str, Any]], list[Any]]:
    """Return what takes numbers of a message from arrays of its content."""
    return lambda c: [number for name in names for number in c[name]]


def _odometry(c: dict[str, Any]) -> list[Any]:
    none = np.zeros(36)
    pose, twist = c.get("pose_covariance", none), c.get("twist_covariance", none)
    return [c["child"], *c["pose"], pose, *c["twist"], twist]


def _cloud(c: dict[str, Any]) -> list[Any]:
    points: NDArray[Any] = c["points"]
    kinds = points.dtype.fields
    assert kinds is not None
    fields = [[name, offset, CODES[kind.str[1:]], 1] for name, (kind, offset, *_) in kinds.items()]
    n, row = len(points) // c["height"], points.nbytes // c["height"]
    data = points.view(np.uint8) if len(points) else []
    return [c["height"], n, fields, c.get("big", False), points.dtype.itemsize, row, data, True]


def _imu(c: dict[str, Any]) -> list[Any]:
    none = np.zeros(9)
    return [0, 0, 0, 1, none, 0, 0, c["omega"], none, 0, 0, 9.81, none]


VALUES: dict[str, Callable[[dict[str, Any]], list[Any]]] = {
    "LaserScan": lambda c: [*(c[name] for name in UNITS), c["ranges"], c["intensities"]],
    "MultiEchoLaserScan": lambda c: [
        *(c[name] for name in UNITS), *([[echoes] for echoes in c[name]] for name in ("ranges", "intensities")),
    ],
    "PointCloud2": _cloud, "Odometry": _odometry, "Imu": _imu,
    "Range": lambda c: [0, *(c[name] for name in ("field_of_view", "min_range", "max_range", "range"))],
    "OccupancyGrid": lambda c: [0.0, c["resolution"], *c["data"].shape[::-1], *c["origin"], c["data"].ravel()],
    "Path": lambda c: [[[0.0, "map", *pose] for pose in c["poses"]]],
    "TransformStamped": lambda c: [c["child"], *c["pose"]],
    "PoseStamped": _columns("pose"), "TwistStamped": _columns("twist"),
    "PoseWithCovarianceStamped": lambda c: [*c["pose"], c["covariance"]],
}  # fmt: skip
"""Kinds with a header -> the values of the fields that follow it, nested ones in their order."""


def _values(item: Item) -> list[Any]:
    """Return the values of all fields; a list holds those of the messages of a sequence."""
    c = item.content
    if item.kind == "TFMessage":
        return [[[item.stamp, parent, child, *value] for parent, child, value in c["transforms"]]]
    if item.kind in ("Twist", "String"):
        return list(c["twist"]) if item.kind == "Twist" else list(c.values())
    return [item.stamp, item.frame, *VALUES[item.kind](c)]


def payload(item: Item, *, ros1: bool) -> bytes:
    """Return a message as bytes."""
    if "payload" in item.content:
        return (b"" if ros1 else b"\0\1\0\0") + bytes(item.content["payload"])
    store, name = _store(ros1), full(item.kind)
    message = _made(store, name, iter(_values(item)))
    return bytes(store.serialize_ros1(message, name) if ros1 else store.serialize_cdr(message, name))


def _made(store: Any, name: str, values: Iterator[Any]) -> Any:
    """Return a message of rosbags from the next values."""
    if name == TIME:
        sec, nanosec = divmod(nanoseconds(next(values)), 10**9)
        return store.types[name](sec=(sec + 2**31) % 2**32 - 2**31, nanosec=nanosec)
    made = {}
    for field, (node, detail) in store.fielddefs[name][1]:
        if node == Nodetype.NAME:
            made[field] = _made(store, detail, values)
        elif field == SEQ:
            made[field] = 7
        elif node == Nodetype.BASE:
            made[field] = next(values)
        else:
            made[field] = _sequence(store, detail[0], next(values))
    return store.types[name](**made)


def _sequence(store: Any, of: tuple[Any, Any], values: Iterable[Any]) -> Any:
    node, detail = of
    if node == Nodetype.NAME:
        return [_made(store, detail, iter(each)) for each in values]
    return np.asarray(values, dtype=detail[0])


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
