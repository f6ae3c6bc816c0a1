"""RangeSensor and Run: the data model of a recording. Other modules of `logs` read and write the files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from logs.html_table import html_table
from logs.twins import twins
from logs.types import Bools, Floats

PoseFrame = Literal["base_link", "laser"]
RARE_TIMES: Mapping[str, int | float] = {"interlaced_sweeps": 1, "sweep_period": 0.0, "first_ray_delay": 0.0}
"""Fields of `RangeSensor` that files contain only if they differ from these defaults."""


def _empty(*shape: int) -> Floats:
    return np.zeros(shape, dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class RangeSensor:
    """Geometry, limits and timing of a planar range sensor."""

    bearings: Floats
    """(n_rays,) [rad] in the laser frame, increasing (counter-clockwise); ray 0 is the rightmost one."""
    range_min: float = 0.05
    """[m] a closer surface gives -inf."""
    range_max: float = 8.0
    """[m] a ray without a surface up to this range gives +inf."""
    mount: Floats = field(default_factory=lambda: _empty(3))
    """(3,) [m, m, rad] laser in base_link."""
    sigma: float = 0.01
    """[m] standard deviation of a range."""
    resolution: float = 0.0
    """[m] ranges are multiples of this step; 0: not rounded."""
    rate: float = 10.0
    """[Hz] scans per second."""
    sweep_time: float = 0.0
    """[s] duration of one sweep, from ray 0 to one ray after the last; negative for a clockwise sweep.
    The value is -0.0 if a laser is clockwise and its log does not state the duration."""
    interlaced_sweeps: int = 1
    """Number of sweeps per scan, each with every n-th ray: 2 for a SICK LMS at 0.5°, whose mirror measures every 1°."""
    sweep_period: float = 0.0
    """[s] from one interlaced sweep to the next, usually one turn of the mirror; negative: the last sweep comes first."""
    first_ray_delay: float = 0.0
    """[s] from the stamp of a scan to ray 0; negative if the driver stamps scans on arrival."""
    height: float = 0.0
    """[m] height of the scan plane above the floor."""
    origins: Floats = field(default_factory=lambda: _empty(0, 2))
    """(n_rays, 2) [m] origin of each ray in the laser frame, for several sensors read as one.
    Default (0, 2): all rays start at the origin of the laser frame."""
    cones: Floats = field(default_factory=lambda: _empty(0))
    """(n_rays,) [rad] opening angle of the cone in which each ray measures the nearest surface.
    Default (0,): rays are thin."""
    delays: Floats = field(default_factory=lambda: _empty(0))
    """(n_rays,) [s] time of each ray after that of ray 0, for several sensors read as one. Default (0,): by `sweep_time`."""

    def __post_init__(self) -> None:
        steps = np.diff(self.bearings)
        in_order = (steps >= 0).all() if self.is_composite else (steps > 0).all()
        if self.bearings.ndim != 1 or len(self.bearings) < 1 or not in_order:
            raise ValueError(f"bearings has shape {self.bearings.shape}, expected (n_rays,), increasing")
        n = self.n_rays
        if self.origins.shape not in ((0, 2), (n, 2)) or {self.cones.shape, self.delays.shape} - {(0,), (n,)}:
            raise ValueError(
                f"origins has shape {self.origins.shape}, cones {self.cones.shape} and delays {self.delays.shape}, "
                f"expected ({n}, 2), ({n},) and ({n},)"
            )
        if self.mount.shape != (3,):
            raise ValueError(f"mount has shape {self.mount.shape}, expected (3,): x, y, yaw")
        if not 0 <= self.range_min < self.range_max:
            raise ValueError(
                f"range limits are {self.range_min} to {self.range_max}, expected 0 <= min < max"
            )
        if not 0 < self.rate < np.inf:
            raise ValueError(f"the rate is {self.rate} Hz, expected a number above 0")
        others = {
            name: getattr(self, name)
            for name in ("sigma", "resolution", "sweep_time", "sweep_period", "first_ray_delay", "height")
        }
        if not np.isfinite(list(others.values())).all():
            raise ValueError(f"the sensor has {others}, expected finite numbers")
        k, period = self.interlaced_sweeps, self.sweep_period
        if k < 1 or (k == 1) != (period == 0) or (k > 1 and abs(period) < abs(self.sweep_time)):
            raise ValueError(
                f"interlaced_sweeps is {k} and sweep_period {period:g} s, with a sweep_time of {self.sweep_time:g} s; "
                "expected 1 and 0 s, or at least 2 and a sweep_period of at least sweep_time"
            )

    @property
    def n_rays(self) -> int:
        """Number of rays in a scan."""
        return len(self.bearings)

    def take(self, rays: NDArray[np.integer] | slice) -> RangeSensor:
        """Return the sensor with a subset of its rays, in increasing order.

        If the subset no longer alternates between interlaced sweeps, it counts as one sweep.
        """
        turns = np.arange(self.n_rays)[rays] % self.interlaced_sweeps
        is_in_turns = np.array_equal(turns, np.arange(len(turns)) % self.interlaced_sweeps)
        return replace(
            self,
            interlaced_sweeps=self.interlaced_sweeps if is_in_turns else 1,
            sweep_period=self.sweep_period if is_in_turns else 0.0,
            bearings=self.bearings[rays],
            origins=self.origins[rays] if len(self.origins) else self.origins,
            cones=self.cones[rays] if len(self.cones) else self.cones,
            delays=self.delays[rays] if len(self.delays) else self.delays,
        )

    @property
    def is_composite(self) -> bool:
        """Return whether rays have different origins, as several sensors read as one have."""
        return bool(self.origins.any())

    @property
    def ray_delays(self) -> Floats:
        """(n_rays,) [s] time of each ray after the stamp of the scan; all 0 without a sweep."""
        if len(self.delays):
            return self.first_ray_delay + self.delays
        ray = np.arange(self.n_rays)
        along = self.sweep_time * ray / self.n_rays
        return self.first_ray_delay + along + self.sweep_period * (ray % self.interlaced_sweeps)

    @property
    def is_clockwise(self) -> bool:
        """Return whether the laser measures its last ray first."""
        return math.copysign(1.0, self.sweep_time) < 0

    @property
    def sweep_share(self) -> Floats:
        """(n_rays,) elapsed share of a sweep at the time of each ray."""
        if self.delays.any():
            return np.asarray((self.delays - self.delays.min()) / self.scan_duration)
        ray = np.arange(self.n_rays)
        return (ray[::-1] if self.is_clockwise else ray) / self.n_rays

    @property
    def ray_0_after_first(self) -> float:
        """[s] from the ray that is measured first to ray 0, which a clockwise laser measures last."""
        return -self.sweep_time * (self.n_rays - 1) / self.n_rays if self.is_clockwise else 0.0

    @property
    def has_ray_delays(self) -> bool:
        """Return whether the rays of a scan have times that differ from its stamp."""
        return bool(self.sweep_time or self.sweep_period or self.first_ray_delay or self.delays.any())

    @property
    def scan_duration(self) -> float:
        """[s] duration of a scan, from the first measured ray to one ray after the last."""
        if len(self.delays):
            return float(np.ptp(self.delays))
        return abs(self.sweep_time) + (self.interlaced_sweeps - 1) * abs(self.sweep_period)

    @property
    def has_ray_poses(self) -> bool:
        """Return whether the rays of a scan start at different points when the robot moves."""
        return self.has_ray_delays or self.is_composite

    @property
    def is_evenly_spaced(self) -> bool:
        """Return whether the bearings are equally spaced, to within 1e-6 rad."""
        steps = np.diff(self.bearings)
        return len(steps) == 0 or bool(np.ptp(steps) < 1e-6)


def rare_times(sensor: RangeSensor) -> dict[str, int | float]:
    """Return the fields of `RARE_TIMES` that differ from their defaults."""
    return {
        name: getattr(sensor, name) for name, usual in RARE_TIMES.items() if getattr(sensor, name) != usual
    }


def with_rare_times(sensor: RangeSensor, stated: Mapping[str, str | int | float]) -> RangeSensor:
    """Return the sensor with the fields of `RARE_TIMES` that a file contains."""
    values = {**RARE_TIMES, **{name: stated[name] for name in RARE_TIMES if name in stated}}
    return replace(
        sensor,
        interlaced_sweeps=int(values["interlaced_sweeps"]),
        sweep_period=float(values["sweep_period"]),
        first_ray_delay=float(values["first_ray_delay"]),
    )


def rate_of(stamps: Floats, otherwise: float = 10.0) -> float:
    """Return the scan rate [Hz]: the inverse of the median positive step of the stamps (n,) [s]."""
    steps = np.diff(stamps)
    steps = steps[(steps > 1e-9) & np.isfinite(steps)]
    return float(1.0 / np.median(steps)) if len(steps) else otherwise


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
                raise ValueError(f"{name} goes back in time; sort the signals of the run by time")

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
        reasons = "".join(f", {count} {reason}" for reason, count in self.dropped.items())
        return f"{int(self.paired.sum())} of {len(self.paired)} scans paired with poses{reasons}"


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
