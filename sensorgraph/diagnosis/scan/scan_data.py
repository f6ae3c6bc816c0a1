"""Scans of a run with their poses, prepared for the comparison with the simulator, and the sensor that robot.yaml and log describe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from logs.motion import Motion, motion_of
from logs.run import Pairing, RangeSensor, Run, pair
from planners.arena import Arena
from planners.clearance import Barriers
from sensorgraph.diagnosis.engine.selection import occam_factor
from sensorgraph.diagnosis.scan.corner_sums import Corners
from sensorgraph.diagnosis.scan.intake import (
    described_sensor,
    estimated_wobble,
    positive_tolerances,
    thinned_out,
    velocities,
)
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.site_baseline import SitePrior
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import Effect
from sensorgraph.effects.nuisance import POSE_LIKE
from sensorgraph.errors import SensorgraphError
from sensorgraph.intake import check_returns
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.cast_memory import CastMemory
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import Robot, Tolerances
from sensorgraph.world.scene import Scene
from sensorgraph.world.sweep import with_sweep_of

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanData:
    """Measured scans, and the setup of the simulator for them."""

    arena: Arena
    sensor: RangeSensor
    tolerances: Tolerances
    stamps: Floats
    """(n_scans,) [s]"""
    ranges: Floats
    """(n_scans, n_rays) [m] Measured ranges; +inf for no return, -inf for too close, nan for a broken
    reading."""
    poses: Floats
    """(n_scans, 3) Reference poses at the stamps, phi unwrapped."""
    twists: Floats
    """(n_scans, 3) [m/s, m/s, rad/s] Velocity in map."""
    track: tuple[Floats, Floats]
    """Stamps (n_poses,) and poses (n_poses, 3) of the reference, phi unwrapped."""
    begin: float
    """[s] Start of the run."""
    span: float
    """[s] Length of the run."""
    laser_frame: bool
    """Whether the reference poses are those of the laser, so that its mount cannot be estimated."""
    from_scans: bool = False
    """Whether the poses were located with these scans, so that they absorb errors that move a scan as a whole
    (`likely_poses`)."""
    wobble: tuple[float, float] = (0.0, 0.0)
    """[m, rad] Standard deviation of the reference error within one sweep of the laser, along each axis and
    in heading."""
    corners: Corners | None = None
    """Corners of the arena that may shift. None: all of them, unless there are too many."""
    laid: Floats | None = None
    """(2 n_corners,) [m] Shifts that were applied to the corners of the arena; corner errors still count from
    the map. None: no shift."""
    posed: Floats | None = None
    """(n_scans, 3) [m, m, rad] Shifts of `poses` from the reference; pose errors still count from the
    reference. None: no shift."""
    grain: float = 0.0
    """[m] Local deviation of a surface from its straight wall: half a cell of an occupancy-grid map, 0 for a
    drawn map."""
    known: tuple[Amendment, ...] = ()
    """Effects that are already part of the simulator."""
    site: SitePrior = field(default_factory=SitePrior)
    """What known-good runs of the site show of each effect (see `commissioning`)."""
    memo: dict[bytes, object] = field(default_factory=dict)
    """Cached results, such as the edges of a cast."""

    @property
    def n_scans(self) -> int:
        """Number of scans."""
        return len(self.stamps)

    @property
    def n_rays(self) -> int:
        """Number of rays per scan."""
        return int(self.ranges.shape[1])

    def may_show(self, effect: Effect, place: str = "") -> bool:
        """Return whether an effect is searched for: the site allows it, and the poses do not absorb it."""
        is_pose_like = not place and bool(effect.nuisances) and set(effect.nuisances) <= set(POSE_LIKE)
        return self.site.floor(effect.name) != np.inf and not (self.from_scans and is_pose_like)

    @cached_property
    def returned(self) -> Bools:
        """(n_scans, n_rays) Whether the ray returned."""
        return np.isfinite(self.ranges)

    def price(self, n_parameters: int) -> float:
        """Return the complexity penalty [nats] of free parameters."""
        return occam_factor(n_parameters, int(self.returned.sum()))

    @property
    def max_scatter(self) -> float:
        """[m] Maximum additional standard deviation of a reading: that of one which is uniform over the range."""
        return float(self.sensor.range_max / np.sqrt(12))

    @cached_property
    def speed(self) -> Floats:
        """(n_scans,) [m/s] Speed along the x axis of the robot."""
        phi = self.poses[:, 2]
        return np.asarray(np.cos(phi) * self.twists[:, 0] + np.sin(phi) * self.twists[:, 1])

    def motion(self, times: Floats) -> Floats:
        """Interpolate the reference (..., 3) at times (...) [s]; their first axis must be the scans if poses were shifted."""
        stamps, poses = self.track
        at = self.kept(b"motion", lambda: Motion(stamps=stamps, poses=poses)).at(times)
        return at if self.posed is None else at + self.posed.reshape(-1, *[1] * (at.ndim - 2), 3)

    def posed_by(self, errors: Floats) -> ScanData:
        """Return the data with poses shifted by errors (n_scans, 3) of the reference, so that casts are made there.

        To first order, a pose error only shifts a reading. However, it also moves outlines, and rays may then
        meet or miss them.
        """
        by = errors if self.posed is None else errors - self.posed
        return self._cast_elsewhere("posed", errors, lambda: {"poses": self.poses + by})

    def _cast_elsewhere(self, name: str, shifts: Floats, make: Callable[[], dict[str, object]]) -> ScanData:
        """Return data with shifts in the field `name`, and other fields to go with it; the latest ones, with their casts, are kept."""
        for kept in (self, self.memo.get(name.encode())):
            if isinstance(kept, ScanData) and np.array_equal(getattr(kept, name), shifts):
                return kept
        changed: dict[str, Any] = {**make(), name: shifts, "memo": {}}
        self.memo[name.encode()] = moved = replace(self, **changed)
        return moved

    @property
    def pose_start(self) -> Floats:
        """(n_scans, 3) [m, m, rad] Initial pose errors of a fit: those of the casts."""
        return np.zeros((self.n_scans, 3)) if self.posed is None else self.posed.copy()

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
            casts=self.kept(b"casts", CastMemory),
        )

    @property
    def barriers(self) -> Barriers:
        """Walls, and borders of unobserved space."""
        return self.kept(b"barriers", lambda: Barriers(self.arena))

    def kept(self, key: bytes, make: Callable[[], T]) -> T:
        """Return the cached value of a key, whose type is always the same; compute it on first use."""
        if key not in self.memo:
            self.memo[key] = make()
        return cast(T, self.memo[key])

    def laid_by(self, shifts: Floats) -> ScanData:
        """Return the data with the corners (2 n_corners,) [m] of an occupancy-grid map shifted, within their cells.

        A cell does not determine the position of the surface within it. To first order, this error only
        shifts readings. However, it also moves outlines that rays pass, and these need a new cast.
        """
        if self.grain <= 0 or self.corners is None or not self.corners.count:
            return self
        new = np.clip(shifts, -self.grain, self.grain)
        by, ends = new if self.laid is None else new - self.laid, self.corners.ends
        walls = self.arena.walls + by.reshape(-1, 2)[ends]
        return self._cast_elsewhere("laid", new, lambda: {"arena": replace(self.arena, walls=walls)})

    def is_laid_by(self, shifts: Floats) -> bool:
        """Return whether walls are where `laid_by` would place them, to within a small share of the map tolerance."""
        again = self.laid_by(shifts).laid
        if again is None:
            return True
        off = again if self.laid is None else again - self.laid
        return bool(np.abs(off).max() <= SCAN.fit.settled_step * self.tolerances.map)

    @cached_property
    def plain_cast(self) -> tuple[Floats, Ints]:
        """Ranges (n_scans, n_rays) [m] to the walls (inf: none) and wall index per ray (-1: none); single lasers only."""
        lasers = laser_poses(self.poses, self.sensor.mount)
        return cast_laser(self.arena.walls, lasers, self.sensor.bearings, self.sensor.range_max)

    def subset(self, scans: NDArray[np.intp] | Bools) -> ScanData:
        """Return the data of some scans: indices, or a mask (n_scans,)."""
        return replace(
            self,
            stamps=self.stamps[scans],
            ranges=self.ranges[scans],
            poses=self.poses[scans],
            twists=self.twists[scans],
            posed=None if self.posed is None else self.posed[scans],
            memo={},
        )

    def windows(self, n: int) -> list[ScanData]:
        """Split the run into n windows with equal numbers of scans; return none if they are too short for a run."""
        if self.n_scans < n * SCAN.intake.min_scans:
            return []
        ends = np.linspace(0, self.n_scans, n + 1).astype(np.intp)
        out = []
        for low, high in pairwise(ends):
            window = self.subset(np.arange(low, high))
            span = float(window.stamps[-1] - window.stamps[0])
            out.append(replace(window, begin=float(window.stamps[0]), span=max(span, 1e-9)))
        return out


def prepare_scans(
    run: Run, arena: Arena, robot: Robot, known: Sequence[Amendment] = ()
) -> tuple[ScanData, dict[str, object]]:
    """Pair the scans of a run with poses, and subsample a long run.

    Parameters
    ----------
    known : Effects that are already part of the model; those of other channels are ignored.

    Returns
    -------
    The data, and notes on the pairing under the keys of report.json.

    Raises
    ------
    SensorgraphError
        The run is too short, has no returns or no poses, or has a different sensor than the robot.
    """
    run = with_sweep_of(run, robot)
    pairing = pair(run)
    paired = pairing.paired & ~np.isnan(run.ranges).all(axis=1)
    broken = int((pairing.paired & ~paired).sum())
    kept, thinned = thinned_out(paired, run.sensor.n_rays)
    notes: dict[str, object] = {
        "scans": run.n_scans,
        "used": int(kept.sum()),
        "dropped": {**pairing.dropped, "with nothing but broken readings": broken, **thinned},
    }
    _check_scans(run, pairing, int(kept.sum()))
    laser_frame = run.pose_frame == "laser"
    sensor = described_sensor(run, robot, is_laser_frame=laser_frame)
    notes["laser_height_m"] = sensor.height
    motion = motion_of(run, use_odometry=sensor.has_ray_delays)
    when = run.stamps[kept]
    data = ScanData(
        arena=arena,
        sensor=sensor,
        tolerances=positive_tolerances(robot.tolerances),
        stamps=when,
        ranges=run.ranges[kept],
        poses=_unwrapped_like(motion.at(when)[:, 2], pairing.poses[kept]),
        twists=velocities(motion.stamps, motion.poses, when),
        track=(motion.stamps, motion.poses),
        begin=float(when[0]),
        span=float(max(when[-1] - when[0], 1e-9)),
        laser_frame=laser_frame,
        wobble=estimated_wobble(run, sensor, robot.tolerances),
        known=tuple(a for a in known if a.effect.channel == "scan"),
    )
    return data, notes


def _check_scans(run: Run, pairing: Pairing, n_kept: int) -> None:
    """Refuse a run with too few scans, without returns, or with too few scans that have a pose."""
    least = SCAN.intake.min_scans
    if run.n_scans < least:
        more = (
            "record a longer run" if run.n_scans else "select the topic of its scans with `topics` scan=NAME"
        )
        raise SensorgraphError(f"the run has {run.n_scans} scans, expected {least} or more; {more}")
    check_returns(run)
    if n_kept < least:
        raise SensorgraphError(
            f"only {n_kept} of {run.n_scans} scans have a pose ({pairing}), expected {least} or more; "
            "record a longer run, or select the topic of its poses with `topics` pose=NAME"
        )


def _unwrapped_like(phi: Floats, poses: Floats) -> Floats:
    """Return poses (n, 3) with headings shifted by whole turns, so that they follow phi (n,) [rad]."""
    turns = np.rint((phi - poses[:, 2]) / (2 * np.pi))
    return np.column_stack([poses[:, :2], poses[:, 2] + 2 * np.pi * turns])
