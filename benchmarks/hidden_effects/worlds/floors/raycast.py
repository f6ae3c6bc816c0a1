"""Nearest hits of rays on walls (straight segments) and on discs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from benchmarks.hidden_effects.log import Floats, Ints

LONGEST = 1e3
"""[m] beyond which no wall is looked for."""
LEAST_RANGE = 1e-9
"""[m] below which a ray still stands on the wall that it leaves."""


class Hits(NamedTuple):
    """What rays meet first; each of the shape of the rays."""

    ranges: Floats
    """[m], inf: nothing."""
    wall: Ints
    """Index of the wall, -1: none."""
    along: Floats
    """[m] from the wall's first end."""
    cosine: Floats
    """Of the angle of incidence."""


@numba.njit(cache=True)
def _nearest_walls(starts, directions, walls, skipped):  # type: ignore[no-untyped-def]
    n = starts.shape[0]
    ranges = np.full(n, np.inf)
    wall = np.full(n, -1, np.int64)
    along = np.zeros(n)
    cosine = np.zeros(n)
    for i in range(n):
        x, y = starts[i, 0], starts[i, 1]
        dx, dy = math.cos(directions[i]), math.sin(directions[i])
        best = LONGEST
        for j in range(walls.shape[0]):
            if j == skipped[i]:
                continue
            ex, ey = walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
            cross = dx * ey - dy * ex
            if cross == 0.0:
                continue
            px, py = walls[j, 0] - x, walls[j, 1] - y
            distance = (px * ey - py * ex) / cross
            if distance <= LEAST_RANGE or distance >= best:
                continue
            share = (px * dy - py * dx) / cross
            if share < 0.0 or share > 1.0:
                continue
            best = distance
            length = math.hypot(ex, ey)
            ranges[i] = distance
            wall[i] = j
            along[i] = share * length
            cosine[i] = abs(cross) / length
    return ranges, wall, along, cosine


@numba.njit(cache=True)
def _nearest_discs(starts, directions, discs):  # type: ignore[no-untyped-def]
    n = starts.shape[0]
    ranges = np.full(n, np.inf)
    for i in range(n):
        dx, dy = math.cos(directions[i]), math.sin(directions[i])
        for j in range(discs.shape[1]):
            px, py = discs[i, j, 0] - starts[i, 0], discs[i, j, 1] - starts[i, 1]
            ahead = px * dx + py * dy
            aside = px * px + py * py - ahead * ahead
            square = discs[i, j, 2] * discs[i, j, 2]
            if aside < square and ahead > 0:
                distance = ahead - math.sqrt(square - aside)
                if 0 < distance < ranges[i]:
                    ranges[i] = distance
    return ranges


def meet_walls(starts: Floats, directions: Floats, walls: Floats, skipped: Ints | None = None) -> Hits:
    """Return what each ray meets first.

    Parameters
    ----------
    starts : (..., 2) [m]
    directions : (...) [rad]
    walls : (n_walls, 4) [m] x, y of both ends
    skipped : (...) index of a wall that the ray does not meet, -1: none
    """
    shape = directions.shape
    none = np.full(directions.size, -1, np.int64)
    found = _nearest_walls(
        np.ascontiguousarray(starts.reshape(-1, 2)),
        np.ascontiguousarray(directions.ravel()),
        np.ascontiguousarray(walls),
        none if skipped is None else np.ascontiguousarray(skipped.ravel()),
    )
    return Hits(*(one.reshape(shape) for one in found))


def meet_moving_discs(starts: Floats, directions: Floats, discs: Floats) -> Floats:
    """Return the range [m] of each ray to the nearest disc, inf: none.

    Parameters
    ----------
    starts : (..., 2) [m]
    directions : (...) [rad]
    discs : (n_rays, n_discs, 3) [m] x, y and radius of each when the ray is taken
    """
    ranges = _nearest_discs(
        np.ascontiguousarray(starts.reshape(-1, 2)),
        np.ascontiguousarray(directions.ravel()),
        np.ascontiguousarray(discs),
    )
    return np.asarray(ranges.reshape(directions.shape))


def meet_discs(starts: Floats, directions: Floats, discs: Floats) -> Floats:
    """Return the range [m] of each ray to the nearest of some discs (n_discs, 3) [m] that stand still."""
    return meet_moving_discs(starts, directions, np.broadcast_to(discs, (directions.size, *discs.shape)))
