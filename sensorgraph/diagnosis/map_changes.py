"""Changes of a building since its map was made: readings that show them, grouped into objects, and rays into unknown space.

A new object stops the rays that are aimed at it; an opening lets them pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import ndimage

from planners.clearance import Barriers
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.open_borders import open_borders
from sensorgraph.world.pixel_walls import THING
from sensorgraph.world.raycast import cast_laser, laser_poses

LOOK_PAST = 3.0
"""[pixel] minimum distance from a border of unknown space to the wall behind it, for a ray to count as
entering unknown space."""
CELL = 0.2
"""[m] cell size of the raster in which changes are grouped; no new object is detected within a cell from mapped walls."""
MIN_OFF = 2 * SCAN.alignment.wall_distance
"""[m] minimum difference of a reading that shows a change of the building."""
MAX_CHANGED = 1 / 3
"""Share of the readings, above which the cause is not a change of the building."""
MAX_SMALL = 0.6
"""[m] maximum size of a new object that a disc represents."""
MIN_SHOWN = {"new": 0.5, "open": 0.95}
"""Minimum share of the rays aimed at the fullest cell that show the change. The edge of an object stops half
of them; a pane lets most pass."""


@dataclass(frozen=True, kw_only=True)
class MapChange:
    """One place where the building differs from its map."""

    kind: str
    """`new`: an object where the map has free space; `open`: rays pass where the map has a wall."""
    xy: tuple[float, float]
    """[m, map] centre."""
    size: tuple[float, float]
    """[m] along x and y."""
    share: float
    """Of the readings."""
    is_named: bool = False
    """Whether an effect of the library describes it: a small new object, or a missing one."""

    def sentence(self) -> str:
        """Return the change in words."""
        x, y = self.xy
        w, h = self.size
        if self.kind == "new":
            return f"an object of about {w:.1f} x {h:.1f} m at ({x:.1f}, {y:.1f}) m that the map lacks"
        return f"an opening or a removed wall at ({x:.1f}, {y:.1f}) m, {max(w, h):.1f} m wide"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for the report."""
        return {
            "kind": self.kind,
            "xy": list(self.xy),
            "size_m": list(self.size),
            "share": self.share,
            "statement": self.sentence(),
        }


def known_and_unchanged(
    data: ScanData, borders: Floats, *, left_in: Literal["all", "named"] = "all"
) -> tuple[ScanData, dict[str, Any]]:
    """Exclude rays into unknown space, beyond borders (n, 2, 2) [m], and rays that show a change; return notes.

    If the changes would exclude more than a third of the readings, no change is reported.

    Parameters
    ----------
    left_in : Which changes stay in the scans, to be found and sized as effects, if there are no more of them than a model
        may have effects: all, or only those that an effect of the library describes.
    """
    border, unknown = looks_into_unknown(data, borders)
    found = changes(data, border)
    if len(found) <= SCAN.selection.max_effects:
        found = [(thing, rays) for thing, rays in found if left_in == "named" and not thing.is_named]
    rays = np.zeros(data.ranges.shape, dtype=np.bool_)
    for _, own in found:
        rays |= own
    things = [thing for thing, _ in found]
    if rays.mean() > MAX_CHANGED:
        things, rays = [], np.zeros_like(rays)
    data = replace(data, ranges=np.where(rays | unknown, np.nan, data.ranges), memo={})
    return data, {
        "into_unknown_share": float(unknown.mean()),
        "changes": [one.to_dict() for one in things],
        "changes_share": float(rays.mean()),
    }


def without_unknown_space(data: ScanData, *, with_changes: bool = True) -> tuple[ScanData, dict[str, Any]]:
    """Exclude rays that enter unknown space before they meet a wall; return the scans and notes for the report.

    Parameters
    ----------
    with_changes : Keep readings that show a change of the building since its walls were found. False: exclude
        them as well, if the changes are more than a diagnosis may name.
    """
    if data.sensor.is_composite or measures_cones(data.sensor):
        return data, {"into_unknown_share": 0.0}
    borders = open_borders(data.arena)
    if not with_changes:
        return known_and_unchanged(data, borders)
    _, unknown = looks_into_unknown(data, borders)
    if unknown.any():  # otherwise the cached casts stay valid
        data = replace(data, ranges=np.where(unknown, np.nan, data.ranges), memo={})
    return data, {"into_unknown_share": float(unknown.mean())}


def looks_into_unknown(data: ScanData, borders: Floats) -> tuple[Floats, Bools]:
    """Return the range (n_scans, n_rays) [m] at which rays enter unknown space before a wall, and which rays do.

    The range is inf for rays that do not.
    """
    if not len(borders):
        shape = data.ranges.shape
        return np.full(shape, np.inf), np.zeros(shape, dtype=np.bool_)
    lasers = laser_poses(data.poses, data.sensor.mount)
    pixel = float(np.median(np.hypot(*np.diff(borders, axis=1)[:, 0].T)))
    at_wall, _ = cast_laser(data.arena.walls, lasers, data.sensor.bearings, 2 * data.sensor.range_max)
    at_border, _ = cast_laser(borders, lasers, data.sensor.bearings, 2 * data.sensor.range_max)
    enters = at_border < np.minimum(at_wall, data.sensor.range_max) - LOOK_PAST * min(pixel, 0.1)
    return np.where(enters, at_border, np.inf), enters


