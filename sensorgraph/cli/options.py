"""Arguments and options that several commands share; each command's own ones are in its file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Topics = Annotated[
    list[str] | None,
    typer.Option(metavar="ROLE=NAME", help="Topic to read for a role (scan, pose, odom, cmd); repeatable."),
]
RobotFile = Annotated[Path | None, typer.Option(help="robot.yaml; default: the shipped robot.")]
GraphFile = Annotated[Path, typer.Argument(metavar="GRAPH", help="Sensorgraph, *.sensorgraph.")]
TopicsByExample = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ROLE=NAME", help="Topic to read for a role, for example scan=/front/scan; repeatable."
    ),
]
RunFile = Annotated[
    Path, typer.Argument(metavar="RUN", help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")
]
Force = Annotated[bool, typer.Option("--force", help="Accept a run whose poses jump by metres.")]
RunRobot = Annotated[
    Path | None,
    typer.Option(
        "--robot",
        help="robot.yaml of the recording robot: the ray times and mounts that it states replace those of the log.",
    ),
]
NoReturn = Annotated[
    str | None,
    typer.Option(
        help="Value of a missing return in the log: range_max, zero, inf or nan; default: detected."
    ),
]
Slice = Annotated[
    str | None,
    typer.Option(
        "--slice",
        metavar="Z0,Z1",
        help="Read a point cloud as a laser: its points from Z0 to Z1 (m) above base_footprint, or else base_link. "
        "Default: the ring nearest the horizontal.",
    ),
]


def _check_poses(poses: str | None) -> str | None:
    from sensorgraph.errors import SensorgraphError

    if poses not in (None, "log", "locate"):
        raise SensorgraphError(
            f"--poses is {poses!r}, expected log (poses in the log) or locate (from scans and wheels)"
        )
    return poses


PosesFrom = Annotated[
    str | None,
    typer.Option(
        "--poses",
        callback=_check_poses,
        metavar="log|locate",
        help="log: use the poses in the log. locate: estimate them from scans and wheels. "
        "Default: locate if the log has no reference poses.",
    ),
]
Bearing = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="Select the ray by its bearing from the robot (degrees): 0 ahead, 90 to the left.",
    ),
]
