"""Compiled kernel for the motion lost in slippery discs; called for hundreds of discs at a time."""

from __future__ import annotations

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats


@kernel
def lost_inside(
    left_at: Floats, right_at: Floats, left: Floats, right: Floats, track: float, discs: Floats, rim: float
) -> tuple[Floats, Floats]:
    """Return distance [m] and turn [rad] (n_increments, n_discs) that two points of the body lose inside discs.

        lost     = length clip((r - d) / rim + 1/2, 0, 1)      for each point
        distance = (lost_left + lost_right) / 2,   turn = (lost_right - lost_left) / track

    d is the distance of the point from the centre of the disc.

    Parameters
    ----------
    left_at, right_at : (n_increments, 2) [m, map] Positions of the points.
    left, right : (n_increments,) [m] Signed lengths of their paths.
    track : [m] Distance between them.
    discs : (n_discs, 3) x, y, r [m, map].
    rim : [m] Width of the edge.
    """
    n, k = len(left), len(discs)
    x, y = discs[:, 0].copy(), discs[:, 1].copy()
    per_way = 1 / rim
    until = discs[:, 2] * per_way + 0.5
    distance, turn = np.empty((n, k)), np.empty((n, k))
    for i in range(n):
        for j in range(k):
            dx, dy = left_at[i, 0] - x[j], left_at[i, 1] - y[j]
            lost_left = left[i] * min(max(until[j] - np.sqrt(dx * dx + dy * dy) * per_way, 0.0), 1.0)
            dx, dy = right_at[i, 0] - x[j], right_at[i, 1] - y[j]
            lost_right = right[i] * min(max(until[j] - np.sqrt(dx * dx + dy * dy) * per_way, 0.0), 1.0)
            distance[i, j] = (lost_left + lost_right) / 2
            turn[i, j] = (lost_right - lost_left) / track
    return distance, turn
