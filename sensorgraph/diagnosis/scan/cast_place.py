"""Choose the walls and poses at which casts are made.

To first order, map and pose errors only shift a reading. However, they also move outlines, and a ray may then meet
another wall. Two cases need a better place for the cast: a wall within a cell of an occupancy-grid map, and a reference
whose error exceeds the noise of a reading. In these cases, casts are made at the most likely walls and poses. The errors
are still counted from the map and the reference poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.nuisance import State
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.nuisance import MOUNT, POSE_LIKE
from sensorgraph.types import Floats


def as_cast(data: ScanData, state: State, *, same_scans: bool = True) -> ScanData:
    """Return data with the walls and poses of the cast of a state, or with its current ones if it has no cast.

    Parameters
    ----------
    same_scans : Whether the state belongs to these scans; otherwise their poses are kept.
    """
    laid = data.laid_by(state.corners if state.laid is None else state.laid)
    if data.posed is None or not same_scans:
        return laid
    return laid.posed_by(errors_of_laser(data, state) if state.posed is None else state.posed)


def is_cast_at(data: ScanData, state: State) -> bool:
    """Return whether data is cast at the walls and poses of a state, within a small fraction of the tolerances."""
    if not data.is_laid_by(state.corners):
        return False
    if data.posed is None:
        return True
    t = data.tolerances
    off = np.abs(errors_of_laser(data, state) - data.posed) / [t.pose_xy, t.pose_xy, t.pose_yaw]
    return bool(off.max() <= SCAN.fit.settled_step)


def for_model(data: ScanData, state: State, model: Sequence[Amendment]) -> State:
    """Return the start state for the fit of another model, with the laser of each scan at the same place.

    The pose errors compensate each change of mount and delay in the model, because the poses have absorbed such an effect before
    it is in the model. Otherwise it would count twice at the start, and most readings would look like outliers.
    """
    values = pose_like(model)
    if (values == state.effects).all():
        return state
    off = as_pose_errors(data, state.effects - values)
    posed = None if state.posed is None else state.posed + off
    return replace(state, effects=values, delta=state.delta + off, posed=posed)


def pose_like(model: Sequence[Amendment]) -> Floats:
    """Return mount and delay of the whole laser in a model, (4,) [m, m, rad, s], in the order of `nuisance.POSE_LIKE`."""
    out = np.zeros(len(POSE_LIKE))
    for amendment in (a for a in model if not a.place):
        for parameter in amendment.effect.parameters:
            if parameter.nuisance in POSE_LIKE:
                out[POSE_LIKE.index(parameter.nuisance)] += amendment[parameter.name]
    return out


def errors_of_laser(data: ScanData, state: State) -> Floats:
    """Return the pose errors (n_scans, 3) [m, m, rad] of the laser in a state, including its mount error."""
    return state.delta + as_pose_errors(data, np.append(state.g[list(MOUNT)], 0.0))


def as_pose_errors(data: ScanData, off: Floats) -> Floats:
    """Return the pose errors (n_scans, 3) [m, m, rad] that are equivalent to an error of mount and delay.

    Parameters
    ----------
    off : (4,) [m, m, rad, s] Error of mount and delay, in the order of `POSE_LIKE`.
    """
    x, y, yaw, late = off
    ahead, aside = data.sensor.mount[:2]
    x, y = x + yaw * aside, y - yaw * ahead  # the laser turns about itself, but a pose turns about the base
    c, s = np.cos(data.poses[:, 2]), np.sin(data.poses[:, 2])
    mounted = np.column_stack([c * x - s * y, s * x + c * y, np.full(data.n_scans, yaw)])
    return np.asarray(mounted - late * data.twists)
