"""Checks that refuse a log before it is used, unless the user forces it, and the notes on assumptions made."""

from __future__ import annotations

import numpy as np

from logs.alternating_scans import alternating_text
from logs.jumps import find_jumps
from logs.notes import assumptions_of
from logs.range_limits import BEYOND, median_text
from logs.ros.transform_tree import MOVES
from logs.run import Pairing, RangeSensor, Run
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Floats, Ints
from sensorgraph.world.described import MOUNT
from sensorgraph.world.overlap import MAX_CONTRADICTION, contradiction
from sensorgraph.world.raycast import laser_poses
from sensorgraph.world.sweep import FROM_ROBOT

STANDSTILL = 1e-3
"""[m, rad] Poses of a run that vary by less than this are constant."""
MIN_WHEEL_DISTANCE = 0.5
"""[m] Distance of the odometry above which the wheels certainly drove."""


def log_notes(*runs: Run) -> list[str]:
    """Return the notes on assumed, repaired and omitted data of runs, without repetition, each with its log's name."""
    return list(
        dict.fromkeys(
            f"{run.meta.get('source', 'the run')}: {note}" for run in runs for note in assumptions_of(run)
        )
    )


def check_jumps(
    run: Run,
    pairing: Pairing,
    *,
    force: bool,
    name: str | None = None,
    last: tuple[Floats, Floats] = (np.zeros(0), np.zeros((0, 3))),
) -> None:
    """Refuse a run whose pose jumps between consecutive scans, unless `force` is set.

    Not the distance decides, but whether the scans contradict each other where they overlap (`overlap`): a log may hold a
    scan every few metres, or lack stretches.

    Parameters
    ----------
    last : Stamp (1,) and pose (1, 3) of the preceding scan, if the run is a piece of a log.

    Raises
    ------
    SensorgraphError : A pose jumps farther than a robot can drive, and the scans contradict each other.
    """
    if force:
        return
    stamps = np.concatenate([last[0], run.stamps[pairing.paired]])
    poses = np.concatenate([last[1], pairing.poses[pairing.paired]])
    jumps = find_jumps(stamps, poses, is_timed=run.meta.get("clock") != "assumed")
    if jumps is None:
        return
    share = _contradiction(run, pairing, jumps.after - len(last[0]))
    if not share > MAX_CONTRADICTION:
        return
    raise SensorgraphError(
        f"{name or run.meta.get('source', 'the run')}: {jumps}, and {100 * share:.0f} % of the points lie where scans beyond "
        "a jump saw through; expected poses along which a robot can drive: check the "
        "clocks and the source of the poses (sensorgraph inspect), or set `force` to use them as they are"
    )


def check_ranges(run: Run, name: str) -> None:
    """Refuse a run whose ranges are in another unit than metres, of two scanners on one topic, or of a laser that moves.

    Raises
    ------
    SensorgraphError : The median range is that of millimetres or centimetres, the scans alternate between two views, or the
        transforms move the laser on the robot and no robot.yaml states its mount.
    """
    notes = assumptions_of(run)
    moves = next((note for note in notes if MOVES in note), "")
    if moves and run.meta.get(MOUNT) != FROM_ROBOT:
        raise SensorgraphError(
            f"{name}: {moves}. Poses of the robot would be wrong by as much: select a laser that is fixed with `topics` scan=NAME, "
            "or state the mount in a robot.yaml if the transforms are wrong"
        )
    beyond = next((note for note in notes if note.startswith(BEYOND)), "")
    if beyond and not np.isfinite(run.ranges).any():
        raise SensorgraphError(f"{name}: {beyond}")
    if text := median_text(run.ranges) or alternating_text(run.ranges):
        raise SensorgraphError(f"{name}: {text}")


def check_returns(run: Run, name: str = "the run") -> None:
    """Refuse a run without a return, and those of `check_ranges`.

    Raises
    ------
    SensorgraphError : No ray ever returned, or as in `check_ranges`.
    """
    check_ranges(run, name)
    if not np.isfinite(run.ranges).any():
        raise SensorgraphError(
            f"no ray of {name} ever returned; check the topic of the scans with `sensorgraph inspect`"
        )


def check_moves(run: Run) -> None:
    """Refuse a run whose reference pose is constant while the wheels drive.

    Raises
    ------
    SensorgraphError : The poses are constant and the odometry moves.
    """
    still = len(run.poses) > 1 and float(np.ptp(run.poses, axis=0).max()) < STANDSTILL
    if not still or not len(run.odometry):
        return
    distance = float(np.hypot(*np.diff(run.odometry[:, :2], axis=0).T).sum())
    if distance > MIN_WHEEL_DISTANCE:
        raise SensorgraphError(
            f"the reference pose is constant while the wheels drive {distance:.1f} m; "
            "select the topic of the reference with `topics` pose=..."
        )


def _contradiction(run: Run, pairing: Pairing, after: Ints) -> float:
    """Return the share of points that scans beyond a jump saw through; nan where this cannot be decided.

    It cannot be decided without overlap, and for cones or several sensors.

    Parameters
    ----------
    after : Indices of the paired scans after each jump.
    """
    if run.sensor.cones.any() or run.sensor.is_composite:
        return float("nan")
    poses = pairing.poses[pairing.paired]
    lasers = poses if run.pose_frame == "laser" else laser_poses(poses, run.sensor.mount)
    part = np.searchsorted(after, np.arange(len(poses)), side="right")
    return contradiction(run.ranges[pairing.paired], lasers, part, run.sensor)


def check_rays(sensor: RangeSensor, name: str, *, takes: str, remedy: str, one_place: bool = True) -> None:
    """Refuse wide cones, and rays with several origins, for functions that do not support them.

    Parameters
    ----------
    takes : Subject and verb of the message, such as "locate takes".
    remedy : What the user can do.
    one_place : Whether all rays must have the same origin.

    Raises
    ------
    SensorgraphError : The sensor has such rays.
    """
    if measures_cones(sensor):
        widest = np.degrees(sensor.cones.max())
        raise SensorgraphError(
            f"{name} measures the nearest surface in cones of {widest:.0f}°; {takes} thin rays: {remedy}"
        )
    if one_place and sensor.is_composite:
        raise SensorgraphError(
            f"{name} has rays from several places; {takes} the rays of one laser: {remedy}"
        )
