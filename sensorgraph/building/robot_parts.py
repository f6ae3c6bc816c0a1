"""Which rays end at the robot itself, such as at posts beside the laser.

Such a ray has the same range wherever the robot is. So has one to a wall that the robot follows; but scans from elsewhere look
through the places where a part of the robot was, and not through a wall.
"""

from __future__ import annotations

import numpy as np

from logs.run import Pairing, Run
from logs.transforms import wrap
from sensorgraph.types import Bools, Floats
from sensorgraph.world.raycast import laser_poses

REACH = 1.0
"""[m] Maximum distance of a part of the robot from its laser."""
MARGIN = 0.05
"""[m] Deviation from the median range of a ray within which its readings are the same: noise, and parts that vibrate."""
MIN_SAME = 0.9
"""Minimum share of the readings of a ray that are the same."""
MIN_MOVED = 0.5
"""[m] Minimum distance of a scan from another one that looks at the same place."""
MIN_THROUGH = 0.5
"""Minimum share of the places that other scans look through, of those that they see."""
MAX_SCANS = 300
"""Maximum number of scans that are compared."""


def rays_on_robot(run: Run, pairing: Pairing) -> Bools:
    """Tell which rays (n_rays,) end at the robot itself; none if it did not move, and for several lasers."""
    none = np.zeros(run.sensor.n_rays, dtype=np.bool_)
    paired = np.flatnonzero(pairing.paired)
    if len(paired) < 2 or run.sensor.is_composite or run.sensor.cones.any():
        return none
    some = paired[np.unique(np.linspace(0, len(paired) - 1, min(len(paired), MAX_SCANS)).astype(np.intp))]
    ranges = run.ranges[some]
    middle = np.median(np.where(np.isnan(ranges), np.inf, ranges), axis=0)
    with np.errstate(invalid="ignore"):  # the difference of two missing returns
        same = (np.abs(ranges - middle) < MARGIN).mean(axis=0)
    fixed = np.flatnonzero((middle < REACH) & (same >= MIN_SAME))
    if len(fixed) == 0:
        return none
    poses = pairing.poses[some]
    lasers = poses if run.pose_frame == "laser" else laser_poses(poses, run.sensor.mount)
    heading = lasers[:, 2, None] + run.sensor.bearings[fixed]
    away = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    ends = lasers[:, None, :2] + middle[fixed, None] * away
    seen, through = np.zeros(len(fixed)), np.zeros(len(fixed))
    for i, laser in enumerate(lasers):
        elsewhere = np.hypot(*(lasers[i:, :2] - laser[:2]).T) > MIN_MOVED
        if elsewhere.any():
            other = i + int(np.argmax(elsewhere))
            visible, free = _looked_at(ends[i], lasers[other], ranges[other], run.sensor.bearings)
            seen += visible
            through += free
    none[fixed] = through > MIN_THROUGH * np.maximum(seen, 1.0)
    return none


def _looked_at(places: Floats, laser: Floats, ranges: Floats, bearings: Floats) -> tuple[Bools, Bools]:
    """Return which places (n, 2) [m] a scan from `laser` (3,) sees, and which of these it looks through."""
    to = places - laser[:2]
    far, bearing = np.hypot(*to.T), np.arctan2(to[:, 1], to[:, 0]) - laser[2]
    nearest = np.abs(wrap(bearing[:, None] - bearings)).argmin(axis=1)
    reading = ranges[nearest]
    visible = np.isfinite(reading) & (reading > far - 2 * MARGIN)
    return visible, visible & (reading > far + 2 * MARGIN)


def robot_parts_text(on_robot: Bools, bearings: Floats) -> str:
    """Return the warning on the rays (n_rays,) that end at the robot itself."""
    index = np.flatnonzero(on_robot)
    groups = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    spans = [np.degrees(bearings[group[[0, -1]]]) for group in groups]
    shown = ", ".join(f"{first:.0f}° to {last:.0f}°" for first, last in spans[:5])
    more = ", ..." if len(spans) > 5 else ""
    return (
        f"{len(index)} of {len(bearings)} rays see the robot itself, at bearings {shown}{more}: their range stays the same while "
        "the robot moves; they were left out"
    )
