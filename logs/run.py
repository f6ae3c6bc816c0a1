"""Run: the data model of a recording. Other modules of `logs` read and write the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from logs.arguments import check_scan, convert_lists, numbers_of
from logs.html_table import html_table
from logs.motion import motion_of
from logs.run_figure import run_figure
from logs.sensor import RARE_TIMES as RARE_TIMES
from logs.sensor import PoseFrame as PoseFrame
from logs.sensor import RangeSensor as RangeSensor
from logs.sensor import rare_times as rare_times
from logs.sensor import with_rare_times as with_rare_times
from logs.types import Bools, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class OccupancyMap:
    """An occupancy-grid map of free, occupied and unknown cells."""

    data: NDArray[np.int8]
    """(ny, nx) -1: unknown, 0: free, 100: occupied; row 0 has the lowest y."""
    resolution: float
    """[m] side length of a cell."""
    origin: Floats
    """(3,) [m, m, rad] pose in map of the lower left corner of cell (0, 0)."""

    def __post_init__(self) -> None:
        if self.data.ndim != 2 or self.data.dtype != np.int8 or self.data.min(initial=0) < -1:
            raise ValueError(
                f"data has shape {self.data.shape} and type {self.data.dtype}, expected (ny, nx) int8 from -1 to 100"
            )
        if self.origin.shape != (3,) or not self.resolution > 0:
            raise ValueError(
                f"origin has shape {self.origin.shape} and resolution is {self.resolution}, "
                "expected (3,) and a positive number"
            )


def twins(stamps: Floats, pose_stamps: Floats) -> NDArray[np.intp]:
    """Return the index (n_scans,) of the pose with the same stamp as each scan, or -1.

    If as many poses as scans share one stamp, the k-th pose belongs to the k-th scan. Otherwise there is no such pose.
    """
    first = np.searchsorted(pose_stamps, stamps, side="left")
    n_poses = np.searchsorted(pose_stamps, stamps, side="right") - first
    before = np.searchsorted(stamps, stamps, side="left")
    n_scans = np.searchsorted(stamps, stamps, side="right") - before
    rank = np.arange(len(stamps)) - before
    return np.where(n_poses == n_scans, first + rank, -1)


def _empty(*shape: int) -> Floats:
    return np.zeros(shape, dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Run:
    """One recorded or simulated drive; every signal has its own stamps, in seconds from `epoch_ns`."""

    sensor: RangeSensor
    stamps: Floats
    """(n_scans,) [s] time of the first ray of each scan, not decreasing."""
    ranges: Floats
    """(n_scans, n_rays) [m]; +inf: missing return, -inf: too close, nan: invalid reading (REP-117)."""
    intensities: Floats = field(default_factory=lambda: _empty(0, 0))
    """(n_scans, n_rays) strength of each return in the unit of the driver, nan: unknown; (0, n_rays): not recorded.

    They are dropped if `ranges` is replaced by an array of another shape; `take_scans` keeps them."""
    pose_stamps: Floats = field(default_factory=lambda: _empty(0))
    poses: Floats = field(default_factory=lambda: _empty(0, 3))
    """(n_poses, 3) [m, m, rad] reference pose of `pose_frame` in map."""
    pose_covariances: Floats = field(default_factory=lambda: _empty(0, 3, 3))
    """(n_poses, 3, 3) covariance of x, y, phi in map [m, m, rad]; default (0, 3, 3): unknown."""
    odom_stamps: Floats = field(default_factory=lambda: _empty(0))
    odometry: Floats = field(default_factory=lambda: _empty(0, 3))
    """(n_odom, 3) [m, m, rad] base_link in odom (drifts)."""
    odom_twists: Floats = field(default_factory=lambda: _empty(0, 2))
    """(n_odom, 2) [m/s, rad/s] twist measured by the wheels."""
    cmd_stamps: Floats = field(default_factory=lambda: _empty(0))
    commands: Floats = field(default_factory=lambda: _empty(0, 2))
    """(n_commands, 2) [m/s, rad/s] commanded twist."""
    pose_frame: PoseFrame = "base_link"
    """Frame whose pose `poses` holds; `laser` in corrected CARMEN logs."""
    epoch_ns: int = 0
    """[ns] absolute time of stamp 0 (Unix)."""
    meta: Mapping[str, str] = field(default_factory=dict)
    """Origin of the run as plain text: `source`, `format`, `pose_source`, ..."""
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    """File name -> bytes: `arena.geojson`, `robot.yaml`, `plan.json`, ..."""

    def __post_init__(self) -> None:
        convert_lists(
            self, "stamps", "ranges", "intensities", "pose_stamps", "poses", "pose_covariances", "odom_stamps", "odometry",
            "odom_twists", "cmd_stamps", "commands",
        )  # fmt: skip
        n_scans = len(self.stamps)
        if self.ranges.shape != (n_scans, self.sensor.n_rays):
            raise ValueError(
                f"ranges has shape {self.ranges.shape}, expected ({n_scans}, {self.sensor.n_rays})"
            )
        if self.intensities.shape != self.ranges.shape:
            object.__setattr__(self, "intensities", _empty(0, self.sensor.n_rays))
        for name, stamps, data, width in (
            ("poses", self.pose_stamps, self.poses, 3),
            ("odometry", self.odom_stamps, self.odometry, 3),
            ("odom_twists", self.odom_stamps, self.odom_twists, 2),
            ("commands", self.cmd_stamps, self.commands, 2),
        ):
            if data.shape != (len(stamps), width):
                raise ValueError(f"{name} has shape {data.shape}, expected ({len(stamps)}, {width})")
        if self.pose_covariances.shape not in ((0, 3, 3), (len(self.poses), 3, 3)):
            raise ValueError(
                f"pose_covariances has shape {self.pose_covariances.shape}, expected ({len(self.poses)}, 3, 3), or "
                "(0, 3, 3) if unknown"
            )
        for name in ("stamps", "pose_stamps", "odom_stamps", "cmd_stamps"):
            if not (np.diff(getattr(self, name)) >= 0).all():
                raise ValueError(
                    f"{name} goes back in time or is not finite; sort the signals of the run by time"
                )

    @property
    def n_scans(self) -> int:
        """Number of scans."""
        return len(self.stamps)

    def take_scans(self, index: Bools | NDArray[np.intp] | slice) -> Run:
        """Return the run with a subset of its scans; poses, odometry and commands stay complete."""
        intensities = self.intensities[index] if len(self.intensities) else self.intensities
        return replace(self, stamps=self.stamps[index], ranges=self.ranges[index], intensities=intensities)

    @property
    def duration(self) -> float:
        """[s] from the first to the last stamp of all signals; 0 without stamps."""
        signals = (self.stamps, self.pose_stamps, self.odom_stamps, self.cmd_stamps)
        ends = [(float(stamps[0]), float(stamps[-1])) for stamps in signals if len(stamps)]
        return max(last for _, last in ends) - min(first for first, _ in ends) if ends else 0.0

    def poses_at(self, stamps: ArrayLike) -> Floats:
        """Return the poses (..., 3) [m, m, rad] of `pose_frame` in map at times (...) [s]; outside the run, the nearest.

        Raises
        ------
        ValueError : The times are no numbers, or the run has no finite reference pose.
        """
        poses = motion_of(self).at(numbers_of(stamps, "stamps"))
        poses[..., 2] = np.pi - (np.pi - poses[..., 2]) % (2 * np.pi)
        return poses

    def ray_poses(self, scan: int) -> Floats:
        """Return the pose (n_rays, 3) [m, m, rad] of `pose_frame` in map at the time of each ray of one scan.

        Raises
        ------
        ValueError : `scan` is not a whole number, or the run has no finite reference pose.
        IndexError : The run has no such scan.
        """
        check_scan(scan, self.n_scans)
        return self.poses_at(self.stamps[scan] + np.broadcast_to(self.sensor.ray_delays, self.sensor.n_rays))

    def plot(self, scan: int | None = None) -> Any:
        """Draw the path and the end points of all scans, or of one scan, in a figure of matplotlib.

        Raises
        ------
        ValueError : `scan` is not a whole number.
        IndexError : The run has no such scan.
        """
        return run_figure(self, scan)

    def __repr__(self) -> str:
        """Summarise the contents and the source of the poses in a few lines."""
        sensor = self.sensor
        first, last = np.degrees(sensor.bearings[[0, -1]])
        pose_source = self.meta.get("pose_source", "the reference")
        signals = (
            f"{len(self.poses):,} poses of {self.pose_frame} from {pose_source}" if len(self.poses) else "",
            f"{len(self.odometry):,} odometry" if len(self.odometry) else "",
            f"{len(self.commands):,} commands" if len(self.commands) else "",
            f"attached {', '.join(self.attachments)}" if self.attachments else "",
        )
        source = self.meta.get("source", "")
        return (
            f"Run{f' of {source}' if source else ''}: {self.n_scans:,} scans of {sensor.n_rays} rays, "
            f"{self.duration:.1f} s\n"
            f"  rays from {first:.1f} to {last:.1f} deg, {sensor.range_min:g} to {sensor.range_max:g} m\n"
            f"  {'; '.join(filter(None, signals)) or 'only scans, no poses'}"
        )

    def _repr_html_(self) -> str:
        """Return the notebook view: the signals of the run and their sizes."""
        sensor = self.sensor
        first, last = np.degrees(sensor.bearings[[0, -1]])
        source = self.meta.get("source", "")
        rows = [
            ("scans", f"{self.n_scans:,}", f"{sensor.n_rays} rays, {first:.1f}° to {last:.1f}°"),
            (
                "poses",
                f"{len(self.poses):,}",
                f"{self.pose_frame}, {self.meta.get('pose_source', 'reference')}",
            ),
            ("odometry", f"{len(self.odometry):,}", ""),
            ("commands", f"{len(self.commands):,}", ""),
            ("attachments", f"{len(self.attachments):,}", ", ".join(self.attachments)),
        ]
        return html_table(f"Run{f' of {source}' if source else ''}, {self.duration:.1f} s", rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairing:
    """The scans that have a pose, and the reasons why the others have none."""

    poses: Floats
    """(n_scans, 3) [m, m, rad] reference pose at the stamp of each scan; nan if not paired."""
    paired: Bools
    """(n_scans,) whether the scan has a pose."""
    dropped: Mapping[str, int]
    """Reason -> number of scans without a pose for that reason."""

    def __str__(self) -> str:
        reasons = "".join(f", {count:,} {reason}" for reason, count in self.dropped.items())
        return f"{int(self.paired.sum()):,} of {len(self.paired):,} scans paired with poses{reasons}"


@np.errstate(over="ignore", invalid="ignore")  # poses that are not finite are dropped and counted below
def pair(run: Run, *, max_gap: float = 0.2, whole_sweep: bool = True) -> Pairing:
    """Interpolate the reference pose at the stamp of every scan, but not across a gap above `max_gap` [s].

    A scan with the stamp of a pose is paired regardless of gaps. If as many scans as poses share one stamp, they are
    paired in order. With `whole_sweep`, the poses must cover the times of all rays of a sweep. `logs.motion.ray_poses`
    returns the pose of each ray.
    """
    n_scans = run.n_scans
    poses = np.full((n_scans, 3), np.nan)
    if len(run.pose_stamps) == 0:
        return Pairing(
            poses=poses, paired=np.zeros(n_scans, dtype=np.bool_), dropped={"without any pose": n_scans}
        )
    right = np.clip(np.searchsorted(run.pose_stamps, run.stamps, side="left"), 0, len(run.pose_stamps) - 1)
    left = np.clip(np.where(run.pose_stamps[right] > run.stamps, right - 1, right), 0, None)
    twin = twins(run.stamps, run.pose_stamps)
    left, right = np.where(twin >= 0, twin, left), np.where(twin >= 0, twin, right)
    before = run.stamps < run.pose_stamps[0]
    after = run.stamps > run.pose_stamps[-1]
    gap = (run.pose_stamps[right] - run.pose_stamps[left] > max_gap) & ~before & ~after
    width = run.pose_stamps[right] - run.pose_stamps[left]
    share = np.where(width > 0, (run.stamps - run.pose_stamps[left]) / np.where(width > 0, width, 1.0), 0.0)
    turn = np.pi - (np.pi - (run.poses[right, 2] - run.poses[left, 2])) % (2 * np.pi)
    poses[:, :2] = run.poses[left, :2] + share[:, None] * (run.poses[right, :2] - run.poses[left, :2])
    phi = run.poses[left, 2] + share * turn
    poses[:, 2] = np.pi - (np.pi - phi) % (2 * np.pi)
    delays = run.sensor.ray_delays if whole_sweep else np.zeros(1)
    late, early = run.stamps + delays.max(), run.stamps + delays.min()
    beyond = ~(before | after | gap) & ((late > run.pose_stamps[-1]) | (early < run.pose_stamps[0]))
    paired = ~(before | after | gap | beyond)
    broken = paired & ~np.isfinite(poses).all(axis=1)
    paired &= ~broken
    poses[~paired] = np.nan
    counts = {
        "before the first pose": int(before.sum()),
        "after the last pose": int(after.sum()),
        f"in a gap of the poses above {max_gap:g} s": int(gap.sum()),
        "sweeping beyond the poses": int(beyond.sum()),
        "at a pose that is not finite": int(broken.sum()),
    }
    return Pairing(poses=poses, paired=paired, dropped={k: v for k, v in counts.items() if v})
