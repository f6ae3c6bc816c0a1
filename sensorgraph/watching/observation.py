"""One scan with what the robot knew at that time: its odometry and the pose that it believes."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.errors import SensorgraphError, refuse_wrong_types
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.sensor_model_input import numbers_of
from sensorgraph.types import Floats
from sensorgraph.watching.settings import TRACKING

logger = logging.getLogger(__name__)

MAX_SILENCE = 1.0
"""[s] after the last odometry, and before the first, from which on it is unknown."""
MAX_AGE = 5.0
"""[s] An older pose is no longer believed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """One scan of a robot.

    Raises
    ------
    SensorgraphError : The stamp is no number, or an array has another shape or holds no numbers.
    """

    stamp: float
    """[s]"""
    ranges: Floats
    """(n_rays,) [m]; +inf: no return, -inf: too close, nan: broken."""
    odometry: Floats | None = None
    """(3,) [m, m, rad] base_link in odom; None: unknown."""
    believed: Floats | None = None
    """(3,) [m, m, rad] base_link in map, as the robot believes; None: unknown."""

    def __post_init__(self) -> None:
        refuse_wrong_types({"stamp": self.stamp}, {"stamp": float})
        for name, shape in (("ranges", None), ("odometry", (3,)), ("believed", (3,))):
            value = getattr(self, name)
            if value is None and shape is not None:
                continue
            numbers = numbers_of(value, name)
            if numbers.shape != (shape or (numbers.size,)):
                wanted = "(n_rays,)" if shape is None else "(3,): x, y, phi"
                raise SensorgraphError(f"{name} has shape {numbers.shape}, expected {wanted}")
            object.__setattr__(self, name, numbers)


def believed_poses(run: Run) -> tuple[Floats, Floats] | None:
    """Return the stamps (n,) and poses (n, 3) that the robot believed; None if the log has only odometry."""
    known = np.isfinite(run.poses).all(axis=1)
    if not known.any() or run.meta.get("pose_source", "").startswith(("odometry", "none")):
        return None
    poses = run.poses[known]
    base = compose(poses, invert(run.sensor.mount)) if run.pose_frame == "laser" else poses
    return run.pose_stamps[known], base


def usual_speed(stamps: Floats, odometry: Floats) -> float:
    """Return the median speed [m/s] of the odometry (n_scans, 3) between scans at stamps (n_scans,), where it moves."""
    ways, steps = np.hypot(*np.diff(odometry[:, :2], axis=0).T), np.diff(stamps)
    moves = (ways > 0) & (steps > 0)
    return float(np.median(ways[moves] / steps[moves])) if moves.any() else 0.0


def observations(run: Run, *, after: float = -np.inf) -> Iterator[Observation]:
    """Yield the scans of a run in order, those after a stamp [s].

    Between two believed poses, the odometry continues the earlier one, as the robot itself does.
    """
    motion = odometry_of(run)
    odometry = None if motion is None else odometry_at_scans(run, motion)
    if odometry is not None and (speed := usual_speed(run.stamps, odometry)) > TRACKING.max_speed:
        logger.warning("the odometry moves by %.3g m/s and is not used; check that it is in metres", speed)
        motion = odometry = None
    belief = believed_poses(run)
    first, last_known = -np.inf, np.inf
    if motion is not None and len(motion.stamps):
        first, last_known = motion.stamps[0] - MAX_SILENCE, motion.stamps[-1] + MAX_SILENCE
    for k in np.flatnonzero(run.stamps > after):
        stamp = float(run.stamps[k])
        now = odometry[k] if odometry is not None and first <= stamp <= last_known else None
        believed = None
        if belief is not None:
            last = int(np.searchsorted(belief[0], stamp, side="right")) - 1
            if last >= 0 and stamp - belief[0][last] <= MAX_AGE:
                believed = belief[1][last]
                if motion is not None and now is not None and belief[0][last] < stamp:
                    then = motion.at(np.array([belief[0][last]]))[0]
                    believed = compose(believed, compose(invert(then), now))
        yield Observation(stamp=stamp, ranges=run.ranges[k], odometry=now, believed=believed)
