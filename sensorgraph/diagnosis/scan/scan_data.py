"""Evidence: the scans of a run with the poses they were taken at, ready to be compared with a simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor, Run, pair
from planners.arena import Arena
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot, Tolerances
from sensorgraph.world.scene import Scene

if TYPE_CHECKING:
    from sensorgraph.diagnosis.scan.site_variation import BaselineInterval

LEAST_SCANS = 50
MOST_RAYS = 100_000  # more say little new: map and poses, not noise, then bound what can be told
LEAST_RAYS = 3
LEAST_SIGMA = 5e-4  # [m] of a return
SMOOTH = 0.2  # [s] either side, over which the reference is fitted to tell the speed


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanData:
    """Measured scans, and how the simulator is set up for them."""

    arena: Arena
    sensor: RangeSensor
    tolerances: Tolerances
    stamps: Floats
    """(n_scans,) [s]"""
    ranges: Floats
    """(n_scans, n_rays) [m] measured; +inf nothing seen, -inf too close, nan broken."""
    poses: Floats
    """(n_scans, 3) reference at the stamps, phi unwrapped."""
    twists: Floats
    """(n_scans, 3) [m/s, m/s, rad/s] velocity in map."""
    track: tuple[Floats, Floats]
    """Stamps (n_poses,) and poses (n_poses, 3) of the reference, phi unwrapped."""
    begin: float
    """[s] start of the run."""
    span: float
    """[s] length of the run."""
    laser_frame: bool
    """The reference is the laser's own pose, so that no mount can be told."""
    known: tuple[Amendment, ...] = ()
    """Effects that are part of the simulator already."""
    floors: Mapping[str, float] = field(default_factory=dict)
    """Effect -> [nats] further evidence that its name takes at this site (see `commissioning`)."""
    usual: Mapping[str, BaselineInterval] = field(default_factory=dict)
    """Effect -> the sizes that the site shows though nothing is wrong."""
    memo: dict[bytes, object] = field(default_factory=dict)
    """Casts made before."""

    @property
    def n_scans(self) -> int:
        """Count of scans."""
        return len(self.stamps)

    @property
    def n_rays(self) -> int:
        """Count of rays in a scan."""
        return int(self.ranges.shape[1])

    @cached_property
    def returned(self) -> Bools:
        """(n_scans, n_rays) the ray came back."""
        return np.isfinite(self.ranges)

    @cached_property
    def speed(self) -> Floats:
        """(n_scans,) [m/s] along the robot's own x."""
        phi = self.poses[:, 2]
        return np.asarray(np.cos(phi) * self.twists[:, 0] + np.sin(phi) * self.twists[:, 1])

    def motion(self, times: Floats) -> Floats:
        """Interpolate the reference (..., 3) at times (...) [s]."""
        stamps, poses = self.track
        return np.stack([np.interp(times, stamps, column) for column in poses.T], axis=-1)

    def scene(self, seed: int | None = None) -> Scene:
        """Set up the simulator for these scans."""
        return Scene(
            arena=self.arena,
            sensor=self.sensor,
            stamps=self.stamps,
            motion=self.motion,
            span=self.span,
            seed=seed,
            begin=self.begin,
            memo=self.memo,
        )

    def part(self, scans: NDArray[np.intp] | Bools) -> ScanData:
        """Return the evidence of some scans only."""
        return replace(
            self,
            stamps=self.stamps[scans],
            ranges=self.ranges[scans],
            poses=self.poses[scans],
            twists=self.twists[scans],
            memo={},
        )

    def rays(self, every: int) -> ScanData:
        """Return the evidence of every n-th ray only."""
        rays = np.arange(every // 2, self.n_rays, every)
        sensor = replace(self.sensor, bearings=self.sensor.bearings[rays])
        if self.sensor.sweep_time > 0:
            return self
        return replace(self, sensor=sensor, ranges=np.ascontiguousarray(self.ranges[:, rays]), memo={})


def prepare_scans(
    run: Run, arena: Arena, robot: Robot, known: Sequence[Amendment] = ()
) -> tuple[ScanData, dict[str, object]]:
    """Pair scans with poses; return the evidence and what is worth saying about the pairing."""
    pairing = pair(run)
    kept = pairing.paired & ~np.isnan(run.ranges).all(axis=1)
    broken = int((pairing.paired & ~kept).sum())
    kept, thinned = _thinned(kept, run.sensor.n_rays)
    notes: dict[str, object] = {
        "scans": run.n_scans,
        "used": int(kept.sum()),
        "dropped": {
            **pairing.dropped,
            "with nothing but broken readings": broken,
            **thinned,
        },
    }
    if run.n_scans < LEAST_SCANS:
        raise SensorgraphError(
            f"the run has {run.n_scans} scans, expected {LEAST_SCANS} or more; record a longer run"
        )
    if not np.isfinite(run.ranges).any():
        raise SensorgraphError("no ray of the run ever returned; there is nothing to compare with the arena")
    if kept.sum() < LEAST_SCANS:
        raise SensorgraphError(
            f"only {int(kept.sum())} of {run.n_scans} scans have a pose ({pairing}), expected {LEAST_SCANS} or more; "
            "record a longer run, or name the topic of its poses with `topics` pose=..."
        )
    laser_frame = run.pose_frame == "laser"
    sensor = _sensor(run, robot, laser_frame)
    poses = run.poses.copy()
    finite = np.isfinite(poses).all(axis=1)
    stamps, poses = run.pose_stamps[finite], poses[finite]
    poses[:, 2] = np.unwrap(poses[:, 2])
    when = run.stamps[kept]
    data = ScanData(
        arena=arena,
        sensor=sensor,
        tolerances=_tolerances(robot.tolerances),
        stamps=when,
        ranges=run.ranges[kept],
        poses=np.stack([np.interp(when, stamps, column) for column in poses.T], axis=-1),
        twists=velocities(stamps, poses, when),
        track=(stamps, poses),
        begin=float(when[0]),
        span=float(max(when[-1] - when[0], 1e-9)),
        laser_frame=laser_frame,
        known=tuple(a for a in known if a.effect.channel == "scan"),
    )
    return data, notes


def _thinned(kept: Bools, n_rays: int) -> tuple[Bools, dict[str, int]]:
    """Keep every n-th of the usable scans of a long run; say how many that leaves out."""
    count = int(kept.sum())
    step = -(-count * n_rays // MOST_RAYS)
    if step <= 1:
        return kept, {}
    some = np.zeros_like(kept)
    some[np.flatnonzero(kept)[step // 2 :: step]] = True
    return some, {f"beyond one in {step}, which say enough": count - int(some.sum())}


def velocities(stamps: Floats, poses: Floats, when: Floats) -> Floats:
    """Fit a line to the poses around each time; return its slope (n, 3) [1/s]."""
    low = np.searchsorted(stamps, when - SMOOTH)
    high = np.searchsorted(stamps, when + SMOOTH, side="right")
    low = np.minimum(low, np.maximum(high - 2, 0))
    high = np.maximum(high, np.minimum(low + 2, len(stamps)))
    middle = stamps[0]
    t = stamps - middle
    sums = [np.concatenate([[0.0], np.cumsum(v)]) for v in (np.ones_like(t), t, t * t)]
    n, s1, s2 = (c[high] - c[low] for c in sums)
    slopes = []
    for column in poses.T:
        c = column - column[0]
        y, ty = (np.concatenate([[0.0], np.cumsum(v)]) for v in (c, t * c))
        sy, sty = y[high] - y[low], ty[high] - ty[low]
        spread = n * s2 - s1 * s1
        slopes.append(
            np.where(spread > 1e-12, (n * sty - s1 * sy) / np.where(spread > 1e-12, spread, 1.0), 0.0)
        )
    return np.stack(slopes, axis=1)


def _tolerances(told: Tolerances) -> Tolerances:
    """Return tolerances that are never nothing: no set-up is perfect, and a zero has no logarithm."""
    least = {
        "map": 2e-4,
        "mount_xy": 1e-4,
        "mount_yaw": 2e-5,
        "pose_xy": 2e-4,
        "pose_yaw": 1e-4,
        "stamp": 1e-4,
    }
    return replace(told, **{name: max(getattr(told, name), value) for name, value in least.items()})


def _sensor(run: Run, robot: Robot, laser_frame: bool) -> RangeSensor:
    """Return what robot.yaml says of the sensor, at the bearings that the run has."""
    told, seen = robot.sensor, run.sensor
    if seen.n_rays != told.n_rays or np.abs(seen.bearings - told.bearings).max() > 0.02:
        raise SensorgraphError(
            f"the run has {seen.n_rays} rays from {seen.bearings[0]:.3f} to {seen.bearings[-1]:.3f} rad, robot.yaml "
            f"describes {told.n_rays} from {told.bearings[0]:.3f} to {told.bearings[-1]:.3f}; give the robot that recorded it"
        )
    if told.n_rays < LEAST_RAYS:
        raise SensorgraphError(
            f"the sensor has {told.n_rays} rays, expected {LEAST_RAYS} or more to tell effects apart"
        )
    beyond = float((np.where(np.isfinite(run.ranges), run.ranges, 0.0) > 1.02 * told.range_max + 0.05).mean())
    if beyond > 0.01:
        raise SensorgraphError(
            f"{100 * beyond:.0f} % of the readings are beyond sensor.range_max = {told.range_max:g} m of robot.yaml; "
            "give the robot that recorded the run"
        )
    mount = np.zeros(3) if laser_frame else told.mount
    sigma = max(told.sigma, told.resolution / np.sqrt(12), LEAST_SIGMA)
    return replace(told, mount=mount, sigma=float(sigma))
