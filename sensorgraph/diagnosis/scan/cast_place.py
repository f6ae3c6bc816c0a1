"""Where casts are made: errors of map and reference are of first order in a reading, but they move outlines, too.

A cell of a map of pixels leaves open where in it a wall is, and a reference that is off by more than a reading's noise leaves
open which wall a ray meets. There casts are made at the likely walls and poses; their errors count from map and reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.gauss_newton import State
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.nuisance import MOUNT, POSE_LIKE
from sensorgraph.types import Floats


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


def for_model(data: ScanData, state: State, model: Sequence[Amendment]) -> State:
    """Return a state as a fit of another model begins with it: the laser of each scan stays where it is.

    Where casts are made at likely poses, these take what the model has lost of a mount or a delay, and give what it has gained;
    else every such effect would move all casts, by what the poses hold already.
    """
    values = pose_like(model)
    if data.posed is None or (values == state.effects).all():
        return replace(state, effects=values)
    off = as_pose_errors(data, state.effects - values)
    posed = None if state.posed is None else state.posed + off
    return replace(state, effects=values, delta=state.delta + off, posed=posed)


def pose_like(model: Sequence[Amendment]) -> Floats:
    """Return what the effects of a model say of mount and delay of the whole laser, (4,) [m, m, rad, s] as `nuisance.POSE_LIKE`."""
    out = np.zeros(len(POSE_LIKE))
    for amendment in (a for a in model if not a.place):
        for parameter in amendment.effect.parameters:
            if parameter.nuisance in POSE_LIKE:
                out[POSE_LIKE.index(parameter.nuisance)] += amendment[parameter.name]
    return out


def errors_of_laser(data: ScanData, state: State) -> Floats:
    """Return by what pose errors (n_scans, 3) [m, m, rad] the laser is where a state has it, with what its mount is off."""
    return state.delta + as_pose_errors(data, np.append(state.g[list(MOUNT)], 0.0))


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
