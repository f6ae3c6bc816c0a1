"""Tell what a run can be used for, from its signals and the ground that the robot covered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from logs.run import Run, pair
from logs.transforms import wrap
from logs.types import Floats

Verdict = Literal["yes", "limited", "no"]
NAMES = ("locate", "build", "diagnose laser", "diagnose wheels", "diagnose motors")


# limits below which a use is restricted; conventions, not fitted to data
MIN_SCANS = 10
"""Minimum number of scans of a drive."""
MIN_RETURNS = 0.2
"""Minimum share of rays with a return; an open place shows little structure."""
MIN_PAIRED = 0.5
"""Minimum share of scans with a pose."""
MIN_DISTANCE = 1.0
"""[m] shorter drives are a standstill or a turn on the spot."""
MIN_TURN = np.pi
"""[rad] with fewer turns, to both sides together, a drive is nearly straight."""
MIN_ONE_SIDE = 0.15
"""Minimum share of the turns to the rarer side."""
MIN_STEP = 0.05
"""[m, rad] smallest motion that is counted, so that noise at standstill does not add up."""
SAME_PLACE = 1.0
"""[m] positions that are closer show the same place ..."""
MIN_APART = 5.0
"""[m] ... if the robot drove at least this far between them."""
MAX_POSITIONS = 2000
"""Number of positions that are compared."""
MIN_CHANGES = 5
"""Minimum number of changes of the command."""


@dataclass(frozen=True, kw_only=True)
class Use:
    """One use of a log."""

    name: str
    verdict: Verdict
    why: str


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The motion of a log while it has scans, by its odometry or else by its poses."""

    distance: float
    """[m]"""
    left: float
    """[rad] sum of the turns to the left"""
    right: float
    """[rad]"""
    duration: float
    """[s]"""
    revisits: bool
    """Whether the robot returns to a place where it was before."""

    @property
    def turn(self) -> float:
        """Return the sum of all turns [rad]."""
        return self.left + self.right

    def __str__(self) -> str:
        return f"{self.distance:.1f} m, {self.turn:.1f} rad of turns, {self.duration / 60:.1f} min"

    def to_dict(self) -> dict[str, float | bool | None]:
        """Return the motion as plain data; None: not finite."""
        values = {
            "distance_m": self.distance,
            "turn_rad": self.turn,
            "left_rad": self.left,
            "right_rad": self.right,
            "minutes": self.duration / 60,
        }
        plain = {name: value if np.isfinite(value) else None for name, value in values.items()}
        return {**plain, "revisits": self.revisits}


def ground_of(run: Run) -> Ground | None:
    """Return the ground that the robot covered between the first and the last scan, or in all the log if it has no scans.

    None if the log has neither odometry nor poses.
    """
    first, last = run.stamps[[0, -1]] if run.n_scans else (-np.inf, np.inf)
    tracks = [
        track[np.isfinite(track).all(axis=1) & (stamps >= first) & (stamps <= last)]
        for stamps, track in ((run.odom_stamps, run.odometry), (run.pose_stamps, run.poses))
        if len(track) > 1
    ]
    if not tracks:
        return None
    moves = [(_points(track), _headings(track)) for track in tracks]
    # odometry that never moves shows nothing
    points, headings = next((move for move in moves if len(move[0]) + len(move[1]) > 2), moves[0])
    turns, lengths = wrap(np.diff(headings)), np.hypot(*np.diff(points, axis=0).T)
    return Ground(
        distance=float(lengths.sum()),
        left=float(turns[turns > 0].sum()),
        right=float(np.abs(turns[turns < 0]).sum()),
        duration=float(last - first) if run.n_scans else run.duration,
        revisits=_revisits(points, lengths),
    )


def _points(poses: Floats) -> Floats:
    """Return the positions (n_kept, 2), each at least a step from the previous one."""
    kept: list[tuple[float, float]] = []
    for x, y in poses[:, :2].tolist():
        if not kept or math.hypot(x - kept[-1][0], y - kept[-1][1]) > MIN_STEP:
            kept.append((x, y))
    return np.array(kept).reshape(-1, 2)


def _headings(poses: Floats) -> Floats:
    """Return the headings (n_kept,), each at least a step from the previous one."""
    kept: list[float] = []
    for phi in poses[:, 2].tolist():
        if not kept or abs((phi - kept[-1] + np.pi) % (2 * np.pi) - np.pi) > MIN_STEP:
            kept.append(phi)
    return np.array(kept)


def _revisits(points: Floats, lengths: Floats) -> bool:
    """Return whether a path (n, 2) comes back to a place; lengths (n - 1,) [m] of its steps."""
    some = np.unique(np.linspace(0, len(points) - 1, min(len(points), MAX_POSITIONS)).astype(np.intp))
    along = np.concatenate([[0.0], np.cumsum(lengths)])[some]
    for k, point in enumerate(points[some]):
        before = along < along[k] - MIN_APART
        near = np.hypot(*(points[some] - point).T) < SAME_PLACE
        if (before & near).any():
            return True
    return False


def uses_of(run: Run, ground: Ground | None) -> tuple[Use, ...]:
    """Return what the run can be used for, one entry for each of `NAMES`."""
    locate = _locate(run, ground)
    rows = (
        locate,
        _build(run, locate[0]),
        _laser(run, ground, locate[0]),
        _wheels(run, ground),
        _motors(run),
    )
    return tuple(
        Use(name=name, verdict=verdict, why=why) for name, (verdict, why) in zip(NAMES, rows, strict=True)
    )


