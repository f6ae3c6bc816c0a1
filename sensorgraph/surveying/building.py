"""Changes of a building that one located run shows: things where the map is free, and walls that are gone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from logs.run import Run, pair
from sensorgraph.localization.global_search import evenly
from sensorgraph.localization.likelihood_field import points_on
from sensorgraph.surveying.range_offset import range_offset
from sensorgraph.types import Bools, Floats
from sensorgraph.world.raycast import cast_laser, laser_poses

CELL = 0.25
"""[m] Side of a cell of changes."""
CLEAR = 0.3
"""[m] Distance from the walls of the map beyond which a point is something new."""
BEYOND = 0.5
"""[m] Distance that a ray passes beyond a wall of the map if the wall is gone."""
MIN_SCANS, MIN_SECONDS = 3, 2.0
"""Number of scans that show a change, and the time over which they do; a person moves on."""
MAX_SCANS = 400
"""Maximum number of scans that are compared, spread evenly over the run."""
SPACING = 0.05
"""[m] Distance of the points that represent walls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ChangedPlaces:
    """Cells of the building that differ from the map."""

    new: Floats
    """(n, 2) [m] Centres of cells with something that the map lacks."""
    gone: Floats
    """(n, 2) [m] Centres of cells with a wall that is no longer there."""
    share: float
    """Share of the returns that the map does not explain."""
    offset: tuple[float, float] | None
    """[m] Offset of all ranges, with its standard error; None without scans that show it."""

    def to_dict(self) -> dict[str, Any]:
        """Return the cells as plain data."""
        return {"new": self.new.tolist(), "gone": self.gone.tolist(), "share": self.share}


def changed_places(run: Run, walls: Floats) -> ChangedPlaces:
    """Compare a located run with the walls of its place.

    Parameters
    ----------
    walls : (n, 2, 2) [m, map]
    """
    pairing = pair(run)
    index = np.flatnonzero(pairing.paired)
    index = index[evenly(len(index), MAX_SCANS)]
    sensor, ranges = run.sensor, run.ranges[index]
    lasers = laser_poses(pairing.poses[index], sensor.mount)
    expected, wall = cast_laser(walls, lasers, sensor.bearings, sensor.range_max)
    angle = lasers[:, 2:] + sensor.bearings
    hit = np.isfinite(ranges)
    ways = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    ends = lasers[:, None, :2] + np.where(hit, ranges, 0.0)[..., None] * ways
    tree = cKDTree(points_on(walls, SPACING))
    far = np.zeros(ranges.shape, dtype=bool)
    far[hit] = tree.query(ends[hit], distance_upper_bound=CLEAR)[0] > CLEAR
    is_new = far & (ranges < expected - CLEAR) & np.isfinite(expected)
    is_gone = hit & np.isfinite(expected) & (ranges > expected + BEYOND)
    at_wall = lasers[:, None, :2] + np.where(np.isfinite(expected), expected, 0.0)[..., None] * ways
    usable = hit & np.isfinite(expected)
    off = np.where(usable, ranges - np.where(usable, expected, 0.0), 0.0)
    is_there = usable & (np.abs(off) < CLEAR)
    offset = range_offset(off, expected, angle, walls, wall, is_there)
    stamps = run.stamps[index]
    return ChangedPlaces(
        new=_lasting_cells(ends, is_new, stamps),
        gone=_lasting_cells(at_wall, is_gone, stamps, is_there),
        share=float((is_new | is_gone).sum() / max(hit.sum(), 1)),
        offset=offset,
    )


def _lasting_cells(points: Floats, chosen: Bools, stamps: Floats, contrary: Bools | None = None) -> Floats:
    """Return the centres (n, 2) of cells that several scans over some seconds show, and more than show the contrary.

    Rays along a wall, or past an edge, are beyond it in some scans, and end at it in more.

    Parameters
    ----------
    points : (n_scans, n_rays, 2) [m, map]
    chosen, contrary : (n_scans, n_rays) rays that show the change at their point, and those that show none.
    """
    of_ray = np.zeros(chosen.shape, dtype=np.bool_) if contrary is None else contrary
    scan, ray = np.nonzero(chosen | of_ray)
    keys, cell = np.unique(np.floor(points[scan, ray] / CELL).astype(np.int64), axis=0, return_inverse=True)
    pairs = np.unique(np.column_stack([cell.reshape(-1), scan, of_ray[scan, ray]]), axis=0)
    against = np.bincount(pairs[pairs[:, 2] == 1, 0], minlength=len(keys))
    of_cell, of_scan = pairs[pairs[:, 2] == 0, :2].T
    shown = np.bincount(of_cell, minlength=len(keys))
    first, last = np.full(len(keys), np.inf), np.full(len(keys), -np.inf)
    np.minimum.at(first, of_cell, stamps[of_scan])
    np.maximum.at(last, of_cell, stamps[of_scan])
    lasting = (shown >= MIN_SCANS) & (last - first >= MIN_SECONDS) & (shown > against)
    return np.asarray((keys[lasting] + 0.5) * CELL).reshape(-1, 2)
