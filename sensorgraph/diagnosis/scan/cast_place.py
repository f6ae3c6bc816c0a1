"""Where casts are made: errors of map and reference are of first order in a reading, but they move outlines, too.

A cell of a map of pixels leaves open where in it a wall is, and a reference that is off by more than a reading's noise leaves
open which wall a ray meets. There casts are made at the likely walls and poses; their errors count from map and reference.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.scan.gauss_newton import State
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats

MOUNT = [Nuisance.MOUNT_X, Nuisance.MOUNT_Y, Nuisance.MOUNT_YAW]
POSE_LIKE = [*MOUNT, Nuisance.DELAY]
"""What moves the laser of a scan as an error of its pose does."""


def as_cast(data: ScanData, state: State, *, same_scans: bool = True) -> ScanData:
    """Return data with walls and poses where the cast of a state had them, or where the state has them now if it has none.

    Parameters
    ----------
    same_scans : the state is of these scans; False: their poses stay
    """
    laid = data.laid_by(state.corners if state.laid is None else state.laid)
    if data.posed is None or not same_scans:
        return laid
    return laid.posed_by(errors_of_laser(data, state) if state.posed is None else state.posed)


def is_cast_at(data: ScanData, state: State) -> bool:
    """Tell whether a cast of this data is at the walls and poses of a state, but for a small share of their tolerances."""
    if not data.is_laid_by(state.corners):
        return False
    if data.posed is None:
        return True
    t = data.tolerances
    off = np.abs(errors_of_laser(data, state) - data.posed) / [t.pose_xy, t.pose_xy, t.pose_yaw]
    return bool(off.max() <= SCAN.fit.settled_step)


def begun_at_cast(data: ScanData, amendment: Amendment) -> Amendment:
    """Return a further effect as a fit should begin with it where casts are made at likely poses: these hold a mount or a delay
    already, so that one of the size that is expected would move all casts by as much again.
    """
    if data.posed is None:
        return amendment
    held = {p.name: 0.0 for p in amendment.effect.parameters if p.nuisance in POSE_LIKE}
    return amendment.moved_to(held) if held else amendment


def errors_of_laser(data: ScanData, state: State) -> Floats:
    """Return by what pose errors (n_scans, 3) [m, m, rad] the laser is where a state has it, with what its mount is off."""
    return state.delta + as_pose_errors(data, np.append(state.g[MOUNT], 0.0))


def as_pose_errors(data: ScanData, off: Floats) -> Floats:
    """Return the pose errors (n_scans, 3) [m, m, rad] that look like a mount and a delay that are off by so much.

    Parameters
    ----------
    off : (4,) [m, m, rad, s] in the order of `POSE_LIKE`
    """
    x, y, yaw, late = off
    ahead, aside = data.sensor.mount[:2]
    x, y = x + yaw * aside, y - yaw * ahead  # the laser turns about itself, a pose about the base
    c, s = np.cos(data.poses[:, 2]), np.sin(data.poses[:, 2])
    mounted = np.column_stack([c * x - s * y, s * x + c * y, np.full(data.n_scans, yaw)])
    return np.asarray(mounted - late * data.twists)


def moved_as_poses(before: Sequence[Amendment], after: Sequence[Amendment]) -> Floats:
    """Return by how much (4,) [m, m, rad, s] the effects of a model have moved mount and delay, in the order of `POSE_LIKE`."""
    moved = np.zeros(len(POSE_LIKE))
    for old, new in zip(before, after, strict=True):
        for parameter in old.effect.parameters:
            if parameter.nuisance in POSE_LIKE and not old.place:
                moved[POSE_LIKE.index(parameter.nuisance)] += new[parameter.name] - old[parameter.name]
    return moved
