"""The mount of a laser in base_link, from the transform tree of a ROS log."""

from __future__ import annotations

import numpy as np

from logs.ros.laser_scan import LaserScans
from logs.ros.poses import BASE_FRAMES, FLOOR_FRAME, MIN_LEVEL
from logs.ros.transform_tree import RelativePose, TransformTree
from logs.transforms import wrap
from logs.types import Floats

MAX_VERTICAL_COSINE = 0.7
"""Cosine of the minimum tilt (46°) of an optical frame: its z axis looks ahead, more or less."""
OPTICAL = "optical"
"""Word in the names of frames with z ahead and x to the right (REP 103), in whose x-y plane no scan of a room can be."""


def mount_in_tree(tree: TransformTree, base: str | None, scans: LaserScans) -> tuple[Floats, float, bool]:
    """Return the mount (3,) in base_link, the height [m] above the floor if known, and whether it is upside down.

    The bearings of scans in an optical frame are those of the frame with x ahead: nodes that convert depth images to scans
    may be given either frame.
    """
    if scans.frame in (*BASE_FRAMES, base):
        return np.zeros(3), 0.0, False
    place = tree.place(base, scans.frame) if base is not None else None
    if place is None:
        scans.notes.append(
            f"no transform base_link -> {scans.frame or 'laser'}: the mount of robot.yaml is used if given, otherwise 0"
        )
        return np.zeros(3), 0.0, False
    is_optical = _is_optical(scans.frame, place)
    if is_optical:
        scans.notes.append(
            f"the scans are in the optical frame {scans.frame}, whose z axis looks ahead: their bearings were read as those "
            "of the frame with x ahead"
        )
    elif abs(place.up) < MIN_LEVEL:
        scans.notes.append(
            f"the laser is tilted by {np.degrees(np.arccos(abs(place.up))):.0f}°, but assumed to be level"
        )
    if not place.is_static and place.moves:
        scans.notes.append(place.moving_text)
    floor = tree.in_namespace_of(scans.frame, FLOOR_FRAME)
    above_floor = tree.place(floor, scans.frame) or place
    mount = place.poses[0] + [0.0, 0.0, np.pi / 2 if is_optical else 0.0]  # from x to the right to x ahead
    mount[2] = wrap(mount[2])
    return mount, above_floor.height, place.up < 0 and not is_optical


def _is_optical(frame: str, place: RelativePose) -> bool:
    """Return whether a frame is an optical one by its name and by its pose in base_link."""
    return OPTICAL in frame.lower() and abs(place.up) < MAX_VERTICAL_COSINE
