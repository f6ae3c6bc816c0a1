"""What localisation finds: poses with covariances, where it is lost, loop closures, wheels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from logs.run import RangeSensor
from sensorgraph.types import Floats

Status = Literal["ok", "lost", "ambiguous"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Closure:
    """One place that the robot came back to, or seemed to."""

    first: int
    """Index of the earlier scan."""
    second: int
    """Index of the later scan."""
    relative: Floats
    """(3,) [m, m, rad] the later scan's base_link in the earlier one's."""
    inliers: float
    """Share of the later scan's points that lie on surfaces of the earlier place."""
    reason: str = ""
    """Why it was refused; empty: kept."""


@dataclass(frozen=True, kw_only=True)
class WheelParameters:
    """What the wheels' odometry must be corrected by: measured by the laser on the way."""

    way_scale: float = 1.0
    """True way per way of the odometry."""
    turn_scale: float = 1.0
    """True turn per turn of the odometry."""
    heading_bias: float = 0.0
    """[rad/m] turn that the odometry misses, per metre driven."""
    way_scale_sd: float = 0.0
    """Standard error of `way_scale`."""
    turn_scale_sd: float = 0.0
    """Standard error of `turn_scale`."""
    heading_bias_sd: float = 0.0
    """[rad/m] standard error of `heading_bias`."""

    def __str__(self) -> str:
        """Say it in one line."""
        return (
            f"way x {self.way_scale:.4f}, turn x {self.turn_scale:.4f}, "
            f"heading {np.degrees(self.heading_bias):+.2f} deg/m"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Localization:
    """Poses of all scans of a run in one map."""

    t: Floats
    """(n_scans,) [s] stamps of the scans."""
    poses: Floats
    """(n_scans, 3) [m, m, rad] base_link in map."""
    covariances: Floats
    """(n_scans, 3, 3) of x, y, phi in map [m, m, rad]; without a map relative to the mean of all poses (inner
    constraints): the map itself may lie anywhere."""
    status: tuple[Status, ...]
    """(n_scans,) ok, lost (the pose is the best guess) or ambiguous (other places fit as well)."""
    kept: tuple[Closure, ...] = ()
    """Loop closures that hold the map together."""
    refused: tuple[Closure, ...] = ()
    """Those that were not believed, and why."""
    wheels: WheelParameters | None = None
    """None: no odometry, or none that could be used."""
    rivals: dict[int, Floats] = field(default_factory=dict)
    """Scan -> (n, 3) other places that fit as well, of those that are ambiguous."""
    notes: tuple[str, ...] = ()
    """What a user should know, one line each."""
    sensor: RangeSensor | None = None
    """That of the run, with the times of its rays as they were found; None: as the run says."""

    def __post_init__(self) -> None:
        n = len(self.t)
        if self.poses.shape != (n, 3) or self.covariances.shape != (n, 3, 3) or len(self.status) != n:
            raise ValueError(
                f"poses {self.poses.shape}, covariances {self.covariances.shape} and {len(self.status)} states, "
                f"expected ({n}, 3), ({n}, 3, 3) and {n}"
            )


def stretch_notes(stamps: Floats, status: tuple[Status, ...], *words: Status) -> tuple[str, ...]:
    """Say from when to when the scans are in one of some states."""
    notes: list[str] = []
    start = 0
    for k in range(1, len(status) + 1):
        if k == len(status) or status[k] != status[start]:
            if status[start] in words:
                notes.append(f"{status[start]} from {stamps[start]:.1f} s to {stamps[k - 1]:.1f} s")
            start = k
    return tuple(notes)
