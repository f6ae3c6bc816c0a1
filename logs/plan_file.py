"""Write plan.mcap: a planned path and its coverage, for ROS 2 tools and Foxglove."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from logs.formats.mcap_file import RosFile
from logs.ros.definitions import header, message, serialized
from logs.ros.messages import GRID_TYPE, map_message
from logs.ros.recording import POSE_TYPE
from logs.run import OccupancyMap
from logs.types import Floats

PATH_TYPE = "nav_msgs/msg/Path"
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
    with RosFile(Path(path)) as file:
        for topic, grid in (("/map", occupancy), ("/coverage", coverage)):
            if grid is not None:
                at = np.array([epoch_ns], dtype=np.int64)
                file.put(file.channel(topic, GRID_TYPE), epoch_ns, map_message(at, grid).tobytes())
        chosen = thin(poses)
        places = [
            message(POSE_TYPE, header=header(epoch_ns + round(t * 1e9)), pose=_pose(*pose))
            for t, pose in zip(stamps[chosen].tolist(), poses[chosen].tolist(), strict=True)
        ]
        path_message = serialized(PATH_TYPE, header=header(epoch_ns), poses=places)
        file.put(file.channel("/plan", PATH_TYPE), epoch_ns, path_message)
        for name, data in (attachments or {}).items():
            file.attach(name, data, epoch_ns)


def _pose(x: float, y: float, phi: float) -> Any:
    turn = message("geometry_msgs/msg/Quaternion", z=np.sin(phi / 2), w=np.cos(phi / 2))
    return message(
        "geometry_msgs/msg/Pose", position=message("geometry_msgs/msg/Point", x=x, y=y), orientation=turn
    )
