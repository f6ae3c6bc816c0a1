"""Write plan.mcap: a planned path and its coverage, for ROS 2 tools and Foxglove."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from logs.formats.mcap_file import RosFile
from logs.ros.definitions import typestore
from logs.ros.messages import map_message
from logs.run import OccupancyMap
from logs.types import Floats

PATH_TYPE, GRID_TYPE = "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid"
MAX_PATH_POSES = 5000
"""Maximum number of poses in the path message; viewers draw all of them."""


def thin(poses: Floats, most: int = MAX_PATH_POSES) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Select samples of a path (n, 3) at even steps of its length, including both ends; 1 rad counts as 10 cm."""
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T) + 0.1 * np.abs(np.diff(np.unwrap(poses[:, 2])))
    lengths = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, lengths[-1], min(most, len(poses)))
    return np.unique(
        np.append(np.searchsorted(lengths, wanted - 1e-12).clip(0, len(poses) - 1), len(poses) - 1)
    )


def write_plan(
    path: Path | str,
    stamps: Floats,
    poses: Floats,
    *,
    epoch_ns: int = 0,
    coverage: OccupancyMap | None = None,
    occupancy: OccupancyMap | None = None,
    attachments: Mapping[str, bytes] | None = None,
) -> None:
    """Write the latched topics /plan (nav_msgs/Path), /coverage (percentage of headings per cell) and /map.

    Parameters
    ----------
    stamps : (n,) [s]
    poses : (n, 3) [m, m, rad] base_link in map
    """
    store = typestore()
    types = store.types
    with RosFile(Path(path)) as file:
        for topic, grid in (("/map", occupancy), ("/coverage", coverage)):
            if grid is not None:
                at = np.array([epoch_ns], dtype=np.int64)
                file.put(file.channel(topic, GRID_TYPE), epoch_ns, map_message(at, grid).tobytes())
        chosen = thin(poses)
        message = types[PATH_TYPE](
            header=_header(types, epoch_ns),
            poses=[
                types["geometry_msgs/msg/PoseStamped"](
                    header=_header(types, epoch_ns + round(t * 1e9)), pose=_pose(types, *pose)
                )
                for t, pose in zip(stamps[chosen].tolist(), poses[chosen].tolist(), strict=True)
            ],
        )
        file.put(file.channel("/plan", PATH_TYPE), epoch_ns, bytes(store.serialize_cdr(message, PATH_TYPE)))
        for name, data in (attachments or {}).items():
            file.attach(name, data, epoch_ns)


def _header(types: Mapping[str, Any], ns: int) -> Any:
    time = types["builtin_interfaces/msg/Time"](sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
    return types["std_msgs/msg/Header"](stamp=time, frame_id="map")


def _pose(types: Mapping[str, Any], x: float, y: float, phi: float) -> Any:
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=np.sin(phi / 2), w=np.cos(phi / 2)),
    )
