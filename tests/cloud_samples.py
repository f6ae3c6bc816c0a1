"""PointCloud2 messages of a rotating laser with several rings in a room, made point by point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbag_samples import HUMBLE, Message, ns

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
NUMBERS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
ROOM = (-4.0, 6.0, -3.0, 5.0)
"""[m] x and y of the walls of the room, which is 4 m high."""


def wall_distance(x: Any, y: Any, direction: Any) -> Any:
    """Distance along the floor to the walls of `ROOM`, in closed form."""
    c, s = np.cos(direction), np.sin(direction)
    with np.errstate(divide="ignore"):
        to_x = np.where(c > 0, (ROOM[1] - x) / c, (ROOM[0] - x) / c)
        to_y = np.where(s > 0, (ROOM[3] - y) / s, (ROOM[2] - y) / s)
    return np.minimum(to_x, to_y)


@dataclass(frozen=True, kw_only=True)
class Spinner:
    """A rotating laser with rings."""

    rings: Sequence[float] = (-3.0, -1.0, 1.0, 3.0)
    """[deg] elevations."""
    n: int = 720
    """Firings per turn."""
    period: float = 0.1
    sign: int = -1
    start: float = 0.7
    """[rad] bearing of the first firing."""
    drift: float = 0.0
    """[rad] by which each cloud starts later."""
    height: float = 0.4
    v: float = 0.0
    """[m/s] of the robot along x, from the origin."""


def sweep(laser: Spinner, k: int) -> dict[str, np.ndarray]:
    """Return the points of cloud k, in the order of their times; ring by ring at each firing."""
    turn = laser.n + round(laser.drift / (2 * np.pi) * laser.n)
    firing = np.arange(turn)
    first = laser.start + laser.sign * k * 2 * np.pi * turn / laser.n
    bearing = first + laser.sign * 2 * np.pi * firing / laser.n
    after = laser.period * firing / laser.n
    time = k * laser.period * turn / laser.n + after
    out: dict[str, list[np.ndarray]] = {name: [] for name in ("x", "y", "z", "ring", "t", "intensity")}
    distance = wall_distance(laser.v * time, 0.0, bearing + 1e-9)  # no ray is parallel to a wall
    for number, degrees in enumerate(laser.rings):
        out["x"].append(distance * np.cos(bearing))
        out["y"].append(distance * np.sin(bearing))
        out["z"].append(distance * np.tan(np.radians(degrees)))
        out["ring"].append(np.full(turn, number))
        out["t"].append(after)
        out["intensity"].append(10 * distance)
    return {name: np.stack(parts, axis=1).ravel() for name, parts in out.items()}


def cloud(
    stamp: float, columns: dict[str, np.ndarray], kinds: dict[str, str], *, topic: str = "/points",
    frame: str = "velodyne", height: int = 1, pad: int = 0, big: bool = False, row_pad: int = 0, row_step: int | None = None,
) -> Message:  # fmt: skip
    """Pack points; `pad` bytes follow each point, `row_pad` each row."""
    order = ">" if big else "<"
    offsets, size = {}, 0
    for name, kind in kinds.items():
        offsets[name] = size
        size += np.dtype(kind).itemsize
    size += pad
    n = len(next(iter(columns.values())))
    points = np.zeros(
        n, dtype=np.dtype({"names": list(kinds), "formats": [order + k for k in kinds.values()],
                           "offsets": list(offsets.values()), "itemsize": size})
    )  # fmt: skip
    for name in kinds:
        points[name] = columns[name]
    rows = points.view(np.uint8).reshape(height, -1)
    data = np.pad(rows, ((0, 0), (0, row_pad))).ravel()
    types = HUMBLE.types
    at = ns(stamp)
    head = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9), frame_id=frame
    )
    field = types["sensor_msgs/msg/PointField"]
    message = types[CLOUD_TYPE](
        header=head, height=height, width=n // height,
        fields=[field(name=name, offset=offsets[name], datatype=NUMBERS[kind], count=1) for name, kind in kinds.items()],
        is_bigendian=big, point_step=size, row_step=size * (n // height) + row_pad if row_step is None else row_step, data=data, is_dense=True,
    )  # fmt: skip
    return topic, CLOUD_TYPE, at, bytes(HUMBLE.serialize_cdr(message, CLOUD_TYPE))


KINDS = {"x": "f4", "y": "f4", "z": "f4", "intensity": "f4", "ring": "u2", "t": "u4"}


def spin(laser: Spinner, n_clouds: int, *, unit: float = 1e-9, kinds: dict[str, str] = KINDS, **options: Any) -> list[Message]:  # fmt: skip
    """Clouds of a rotating laser; their times are in this unit [s]."""
    out, at = [], 0.0
    turn = laser.n + round(laser.drift / (2 * np.pi) * laser.n)
    for k in range(n_clouds):
        columns = sweep(laser, k)
        columns["t"] = columns["t"] / unit
        columns["time"] = columns["timestamp"] = columns["t"]
        out.append(cloud(at, columns, kinds, **options))
        at += laser.period * turn / laser.n
    return out
