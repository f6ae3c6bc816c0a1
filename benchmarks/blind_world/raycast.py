"""Rays against walls, discs and segments."""

from __future__ import annotations

import numba
import numpy as np

from benchmarks.blind_world.rooms import Floats


@numba.njit(cache=True)
def cast(x, y, dx, dy, walls, skipped):  # type: ignore[no-untyped-def]
    """Return the nearest wall of each ray.

    Parameters
    ----------
    x, y, dx, dy : (n,) [m] where rays start, and unit vectors
    walls : (n_walls, 4) [m]
    skipped : (n,) index of a wall that a ray does not see, or -1

    Returns
    -------
    (range [m], inf: none; index of the wall, -1: none; share of the wall's length), each (n,)
    """
    n = x.size
    ranges, index, share = np.full(n, np.inf), np.full(n, -1, np.int64), np.zeros(n)
    for i in range(n):
        for j in range(walls.shape[0]):
            if j == skipped[i]:
                continue
            ex, ey = walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
            cross = dx[i] * ey - dy[i] * ex
            if cross == 0.0:
                continue
            ax, ay = walls[j, 0] - x[i], walls[j, 1] - y[i]
            t = (ax * ey - ay * ex) / cross
            if t <= 1e-9 or t >= ranges[i]:
                continue
            k = (ax * dy[i] - ay * dx[i]) / cross
            if k >= -1e-9 and k <= 1 + 1e-9:
                ranges[i], index[i], share[i] = t, j, k
    return ranges, index, share


def through_disc(
    x: Floats, y: Floats, dx: Floats, dy: Floats, cx: Floats | float, cy: Floats | float, radius: float
) -> tuple[Floats, Floats]:
    """Return where rays enter and leave a disc [m]; inf and -inf where they miss it."""
    ax, ay = cx - x, cy - y
    along = ax * dx + ay * dy
    inside = along * along - (ax * ax + ay * ay - radius * radius)
    half = np.sqrt(np.maximum(inside, 0))
    enters, leaves = along - half, along + half
    is_hit = (inside > 0) & (leaves > 0)
    return np.where(is_hit, np.maximum(enters, 1e-3), np.inf), np.where(is_hit, leaves, -np.inf)


def to_segment(
    x: Floats, y: Floats, dx: Floats, dy: Floats, ends: tuple[Floats | float, ...] | Floats
) -> Floats:
    """Return the range (n,) [m] of rays to a segment (x, y of one end, then of the other), inf: missed."""
    x0, y0, x1, y1 = ends
    ex, ey = x1 - x0, y1 - y0
    cross = dx * ey - dy * ex
    cross = np.where(cross == 0, 1e-12, cross)
    ax, ay = x0 - x, y0 - y
    t, k = (ax * ey - ay * ex) / cross, (ax * dy - ay * dx) / cross
    return np.where((t > 1e-6) & (k >= 0) & (k <= 1), t, np.inf)