def changes(data: ScanData, border: Floats) -> list[tuple[MapChange, Bools]]:
    """Group readings that differ strongly from the map into objects; return each with its rays (n_scans, n_rays).

    A new object stops most of the rays aimed at it, and an opening lets nearly all pass. Otherwise the cause
    is a person who walks by, the sensor, or the outline of an object.

    Parameters
    ----------
    border : (n_scans, n_rays) [m] Range at which unknown space begins; nothing is detected beyond it.
    """
    seen = _Sight(data, border)
    found = [one for kind in ("new", "open") for one in _grouped(seen, kind)]
    return sorted(found, key=lambda one: -one[0].share)


class _Sight:
    """Readings of all rays of a run, and the readings expected from the map; arrays (n_scans, n_rays)."""

    def __init__(self, data: ScanData, border: Floats) -> None:
        self.data, self.lasers = data, laser_poses(data.poses, data.sensor.mount)
        self.angle = self.lasers[:, 2:] + data.sensor.bearings
        self.is_thing = np.array([name.startswith(THING) for name in data.arena.names])
        self.expected, self.wall = data.plain_cast
        self.z, most = data.ranges, data.sensor.range_max
        way = np.diff(data.arena.walls, axis=1)[:, 0]
        lie = np.arctan2(way[:, 1], way[:, 0])[np.maximum(self.wall, 0)]
        head_on = np.abs(np.sin(self.angle - lie))  # 1; 0 along the wall
        self.reach = np.minimum(np.where(np.isfinite(self.expected), self.expected, most), border)
        self.got = np.where(self.z == np.inf, most, self.z)
        with np.errstate(invalid="ignore"):
            self.is_new = np.isfinite(self.z) & (self.z < self.reach - MIN_OFF)
            past = (self.got - self.expected) * head_on
            self.is_open = (self.expected < border) & np.isfinite(self.expected) & (past > MIN_OFF)

    def share(self, kind: str, place: Floats) -> float:
        """Return the share of the rays aimed at a place (2,) that show a change there."""
        x, y = (place - self.lasers[:, :2]).T[:, :, None]
        ahead, beside = (
            x * np.cos(self.angle) + y * np.sin(self.angle),
            y * np.cos(self.angle) - x * np.sin(self.angle),
        )
        aimed = (np.abs(beside) < CELL / 2) & (ahead > 0) & ~np.isnan(self.z)
        if kind == "new":  # a ray that is stopped earlier carries no information
            aimed &= (ahead < self.reach - MIN_OFF) & (self.got > ahead - CELL)
            shows = self.is_new & (self.z < ahead + CELL)
        else:
            # a missing return may be due to the surface or to the sensor
            aimed &= (np.abs(self.expected - ahead) < CELL) & np.isfinite(self.z)
            shows = self.is_open
        return float((aimed & shows).sum() / max(aimed.sum(), 1))


def _grouped(seen: _Sight, kind: str) -> list[tuple[MapChange, Bools]]:
    """Cluster the points of one kind; return the clusters that are large and certain enough, with their rays."""
    some, r = (seen.is_new, seen.z) if kind == "new" else (seen.is_open, seen.expected)
    n_readings, min_share = some.size, SCAN.goodness_of_fit.min_share
    scan, ray = np.nonzero(some)
    points = ends_at(seen.lasers, seen.data.sensor.bearings, scan, ray, r[scan, ray])
    if kind == "new":  # free-standing objects; near a mapped wall, the wall is the cause
        clear = Barriers(seen.data.arena).distances(points) > CELL
        scan, ray, points = scan[clear], ray[clear], points[clear]
    if not len(scan):
        return []
    low = points.min(axis=0)
    cell = ((points - low) / CELL).astype(np.intp)
    count = np.zeros(cell.max(axis=0) + 1, dtype=np.intp)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1)
    least = max(3, int(0.05 * min_share * n_readings))
    labels, n = ndimage.label(count >= least, structure=np.ones((3, 3)))
    label = labels[cell[:, 0], cell[:, 1]]
    out = []
    for k in range(1, n + 1):
        rays = label == k
        share = float(rays.sum()) / n_readings
        if share < min_share or len(np.unique(scan[rays])) < SCAN.goodness_of_fit.min_blocks:
            continue
        fullest = np.unravel_index(np.where(labels == k, count, 0).argmax(), count.shape)
        if seen.share(kind, low + CELL * (np.array(fullest) + 0.5)) < MIN_SHOWN[kind]:
            continue
        ends = np.quantile(points[rays], [0.05, 0.95], axis=0)
        x, y = ends.mean(axis=0)
        w, h = ends[1] - ends[0]
        own = np.zeros(some.shape, dtype=np.bool_)
        own[scan[rays], ray[rays]] = True
        is_thing = seen.is_thing[np.median(seen.wall[scan[rays], ray[rays]]).astype(np.intp)]
        change = MapChange(
            kind=kind,
            xy=(float(x), float(y)),
            size=(float(w), float(h)),
            share=share,
            is_named=max(w, h) < MAX_SMALL if kind == "new" else bool(is_thing),
        )
        out.append((change, own))
    return out


def ends_at(lasers: Floats, bearings: Floats, scan: Ints, ray: Ints, r: Floats) -> Floats:
    """Return the points (n, 2) [m] of some rays at ranges r; lasers (n_scans, 3), bearings (n_rays,)."""
    angle = lasers[scan, 2] + bearings[ray]
    return np.asarray(lasers[scan, :2] + r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