def no_use() -> tuple[Use, ...]:
    """Return the entries of a log that cannot be read as a run."""
    return tuple(Use(name=name, verdict="no", why="it is not read as a run, see `missing`") for name in NAMES)


def _locate(run: Run, ground: Ground | None) -> tuple[Verdict, str]:
    finite = np.isfinite(run.ranges)
    if run.sensor.cones.any():
        return "no", "its sensors measure in wide cones; locate takes a laser"
    if run.n_scans < MIN_SCANS:
        return "no", f"{run.n_scans} scans, {MIN_SCANS} are needed"
    if not finite.any():
        return "no", "no ray ever returns"
    if finite.mean() < MIN_RETURNS:
        return "limited", f"only {100 * finite.mean():.0f} % of the rays return"
    if not len(run.odom_stamps):
        return "limited", "no odometry: motion along a corridor, or in the open, cannot be followed"
    if ground is not None and ground.distance < MIN_DISTANCE and ground.turn < MIN_STEP:
        return (
            "limited",
            "the odometry never moves: motion along a corridor, or in the open, cannot be followed",
        )
    return "yes", f"{run.n_scans:,} scans, and odometry{_from(run.meta, 'odom_topic')}"


def _build(run: Run, locate: Verdict) -> tuple[Verdict, str]:
    if not _has_reference(run):
        what = "its poses are odometry" if len(run.pose_stamps) else "it has no reference poses"
        if locate == "no":
            return "no", f"{what}, and it cannot be located"
        return "limited", f"{what}: it is located first, and the map is as good as these poses"
    share = float(pair(run).paired.mean()) if run.n_scans else 0.0
    if share == 0:
        return "no", "no scan has a pose"
    if run.n_scans < MIN_SCANS:
        return "no", f"{run.n_scans} scans, {MIN_SCANS} are needed"
    text = f"poses{_from(run.meta, 'pose_source')} for {100 * share:.0f} % of the scans"
    return ("yes" if share >= MIN_PAIRED else "limited"), text


def _laser(run: Run, ground: Ground | None, locate: Verdict) -> tuple[Verdict, str]:
    if locate == "no" and not _has_reference(run):
        return "no", "it needs scans that can be located, or reference poses"
    if ground is None:
        return "limited", "without odometry and reference, only ranges and missing returns are tested"
    if ground.turn < MIN_TURN:
        return "limited", f"only {ground.turn:.1f} rad of turns: the mount and the clock hardly show"
    if not _has_reference(run):
        return "limited", "no reference poses: located ones follow errors of the mount and the clock"
    return "yes", "reference poses and turns; give the arena and the robot"


def _wheels(run: Run, ground: Ground | None) -> tuple[Verdict, str]:
    if not len(run.odom_stamps):
        return "no", "no odometry"
    if ground is None or (ground.distance < MIN_DISTANCE and ground.turn < MIN_TURN):
        return (
            "limited",
            f"the robot hardly moves ({ground}): large errors only" if ground else "it hardly moves",
        )
    if ground.turn < MIN_TURN:
        return "limited", f"only {ground.turn:.1f} rad of turns: the wheelbase is uncertain"
    if ground.distance < MIN_DISTANCE:
        return "limited", f"only {ground.distance:.1f} m of driving: the wheel radius is uncertain"
    return "yes", f"{ground.distance:.1f} m and {ground.turn:.1f} rad of turns"


def _motors(run: Run) -> tuple[Verdict, str]:
    if not len(run.cmd_stamps):
        return "no", "no commands (/cmd_vel)"
    if not len(run.odom_stamps) and not len(run.pose_stamps):
        return "no", "neither odometry nor poses show how the robot follows its commands"
    n = int((np.diff(run.commands, axis=0) != 0).any(axis=1).sum())
    if n < MIN_CHANGES:
        return "limited", f"the commands change only {n} times: delay and lag hardly show"
    return "yes", f"{len(run.cmd_stamps):,} commands, {n:,} changes"


def _has_reference(run: Run) -> bool:
    return len(run.pose_stamps) > 0 and not run.meta.get("pose_source", "").startswith("odometry")


def _from(meta: Mapping[str, str], key: str) -> str:
    return f" from {meta[key]}" if meta.get(key) else ""


def advice(run: Run, ground: Ground | None) -> str:
    """Return the minute of driving, or the signal, that would help most; empty if nothing is missing."""
    if ground is None:
        return "record the odometry (/odom, or /tf odom -> base_link): scans alone do not show every motion"
    if ground.distance < MIN_DISTANCE and ground.turn < MIN_TURN:
        return "drive a loop of some metres with turns to both sides: the robot hardly moves in this log"
    if ground.turn < MIN_TURN:
        return f"drive loops with turns to both sides: the log has {ground.distance:.0f} m of nearly straight motion"
    if ground.distance < MIN_DISTANCE:
        return f"drive some metres: the robot turned by {ground.turn:.0f} rad, but drove only {ground.distance:.1f} m"
    rarer, name = min((ground.left, "left"), (ground.right, "right"))
    if rarer < MIN_ONE_SIDE * ground.turn:
        return f"drive turns to the {name}: they are {100 * rarer / ground.turn:.0f} % of all, so that the errors of the two wheels cannot be distinguished"
    if not ground.revisits and not _has_reference(run):
        return "return to places that were seen before: without a loop, drift stays in the map"
    if not len(run.cmd_stamps):
        return "record the commands (/cmd_vel), to test the motors"
    return ""
