"""Diagnosis in a map of pixels: unknown space is not judged, changes of the building are grouped into things."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from planners.arena import Arena
from planners.clearance import Barriers
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools, Floats
from sensorgraph.world.pixel_walls import pixel_of, straightened, unknown_borders
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import Robot

LOOK_PAST = 3.0
"""[pixel] within which a wall takes a ray before unknown space does."""
CELL = 0.2
"""[m] of the raster in which changes are grouped."""
MIN_OFF = 0.3
"""[m] by which a reading must differ to show a change of the building."""
NEAR_WALL = 0.2
"""[m] from mapped walls, within which nothing stands free."""
MIN_SHARE = 0.001
"""Of all readings, that a change must explain."""
MAX_CHANGED = 1 / 3
"""Of all readings, above which it is not the building that has changed."""
MIN_SCANS = 5
"""That show it."""


@dataclass(frozen=True, kw_only=True)
class MapChange:
    """One place where the building is not as its map."""

    kind: str
    """`new`: something stands where the map has free space; `open`: rays pass where the map has a wall."""
    xy: tuple[float, float]
    """[m, map] its middle."""
    size: tuple[float, float]
    """[m] along x and y."""
    share: float
    """Of the readings."""

    def sentence(self) -> str:
        """Say it in words."""
        x, y = self.xy
        w, h = self.size
        if self.kind == "new":
            return f"something of about {w:.1f} x {h:.1f} m at ({x:.1f}, {y:.1f}) m that the map lacks"
        return f"an opening, or a wall that is gone, at ({x:.1f}, {y:.1f}) m, {max(w, h):.1f} m wide"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for the report."""
        return {
            "kind": self.kind,
            "xy": list(self.xy),
            "size_m": list(self.size),
            "share": self.share,
            "statement": self.sentence(),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class RasterMap:
    """A map of pixels as diagnosis takes it."""

    arena: Arena
    """With straight walls."""
    pixel: float
    """[m]"""
    tolerance: float
    """[m] standard deviation of its walls: half a pixel either way, and what straight walls leave."""
    borders: Floats
    """(n, 2, 2) [m] where free space ends without a wall: beyond is unknown."""

    @classmethod
    def of(cls, arena: Arena) -> RasterMap:
        """Straighten the walls of an arena of pixels."""
        pixel = pixel_of(arena)
        straight, rms = straightened(arena)
        tolerance = float(np.hypot(pixel / np.sqrt(12), rms))
        return cls(arena=straight, pixel=pixel, tolerance=tolerance, borders=unknown_borders(arena))

    def widened(self, robot: Robot) -> Robot:
        """Return the robot with a tolerance of the map that such a map holds at best."""
        t = robot.tolerances
        return replace(robot, tolerances=replace(t, map=max(t.map, self.tolerance)))

    def judged(self, data: ScanData) -> tuple[ScanData, dict[str, Any]]:
        """Leave out rays into unknown space and those that show a change; return what to say of them."""
        if data.sensor.is_composite or measures_cones(
            data.sensor
        ):  # rays from several places, and no thin ones
            return data, {
                "pixel_m": self.pixel,
                "walls": self.arena.n_walls,
                "map_tolerance_m": self.tolerance,
            }
        data, said = known_and_unchanged(data, self.borders)
        return data, {
            "pixel_m": self.pixel,
            "walls": self.arena.n_walls,
            "map_tolerance_m": self.tolerance,
            **said,
        }


def known_and_unchanged(data: ScanData, borders: Floats, *, few: int = 0) -> tuple[ScanData, dict[str, Any]]:
    """Leave out rays into unknown space, beyond borders (n, 2, 2) [m], and those that show a change; say which they were.

    Two thirds of what is left must be the building as mapped, or nothing is said to have changed. So `few` changes are left
    in, to be found and sized as effects.
    """
    border, unknown = looks_into_unknown(data, borders)
    things, rays = changes(data, border)
    if rays.mean() > MAX_CHANGED or len(things) <= few:
        things, rays = [], np.zeros_like(rays)
    data = replace(data, ranges=np.where(rays | unknown, np.nan, data.ranges), memo={})
    return data, {
        "into_unknown_share": float(unknown.mean()),
        "changes": [one.to_dict() for one in things],
        "changes_share": float(rays.mean()),
    }


def looks_into_unknown(data: ScanData, borders: Floats) -> tuple[Floats, Bools]:
    """Return where rays (n_scans, n_rays) enter unknown space [m], inf for never, and which do before they meet a wall."""
    if not len(borders):
        shape = data.ranges.shape
        return np.full(shape, np.inf), np.zeros(shape, dtype=np.bool_)
    lasers = laser_poses(data.poses, data.sensor.mount)
    pixel = float(np.median(np.hypot(*np.diff(borders, axis=1)[:, 0].T)))
    at_wall, _ = cast_laser(data.arena.walls, lasers, data.sensor.bearings, 2 * data.sensor.range_max)
    at_border, _ = cast_laser(borders, lasers, data.sensor.bearings, 2 * data.sensor.range_max)
    enters = at_border < np.minimum(at_wall, data.sensor.range_max) - LOOK_PAST * min(pixel, 0.1)
    return np.where(enters, at_border, np.inf), enters


def changes(data: ScanData, border: Floats) -> tuple[list[MapChange], Bools]:
    """Group readings that are far from what the map makes them into things, and say which readings these are.

    Parameters
    ----------
    border : (n_scans, n_rays) [m] where unknown space begins: beyond it nothing is said
    """
    lasers = laser_poses(data.poses, data.sensor.mount)
    expected, wall = cast_laser(data.arena.walls, lasers, data.sensor.bearings, data.sensor.range_max)
    z = data.ranges
    way = np.diff(data.arena.walls, axis=1)[:, 0]
    lie = np.arctan2(way[:, 1], way[:, 0])[np.maximum(wall, 0)]
    head_on = np.abs(np.sin(lasers[:, 2:] + data.sensor.bearings - lie))  # 1; 0 along the wall
    reach = np.minimum(np.where(np.isfinite(expected), expected, data.sensor.range_max), border)
    got = np.where(z == np.inf, data.sensor.range_max, z)
    with np.errstate(invalid="ignore"):
        is_new = np.isfinite(z) & (z < reach - MIN_OFF)
        is_open = (expected < border) & np.isfinite(expected) & ((got - expected) * head_on > MIN_OFF)
    found: list[MapChange] = []
    masked = np.zeros(z.shape, dtype=np.bool_)
    for kind, some, r in (("new", is_new, z), ("open", is_open, expected)):
        things, rays = _grouped(data, kind, some, r, lasers)
        found += things
        masked |= rays
    return sorted(found, key=lambda one: -one.share), masked


def _grouped(
    data: ScanData, kind: str, some: Bools, r: Floats, lasers: Floats
) -> tuple[list[MapChange], Bools]:
    """Cluster the points at ranges r (n_scans, n_rays) of some rays; return what is large enough, and its rays."""
    masked = np.zeros(some.shape, dtype=np.bool_)
    scan, ray = np.nonzero(some)
    angle = lasers[scan, 2] + data.sensor.bearings[ray]
    points = lasers[scan, :2] + r[scan, ray, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if kind == "new":  # what stands free; near a mapped wall it is the wall
        clear = Barriers(data.arena).distances(points) > NEAR_WALL
        scan, ray, points = scan[clear], ray[clear], points[clear]
    if not len(scan):
        return [], masked
    low = points.min(axis=0)
    cell = ((points - low) / CELL).astype(np.intp)
    count = np.zeros(cell.max(axis=0) + 1, dtype=np.intp)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1)
    least = max(3, int(0.05 * MIN_SHARE * data.ranges.size))
    labels, n = ndimage.label(count >= least, structure=np.ones((3, 3)))
    label = labels[cell[:, 0], cell[:, 1]]
    out = []
    for k in range(1, n + 1):
        rays = label == k
        share = float(rays.sum()) / data.ranges.size
        if share < MIN_SHARE or len(np.unique(scan[rays])) < MIN_SCANS:
            continue
        ends = np.quantile(points[rays], [0.05, 0.95], axis=0)
        x, y = ends.mean(axis=0)
        w, h = ends[1] - ends[0]
        out.append(MapChange(kind=kind, xy=(float(x), float(y)), size=(float(w), float(h)), share=share))
        masked[scan[rays], ray[rays]] = True
    return out, masked
