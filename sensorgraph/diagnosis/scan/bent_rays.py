"""Derivatives of bent rays by the pose, from additional casts; a surface, an edge or a tilt bends a ray."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats
from sensorgraph.world.beams import Beams


def bent_columns(
    data: ScanData, model: Sequence[Amendment], beams: Beams
) -> tuple[Bools, Floats, Floats] | None:
    """Differentiate bent rays by the pose, with difference quotients of additional casts.

    Returns
    -------
    Which rays have columns (n_scans, n_rays), and the columns (n_scans, 3, n_rays). Then |d reading / d phi|
    (n_scans, n_rays) [m/rad] of all bent rays, including those where it is a jump. None without bent rays.
    """
    if beams.straight is None:
        return None
    which = ~beams.straight & np.isfinite(beams.reading)
    rows = np.flatnonzero(which.any(axis=1))
    if len(rows) == 0:
        return None
    few = data.subset(rows)
    quotients = np.zeros((data.n_scans, 3, data.n_rays))
    smooth = which.copy()
    steepness = np.zeros(which.shape)
    for axis, step in enumerate(SCAN.fit.pose_steps):
        scene = few.scene()
        scene.casts, scene.wanted = None, which[rows]
        scene.motion = _nudged(few, axis, step)
        moved = scene.run((*data.known, *model)).reading
        with np.errstate(invalid="ignore"):
            q = (moved - beams.reading[rows]) / step
        ok = np.isfinite(q) & (np.abs(q) < SCAN.fit.max_pose_slope)
        if axis == 2:
            steepness[rows] = np.where(np.isfinite(q), np.abs(q), SCAN.fit.max_pose_slope)
        smooth[rows] &= ok
        quotients[rows, axis] = np.where(ok, q, 0.0)
    return smooth, np.where(smooth[:, None, :], quotients, 0.0), np.where(which, steepness, 0.0)


def _nudged(data: ScanData, axis: int, step: float) -> Callable[[Floats], Floats]:
    offset = np.zeros(3)
    offset[axis] = step
    return lambda times: data.motion(times) + offset
