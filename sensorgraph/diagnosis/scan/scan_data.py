"""The scans of a run with the poses they were taken at, ready to be compared with the simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from logs.motion import Motion, motion_of
from logs.run import RangeSensor, Run, pair
from planners.arena import Arena
from planners.clearance import Barriers
from sensorgraph.diagnosis.scan.corners import Corners
from sensorgraph.diagnosis.scan.described_sensor import described_sensor
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_sizes import BaselineInterval
from sensorgraph.diagnosis.scan.sweep_wobble import estimated_wobble, references_in_sweep
from sensorgraph.diagnosis.scan.thinning import thinned_out
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import Effect
from sensorgraph.effects.nuisance import POSE_LIKE
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.cast_memory import CastMemory
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import Robot, Tolerances
from sensorgraph.world.scene import Scene
from sensorgraph.world.sweep import with_sweep_of

T = TypeVar("T")

LAID, POSED = b"laid", b"posed"
"""In `ScanData.memo`: the data with the walls, or the poses, where they were laid last."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IntoUnknown:
    """Rays that leave the map before they meet a wall; arrays (n_scans, n_rays)."""

    horizon: Floats
    """[m] where they do; inf for other rays."""
    ranges: Floats
    """[m] as measured; nan for other rays."""

    def subset(self, scans: NDArray[np.intp] | Bools) -> IntoUnknown:
        """Return those of some scans: indices, or a mask (n_scans,)."""
        return IntoUnknown(horizon=self.horizon[scans], ranges=self.ranges[scans])


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
    into_unknown: IntoUnknown | None = None
    """Rays that leave the map, which are not judged (nan in `ranges`) but where `judged_to_horizon` says so; None: there are none."""
    horizon: Floats | None = None
    """(n_scans, n_rays) [m] up to where a ray that leaves the map is judged, inf where it does not; None: none is judged."""
    beyond: Bools | None = None
    """(n_scans, n_rays) nothing stopped the ray before its horizon; its reading is nan in `ranges`."""
    laser_frame: bool
    """The reference poses are those of the laser itself, so that its mount cannot be estimated."""
    from_scans: bool = False
    """The poses were found from these very scans, and have taken along what moves a scan as a whole (`poses_of_scans`)."""
    wobble: tuple[float, float] = (0.0, 0.0)
    """[m, rad] standard deviation of the reference's error within one sweep of the laser, along each axis and in heading."""
    references_in_sweep: float = 0.0
    """References that fall into a sweep, between which their error is interpolated."""
    corners: Corners | None = None
    """Of the arena that may shift. None: all of them, unless there are too many."""
    laid: Floats | None = None
    """(2 n_corners,) [m] by which the corners of the arena have been moved; their errors count from where the map has them.
    None: not at all."""
    posed: Floats | None = None
    """(n_scans, 3) [m, m, rad] by which `poses` are off the reference, from where pose errors count; None: not at all."""
    grain: float = 0.0
    """[m] by which a surface may leave its straight wall from place to place: half a pixel of the map; 0 of a drawn one."""
    stated_map: float = 0.0
    """[m] tolerance of the map where robot.yaml states it: what has moved by no more than that is none; 0: it does not."""
    known: tuple[Amendment, ...] = ()
    """Effects that are part of the simulator already."""
    clutter_nats: Mapping[str, float] = field(default_factory=dict)
    """Effect -> [nats] further evidence that its name takes at this site (see `commissioning`); inf: do not look."""
    clutter_leads: Mapping[str, float] = field(default_factory=dict)
    """Smooth effect of the whole sensor -> [nats] that clutter alone may bring it: less is no name, and a smaller lead over
    another that is out of its own interval, too, does not choose between them."""
    baseline_intervals: Mapping[str, BaselineInterval] = field(default_factory=dict)
    """Effect -> the sizes that the site shows though nothing is wrong."""
    memo: dict[bytes, object] = field(default_factory=dict)
    """Results kept by content, such as the edges of a cast."""

    @property
    def n_scans(self) -> int:
        """Count of scans."""
        return len(self.stamps)

    @property
    def n_rays(self) -> int:
        """Count of rays in a scan."""
        return int(self.ranges.shape[1])

    def may_show(self, effect: Effect, place: str = "") -> bool:
        """Tell whether an effect is looked for: the site allows it, and poses have not taken it along."""
        is_pose_like = not place and bool(effect.nuisances) and set(effect.nuisances) <= set(POSE_LIKE)
        return self.clutter_nats.get(effect.name) != np.inf and not (self.from_scans and is_pose_like)

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
        """Interpolate the reference (..., 3) at times (...) [s]; the first axis is of the scans where poses have been moved."""
        stamps, poses = self.track
        at = self.kept(b"motion", lambda: Motion(stamps=stamps, poses=poses)).at(times)
        return at if self.posed is None else at + self.posed.reshape(-1, *[1] * (at.ndim - 2), 3)

    def posed_by(self, errors: Floats) -> ScanData:
        """Return the data with poses moved by errors (n_scans, 3) of the reference: casts are made there.

        As an error of a reading that is of first order; but outlines move, too, which rays pass or meet.
        """
        for kept in (self, self.memo.get(POSED)):
            if isinstance(kept, ScanData) and kept.posed is not None and np.array_equal(kept.posed, errors):
                return kept  # with its casts
        by = errors if self.posed is None else errors - self.posed
        self.memo[POSED] = posed = replace(self, poses=self.poses + by, posed=errors, memo={})
        return posed

    @property
    def pose_start(self) -> Floats:
        """(n_scans, 3) pose errors [m, m, rad] that a fit begins with: those that the casts have."""
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
        """What stands, and what nobody has looked into."""
        return self.kept(b"barriers", lambda: Barriers(self.arena))

    def kept(self, key: bytes, make: Callable[[], T]) -> T:
        """Return what the memo has under a key, always of one kind; made where there is nothing."""
        if key not in self.memo:
            self.memo[key] = make()
        return cast(T, self.memo[key])

    def laid_by(self, shifts: Floats) -> ScanData:
        """Return the data with the corners (2 n_corners,) of a map of pixels moved by [m], within the cells.

        A cell leaves open where in it a surface is. As an error of the map that is of first order; but it moves outlines that
        rays pass, too, and these need a new cast.
        """
        if self.grain <= 0 or self.corners is None or not self.corners.count:
            return self
        new = np.clip(shifts, -self.grain, self.grain)
        for kept in (self, self.memo.get(LAID)):
            if isinstance(kept, ScanData) and kept.laid is not None and np.array_equal(kept.laid, new):
                return kept  # with its casts
        by = new if self.laid is None else new - self.laid
        walls = self.arena.walls + by.reshape(-1, 2)[self.corners.ends]
        self.memo[LAID] = laid = replace(self, arena=replace(self.arena, walls=walls), laid=new, memo={})
        return laid

    def is_laid_by(self, shifts: Floats) -> bool:
        """Tell whether walls lie where `laid_by` would lay them, but for a small share of the map's tolerance."""
        again = self.laid_by(shifts).laid
        if again is None:
            return True
        off = again if self.laid is None else again - self.laid
        return bool(np.abs(off).max() <= SCAN.fit.settled_step * self.tolerances.map)

    @cached_property
    def plain_cast(self) -> tuple[Floats, Ints]:
        """Ranges (n_scans, n_rays) [m] to the walls, inf for none, and the index of each ray's wall, -1; of one laser alone."""
        lasers = laser_poses(self.poses, self.sensor.mount)
        return cast_laser(self.arena.walls, lasers, self.sensor.bearings, self.sensor.range_max)

    def subset(self, scans: NDArray[np.intp] | Bools) -> ScanData:
        """Return the data of some scans only: indices, or a mask (n_scans,)."""
        return replace(
            self,
            stamps=self.stamps[scans],
            ranges=self.ranges[scans],
            poses=self.poses[scans],
            twists=self.twists[scans],
            posed=None if self.posed is None else self.posed[scans],
            into_unknown=None if self.into_unknown is None else self.into_unknown.subset(scans),
            horizon=None if self.horizon is None else self.horizon[scans],
            beyond=None if self.beyond is None else self.beyond[scans],
            memo={},
        )

    def judged_to_horizon(self, some: Bools) -> ScanData:
        """Return the data with some rays (n_scans, n_rays), of those that leave the map, judged up to there.

        The choice must be one of where they are aimed, and not of what they read.
        """
        assert self.into_unknown is not None
        horizon = np.where(some, self.into_unknown.horizon, np.inf)
        z, leaves = self.into_unknown.ranges, np.isfinite(horizon)
        return replace(
            self,
            ranges=np.where(leaves & (z < horizon), z, self.ranges),
            horizon=horizon,
            beyond=leaves & (z >= horizon),
            memo={},
        )

    def up_to_horizon(self, beams: Beams) -> Beams:
        """Return beams that meet nothing beyond the horizon."""
        if self.horizon is None:
            return beams
        before = beams.ranges < self.horizon
        return replace(
            beams,
            ranges=np.where(before, beams.ranges, np.inf),
            reading=np.where(before, beams.reading, np.inf),
            wall=np.where(before, beams.wall, -1),
            nx=np.where(before, beams.nx, 0.0),
            ny=np.where(before, beams.ny, 0.0),
        )

    def windows(self, n: int) -> list[ScanData]:
        """Cut the run into n windows with the same count of scans; none where they would be too short for a run."""
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
    """Pair the scans of a run with poses, and thin out a long run.

    Parameters
    ----------
    known : effects that are part of the model already; those of other channels are left out

    Returns
    -------
    the data, and what is worth saying about the pairing under the keys of report.json

    Raises
    ------
    SensorgraphError
        The run is too short, has no returns or no poses, or another sensor than the robot.
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
    least = SCAN.intake.min_scans
    if run.n_scans < least:
        more = "record a longer run" if run.n_scans else "name the topic of its scans with `topics` scan=..."
        raise SensorgraphError(f"the run has {run.n_scans} scans, expected {least} or more; {more}")
    if not np.isfinite(run.ranges).any():
        raise SensorgraphError("no ray of the run ever returned; there is nothing to compare with the arena")
    if kept.sum() < least:
        raise SensorgraphError(
            f"only {int(kept.sum())} of {run.n_scans} scans have a pose ({pairing}), expected {least} or more; "
            "record a longer run, or name the topic of its poses with `topics` pose=..."
        )
    laser_frame = run.pose_frame == "laser"
    sensor = described_sensor(run, robot, is_laser_frame=laser_frame)
    notes["laser_height_m"] = sensor.height
    motion = motion_of(run, use_odometry=sensor.has_ray_delays)
    when = run.stamps[kept]
    data = ScanData(
        arena=arena,
        sensor=sensor,
        tolerances=_positive_tolerances(robot.tolerances),
        stamps=when,
        ranges=run.ranges[kept],
        poses=_unwrapped_like(motion.at(when)[:, 2], pairing.poses[kept]),
        twists=velocities(motion.stamps, motion.poses, when),
        track=(motion.stamps, motion.poses),
        begin=float(when[0]),
        span=float(max(when[-1] - when[0], 1e-9)),
        laser_frame=laser_frame,
        wobble=estimated_wobble(run, sensor, robot.tolerances),
        references_in_sweep=references_in_sweep(run, sensor),
        stated_map=robot.tolerances.map if "tolerances.map" in robot.stated else 0.0,
        known=tuple(a for a in known if a.effect.channel == "scan"),
    )
    return data, notes


def _unwrapped_like(phi: Floats, poses: Floats) -> Floats:
    """Return poses (n, 3) whose headings are whole turns away, so that they follow phi (n,) [rad]."""
    turns = np.rint((phi - poses[:, 2]) / (2 * np.pi))
    return np.column_stack([poses[:, :2], poses[:, 2] + 2 * np.pi * turns])


def velocities(stamps: Floats, poses: Floats, when: Floats) -> Floats:
    """Return the slope (n, 3) [1/s] of a line fitted to the poses around each of n times."""
    window = SCAN.intake.velocity_window
    low = np.searchsorted(stamps, when - window)
    high = np.searchsorted(stamps, when + window, side="right")
    low = np.minimum(low, np.maximum(high - 2, 0))
    high = np.maximum(high, np.minimum(low + 2, len(stamps)))
    t = stamps - stamps[0]
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


def _positive_tolerances(tolerances: Tolerances) -> Tolerances:
    """Return tolerances that are never zero."""
    least = SCAN.intake.min_tolerances
    return replace(
        tolerances, **{name: max(getattr(tolerances, name), value) for name, value in vars(least).items()}
    )
