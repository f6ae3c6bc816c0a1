"""Check that scans and odometry describe the same drive: units of the odometry, ray order and yaw of the laser.

The segments with the most turning and with the longest distance are tracked by the scans alone, and compared
with the odometry. The signs of turn and forward motion distinguish four cases.

| turn | forward | cause |
|---|---|---|
| same | same | none |
| same | other direction | yaw of the laser's mount |
| opposite | same | rays counted clockwise, as in a mirror |
| opposite | opposite | odometry that counts backwards |
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import Run
from logs.transforms import compose, invert, wrap
from logs.usability import MIN_DISTANCE, MIN_STEP
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.course import (
    MAX_RATIO,
    MIN_MOVING,
    direction_of,
    turn_units,
    with_course,
)
from sensorgraph.localization.front_end import SHORT_DRIVE, track_part
from sensorgraph.localization.missing_odometry import without_corrections
from sensorgraph.localization.moving_returns import confirms_odometry
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.result import WheelParameters
from sensorgraph.localization.scans import ScanPoints
from sensorgraph.localization.settings import SIGNIFICANT
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats

EVERY = 4
"""Number of scans of a step, so that the noise of a match is small against its motion."""
MIN_MATCHED = 0.9
"""Minimum share of matched scans."""
MIN_TURN = 0.7
"""[rad] Minimum turn by the scans for a comparison of turns; distances are compared from `MIN_DISTANCE` on."""
TOLERANCE = 0.35
"""Maximum deviation from the factor of a unit, in the logarithm."""
OPPOSITE = -0.6
"""Correlation of the turns below which one of the two is mirrored."""
MAX_DIRECTION = 0.5
"""[rad] Maximum angle between the motion by the scans and by the odometry, for a stated mount."""
NOTED_DIRECTION = 0.035
"""[rad] A smaller angle between these motions is not worth a note."""
RIGHT_ANGLE = 0.1
"""[rad] A mount with an unknown yaw within this of a multiple of 90° has exactly that yaw."""
MAX_RADIANS = 7.0
"""[rad] A heading beyond this is in degrees, or was never wrapped."""
DISTANCE_UNITS = {1e-3: "millimetres", 1e-2: "centimetres", 0.0254: "inches", 0.3048: "feet"}
TURN_UNITS = {float(np.pi / 180): "degrees"}


def with_checked_odometry(run: Run) -> tuple[Run, tuple[str, ...]]:
    """Return the run with its odometry in metres and radians, and notes about the changes.

    Odometry that disagrees with the scans in all units is removed.

    A laser whose mount is unknown (`meta["mount"]` is `unknown`) gets the yaw that the motion shows.

    Raises
    ------
    SensorgraphError : Scans and odometry turn or move in different directions.
    """
    motion = _as_logged(run)
    if motion is None or run.n_scans < 3:
        return run, ()
    joined, said = without_corrections(motion)
    notes = list(said)
    if joined is not motion:
        run, motion = _scaled(run, joined, 1.0, 1.0), joined
    odometry = odometry_at_scans(run, motion)
    way_factor = turn_factor = 1.0
    turns = _compared(run, motion, odometry, np.abs(np.diff(odometry[:, 2])), [2])
    if turns is not None and np.abs(turns.seen[:, 2]).sum() > MIN_TURN:
        seen, driven = turns.seen[:, 2], turns.driven[:, 2]
        turn_factor = _factor(_ratio(seen, driven), "turns", turn_units(motion.poses, TURN_UNITS), notes)
        is_opposite = _correlation(seen, driven) < OPPOSITE
        if is_opposite and _agrees(seen, -turn_factor * driven):
            ways = _ways(run, motion, 1.0)
            raise SensorgraphError(
                _opposite_text(None if ways is None else direction_of(ways.seen, ways.driven))
            )
        if not _agrees(seen, turn_factor * driven):
            if turns.confirms_odometry:
                return run, (_confirmed("turns"),)
            return _without_odometry(run), (_disagreement(seen, driven, "turns", "radians"),)
    run, motion, ways = _along_course(run, motion, turn_factor, notes)
    direction = None if ways is None else direction_of(ways.seen, ways.driven)
    limit = MAX_DIRECTION if _has_stated_mount(run) else RIGHT_ANGLE
    if direction is not None and abs(direction[0]) > max(limit, 3.0 * direction[1]):
        run = _with_yaw(run, *direction, notes)
    elif direction is not None and abs(direction[0]) > max(NOTED_DIRECTION, SIGNIFICANT * direction[1]):
        notes.append(_turned_text(*direction))
    if ways is not None:
        seen, driven = (np.hypot(steps[:, 0], steps[:, 1]) for steps in (ways.seen, ways.driven))
        if seen.sum() > MIN_DISTANCE:
            way_factor = _factor(_ratio(seen, driven), "distances", DISTANCE_UNITS, notes)
        if not _agrees(seen, way_factor * driven):
            if turn_factor == 1.0 and ways.confirms_odometry:
                return run, (_confirmed("distances"),)
            return _without_odometry(run), (_disagreement(seen, driven, "distances", "metres"),)
    if way_factor == turn_factor == 1.0:
        return run, tuple(notes)
    return _scaled(run, motion, way_factor, turn_factor), tuple(notes)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Stretch:
    """A stretch of a run by the scans alone and by the odometry."""

    scans: ScanPoints
    stamps: Floats
    poses: Floats
    """(n, 3) [m, m, rad] By the scans."""
    odometry: Floats
    """(n, 3) [m, m, rad]"""

    @property
    def seen(self) -> Floats:
        """Steps (m, 3) by the scans."""
        return _steps(self.poses[::EVERY])

    @property
    def driven(self) -> Floats:
        """Steps (m, 3) by the odometry."""
        return _steps(self.odometry[::EVERY])

    @property
    def confirms_odometry(self) -> bool:
        """Whether readings show that the odometry is right where the scans contradict it."""
        return confirms_odometry(self.scans, self.stamps, self.poses, self.odometry)


def _along_course(
    run: Run, motion: Motion, turn_factor: float, notes: list[str]
) -> tuple[Run, Motion, _Stretch | None]:
    """Return the odometry with its heading along its course where the scans confirm this, and the stretch of most motion."""
    ways = _ways(run, motion, turn_factor)
    direction = None if ways is None else direction_of(ways.seen, ways.driven)
    if ways is None or (direction is not None and abs(direction[0]) < NOTED_DIRECTION):
        return run, motion, ways
    found = with_course(motion, turn_factor, ways.stamps[::EVERY], ways.seen)
    if found is None:
        return run, motion, ways
    notes.append(
        "the odometry does not move along its heading, and the scans do: mirrored axes, a twist in another frame, or a heading in "
        "another unit or with another zero; corrected"
    )
    return _scaled(run, found, 1.0, 1.0), found, _ways(run, found, turn_factor)


def _opposite_text(direction: tuple[float, float] | None) -> str:
    """Return the message for scans and odometry that turn in opposite directions."""
    if direction is not None and abs(direction[0]) > np.pi / 2:
        return (
            "scans and odometry turn and move in opposite directions: the odometry counts backwards, or the laser counts "
            "its rays clockwise and looks backwards; correct the odometry, or state the mount in robot.yaml"
        )
    return (
        "scans and odometry turn in opposite directions: the laser counts its rays clockwise, as in a mirror, or the "
        "odometry counts turns to the right as positive (z down); state the laser in robot.yaml or in the transform, or "
        "correct the odometry"
    )


def check_turns(wheels: WheelParameters | None) -> None:
    """Refuse wheels whose turns the whole drive shows to be opposite, where no stretch of scans alone did.

    Raises
    ------
    SensorgraphError : The turn scale is negative by `SIGNIFICANT` standard errors.
    """
    if wheels is not None and wheels.turn_scale < -SIGNIFICANT * wheels.turn_scale_sd:
        raise SensorgraphError(_opposite_text(None))


def _has_stated_mount(run: Run) -> bool:
    return run.meta.get("mount") != "unknown" or run.sensor.is_composite


def _with_yaw(run: Run, angle: float, stderr: float, notes: list[str]) -> Run:
    """Return the run with the yaw of an unknown mount as the motion shows it; refuse a stated mount that contradicts it.

    Parameters
    ----------
    angle, stderr : [rad] From the motion of the odometry to that of the scans.
    """
    found = f"{np.degrees(-angle):.0f}° ± {max(np.degrees(stderr), 0.5):.1f}°"
    if _has_stated_mount(run):
        raise SensorgraphError(
            f"the scans move in another direction than the odometry: the laser is turned by {found} relative to its "
            "specified mount, or the odometry counts its distance backwards; correct the transform or the odometry, or "
            "state the mount in robot.yaml"
        )
    right = np.round(-angle / (np.pi / 2)) * np.pi / 2
    yaw = right if abs(right + angle) < RIGHT_ANGLE else -angle
    x, y, old = run.sensor.mount
    notes.append(
        f"the mount of the laser is unknown, and the odometry shows that it is turned by {found}: "
        f"{np.degrees(yaw):.0f}° was used"
    )
    return replace(run, sensor=replace(run.sensor, mount=np.array([x, y, wrap(old + yaw)])))


def _turned_text(angle: float, stderr: float) -> str:
    """Return the note on a direction [rad] of the scans that is too small to refuse the mount."""
    return (
        f"the scans move {np.degrees(abs(angle)):.1f}° ± {np.degrees(stderr):.1f}° to the {'right' if angle < 0 else 'left'} "
        f"of the odometry's motion: the laser is turned by {np.degrees(-angle):+.1f}° relative to its specified mount, or the "
        "robot slips sideways; the headings of the poses are wrong by as much if it is the laser"
    )


def _compared(run: Run, motion: Motion, odometry: Floats, moved: Floats, parts: list[int]) -> _Stretch | None:
    """Return the stretch where `moved` (n_scans - 1,) is largest, as far as there is odometry.

    None if the scans alone cannot be tracked there, or do not determine these parts of a motion ahead, left and turn.
    """
    total = np.concatenate([[0.0], np.cumsum(moved)])
    first = int(np.argmax(total[SHORT_DRIVE:] - total[:-SHORT_DRIVE])) if len(total) > SHORT_DRIVE else 0
    begin = int(np.searchsorted(run.stamps, motion.stamps[0]))
    end = int(np.searchsorted(run.stamps, motion.stamps[-1], side="right"))
    stretch = slice(max(first, begin), min(first + SHORT_DRIVE, end))
    scans, found = track_part(run, stretch)
    is_seen = (np.einsum("nii->ni", found.projections)[:, parts] > 0.5).all(axis=1)  # not along a corridor
    if (
        len(is_seen) == 0
        or min(found.matched.mean(), is_seen.mean()) < MIN_MATCHED
        or (np.diff(found.piece) != 0).any()
    ):
        return None
    unwrapped = np.column_stack([found.poses[:, :2], np.unwrap(found.poses[:, 2])])
    return _Stretch(scans=scans, stamps=run.stamps[stretch], poses=unwrapped, odometry=odometry[stretch])


def _ways(run: Run, motion: Motion, turn_factor: float) -> _Stretch | None:
    """Return the stretch of the longest distance by the odometry, its heading times a factor."""
    odometry = odometry_at_scans(run, motion)
    moved = np.hypot(*np.diff(odometry[:, :2], axis=0).T)
    return _compared(run, motion, odometry * [1.0, 1.0, turn_factor], moved, [0, 1])


def _as_logged(run: Run) -> Motion | None:
    """Return the odometry with an unwrapped heading, from an angle in radians or in degrees."""
    motion = odometry_of(run)
    if motion is None:
        return None
    logged = run.odometry if len(run.odometry) == len(motion.poses) else run.poses
    if len(logged) != len(motion.poses):
        return motion
    period = 360.0 if np.abs(logged[:, 2]).max() > MAX_RADIANS else 2 * np.pi
    phi = np.unwrap(logged[:, 2], period=period)
    return Motion(stamps=motion.stamps, poses=np.column_stack([motion.poses[:, :2], phi]))


def _steps(poses: Floats) -> Floats:
    """Return the steps (n - 1, 3): motion ahead and left in the frame of each pose, and turn."""
    return np.column_stack([compose(invert(poses[:-1]), poses[1:])[:, :2], np.diff(poses[:, 2])])


def _correlation(a: Floats, b: Floats) -> float:
    return float((a * b).sum() / max(np.sqrt((a**2).sum() * (b**2).sum()), 1e-12))


def _agrees(seen: Floats, driven: Floats) -> bool:
    """Tell whether enough steps of the odometry are about as large as those of the scans; a few may be jumps or slip."""
    is_moving = np.abs(seen) > MIN_STEP
    if is_moving.sum() < MIN_MOVING:
        return True
    ratio = driven[is_moving] / seen[is_moving]
    within = (ratio > 1 / MAX_RATIO) & (ratio < MAX_RATIO)
    return bool(within.mean() >= MAJORITY)


def _disagreement(seen: Floats, driven: Floats, what: str, unit: str) -> str:
    factor = np.abs(driven).sum() / np.abs(seen).sum()
    return (
        f"the odometry's {what} are {factor:.3g} times those of the scans and disagree step by step: not used; check that "
        f"they are in {unit}"
    )


def _confirmed(what: str) -> str:
    return (
        f"the odometry's {what} disagree with those of the scans step by step, but readings that do not go along with the robot "
        "confirm the odometry: the laser sees much that moves"
    )


def _ratio(seen: Floats, driven: Floats) -> float:
    """Return the ratio of the scans' motion to the odometry's: the median over steps, which resists single jumps."""
    seen, driven = np.abs(seen), np.abs(driven)
    is_moving = seen > MIN_STEP
    if is_moving.sum() < MIN_MOVING:
        return float(seen.sum() / max(driven.sum(), 1e-9))
    return float(1.0 / max(np.median(driven[is_moving] / seen[is_moving]), 1e-9))


def _factor(measured: float, what: str, units: dict[float, str], notes: list[str]) -> float:
    """Return the unit factor of distances or turns, and add a note; 1 if no unit matches."""
    for factor, name in units.items():
        if abs(np.log(measured / factor)) < TOLERANCE:
            notes.append(f"the odometry's {what} are {1 / measured:.4g} times too large: read as {name}")
            return factor
    return 1.0


def _scaled(run: Run, motion: Motion, way: float, turn: float) -> Run:
    """Return the run with its odometry rescaled, as its only odometry."""
    poses = motion.poses * [way, way, turn]
    return replace(
        _without_odometry(run),
        odom_stamps=motion.stamps,
        odometry=poses,
        odom_twists=np.zeros((len(poses), 2)),
    )


def _without_odometry(run: Run) -> Run:
    return replace(
        run,
        odom_stamps=np.zeros(0),
        odometry=np.zeros((0, 3)),
        odom_twists=np.zeros((0, 2)),
        pose_stamps=np.zeros(0),
        poses=np.zeros((0, 3)),
        pose_covariances=np.zeros((0, 3, 3)),
        meta={**run.meta, "pose_source": "none"},
    )
