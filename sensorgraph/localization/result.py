"""Result of localization: poses with covariances and status, loop closures, wheel parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from logs.run import RangeSensor
from sensorgraph.types import Bools, Floats, Ints

Status = Literal["ok", "lost", "ambiguous"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Closure:
    """One place that the robot revisited, or seemed to revisit."""

    first: int
    """Index of the earlier scan."""
    second: int
    """Index of the later scan."""
    relative: Floats
    """(3,) [m, m, rad] base_link of the later scan in that of the earlier one."""
    inliers: float
    """Share of the later scan's points that lie on surfaces of the earlier place."""
    reason: str = ""
    """Reason for rejection; empty if kept."""


@dataclass(frozen=True, kw_only=True)
class WheelParameters:
    """Corrections of the wheel odometry, identified from the laser."""

    way_scale: float = 1.0
    """True distance per distance of the odometry."""
    turn_scale: float = 1.0
    """True turn per turn of the odometry."""
    heading_bias: float = 0.0
    """[rad/m] Turn that the odometry misses, per metre driven."""
    way_scale_sd: float = 0.0
    """Standard error of `way_scale`."""
    turn_scale_sd: float = 0.0
    """Standard error of `turn_scale`."""
    heading_bias_sd: float = 0.0
    """[rad/m] standard error of `heading_bias`."""

    @property
    def deviations(self) -> Floats:
        """(3,) Standard errors of distance scale, turn scale and heading bias."""
        return np.array([self.way_scale_sd, self.turn_scale_sd, self.heading_bias_sd])

    def at_least(self, deviations: Floats) -> WheelParameters:
        """Return the parameters with standard errors that are at least `deviations` (3,)."""
        way, turn, bias = (float(sd) for sd in np.maximum(self.deviations, deviations))
        return replace(self, way_scale_sd=way, turn_scale_sd=turn, heading_bias_sd=bias)

    def __str__(self) -> str:
        """Return the parameters in one line."""
        return (
            f"distance scale {self.way_scale:.4f} ± {self.way_scale_sd:.4f}, "
            f"turn scale {self.turn_scale:.4f} ± {self.turn_scale_sd:.4f}, "
            f"heading bias {np.degrees(self.heading_bias):+.2f} ± {np.degrees(self.heading_bias_sd):.2f} deg/m"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Localization:
    """Poses of all scans of a run in one map."""

    t: Floats
    """(n_scans,) [s] Stamps of the scans."""
    poses: Floats
    """(n_scans, 3) [m, m, rad] base_link in map."""
    covariances: Floats
    """(n_scans, 3, 3) Covariances of x, y, phi in map [m, m, rad]. Without a map they are relative to the
    mean of all poses (inner constraints), since the frame of the map is arbitrary."""
    status: tuple[Status, ...]
    """(n_scans,) ok, lost (no pose in the first map is known) or ambiguous (other places fit equally well)."""
    maps: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """(n_scans,) Number of the map of each pose; 0: none. Map 1 is the largest; poses of others are in a frame of their
    own, as nothing connects them to it. Empty: all are in map 1."""
    kept: tuple[Closure, ...] = ()
    """Loop closures of the map."""
    refused: tuple[Closure, ...] = ()
    """Rejected loop closures, with the reason."""
    wheels: WheelParameters | None = None
    """Wheel parameters; None without usable odometry."""
    rivals: dict[int, Floats] = field(default_factory=dict)
    """Scan -> (n, 3) other places that fit equally well, for ambiguous scans."""
    notes: tuple[str, ...] = ()
    """Notes for the user, one line each."""
    sensor: RangeSensor | None = None
    """Sensor of the run with the identified ray times; None: unchanged."""
    range_offset: float = 0.0
    """[m] What the ranges are too long by, as the run shows; the poses are those of corrected ranges."""

    def __post_init__(self) -> None:
        n = len(self.t)
        if self.poses.shape != (n, 3) or self.covariances.shape != (n, 3, 3) or len(self.status) != n:
            raise ValueError(
                f"poses has shape {self.poses.shape}, covariances {self.covariances.shape}, status {len(self.status)} "
                f"entries; expected ({n}, 3), ({n}, 3, 3) and {n}"
            )

    @property
    def map_numbers(self) -> Ints:
        """(n_scans,) `maps`; without these, 1 for each scan that is not lost."""
        if len(self.maps):
            return self.maps
        return np.array([int(word != "lost") for word in self.status], dtype=np.intp)


def true_intervals(flags: Bools) -> list[tuple[int, int]]:
    """Return first and end of each interval of true flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def stretches_of(status: Sequence[Status]) -> list[tuple[Status, int, int]]:
    """Return status, first and end of each stretch of scans with one status."""
    cuts = [0, *(k for k in range(1, len(status)) if status[k] != status[k - 1]), len(status)]
    return [(status[a], a, b) for a, b in pairwise(cuts) if a < b]


def interval_notes(stamps: Floats, status: tuple[Status, ...], *words: Status) -> tuple[str, ...]:
    """Return one note for each time interval in which the scans have one of the given states."""
    notes = [
        f"{word} from {stamps[a]:.1f} s to {stamps[b - 1]:.1f} s"
        for word, a, b in stretches_of(status)
        if word in words
    ]
    return tuple(notes)
