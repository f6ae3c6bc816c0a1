"""Diagnosis in a map of pixels: unknown space is not judged, changes of the building are grouped into things."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import ndimage

from planners.arena import Arena
from planners.clearance import Barriers
from sensorgraph.diagnosis.scan.corners import Corners
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.places import reflected
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.pixel_walls import THING, is_near_gap, pixel_of, straightened, unknown_borders
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
MAX_SMALL = 0.6
"""[m] of something new, above which no disc stands for it."""
MIN_MIRRORED = 0.8
"""Of the rays that pass a wall, that read what the room mirrored in it has: then it is a mirror, and no opening."""
MIN_SHOWN = {"new": 0.5, "open": 0.95}
"""Of the rays aimed at its fullest cell, that show it: the edge of a thing stops half, a pane lets most pass."""


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
    is_named: bool = False
    """Whether effects have a name for it: something small that is new, a thing that is gone, a mirror."""

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
    drawn: Arena
    """With the borders of the cells as walls."""

    @classmethod
    def of(cls, arena: Arena) -> RasterMap:
        """Straighten the walls of an arena of pixels."""
        pixel = pixel_of(arena)
        straight, rms = straightened(arena)
        tolerance = float(np.hypot(pixel / np.sqrt(12), rms))
        return cls(
            arena=straight,
            pixel=pixel,
            tolerance=tolerance,
            borders=unknown_borders(arena),
            drawn=arena,
        )

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
        _, wall = data.plain_cast
        at_gap = self._at_gap(data)
        if at_gap.any():  # else its cast of the plain walls is kept
            data = replace(data, ranges=np.where(at_gap, np.nan, data.ranges), memo={})
        data, said = known_and_unchanged(data, self.borders, few=SCAN.selection.max_effects, left_in="named")
        data = replace(data, corners=_most_met(data.arena.walls, wall), grain=self.pixel / 2, memo={})
        return data, {
            "pixel_m": self.pixel,
            "walls": self.arena.n_walls,
            "map_tolerance_m": self.tolerance,
            **said,
        }

    def _at_gap(self, data: ScanData) -> Bools:
        """Tell which rays (n_scans, n_rays) end at a gap between cells, or pass it though the map closes it."""
        out = np.zeros(data.ranges.shape, dtype=np.bool_)
        expected, wall = data.plain_cast
        scan, ray = np.nonzero(wall >= 0)
        lasers = laser_poses(data.poses, data.sensor.mount)
        out[scan, ray] = is_near_gap(
            self.drawn, _ends(lasers, data.sensor.bearings, scan, ray, expected[scan, ray])
        )
        return out


def _ends(lasers: Floats, bearings: Floats, scan: Ints, ray: Ints, r: Floats) -> Floats:
    """Return where some rays are at ranges r, (n, 2) [m]; lasers (n_scans, 3), bearings (n_rays,)."""
    angle = lasers[scan, 2] + bearings[ray]
    return np.asarray(lasers[scan, :2] + r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _most_met(walls: Floats, wall: Ints) -> Corners:
    """Return the corners of the walls that most rays meet, as many as may shift; `wall` is the index of each ray's, -1: none."""
    count = np.bincount(wall[wall >= 0], minlength=len(walls))
    for least in range(1, int(count.max(initial=1)) + 1):
        corners = Corners.of(walls, count >= least)
        if corners.count <= SCAN.nuisance.max_pixel_corners:
            break
    return corners


def known_and_unchanged(
    data: ScanData, borders: Floats, *, few: int, left_in: Literal["all", "named"] = "all"
) -> tuple[ScanData, dict[str, Any]]:
    """Leave out rays into unknown space, beyond borders (n, 2, 2) [m], and those that show a change; say which they were.

    Two thirds of what is left must be the building as mapped, or nothing is said to have changed.

    Parameters
    ----------
    few : changes that are left in where there are no more, to be found and sized as effects
    left_in : all of these, or only those that effects have a name for
    """
    border, unknown = looks_into_unknown(data, borders)
    found = changes(data, border)
    if len(found) <= few:
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


def changes(data: ScanData, border: Floats) -> list[tuple[MapChange, Bools]]:
    """Group readings that are far from what the map makes them into things; return each with its rays (n_scans, n_rays).

    What stands there stops most of the rays that are aimed at it, and nearly all pass an opening: else it is somebody who
    walks by, or the sensor, or the outline of a thing.

    Parameters
    ----------
    border : (n_scans, n_rays) [m] where unknown space begins: beyond it nothing is said
    """
    seen = _Sight(data, border)
    found = [one for kind in ("new", "open") for one in _grouped(seen, kind)]
    return sorted(found, key=lambda one: -one[0].share)


class _Sight:
    """What every ray of a run reads beside what the map makes it; arrays (n_scans, n_rays)."""

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

    def points(self, scan: Ints, ray: Ints, r: Floats) -> Floats:
        """Return where some rays are at ranges r, (n, 2) [m]."""
        return _ends(self.lasers, self.data.sensor.bearings, scan, ray, r)

    def is_mirror(self, own: Bools) -> bool:
        """Tell whether rays (n_scans, n_rays) that pass a wall read what the room mirrored in it has."""
        ways = self.expected[own] + reflected(self.data.arena.walls, self.data.scene().shoot(), own)
        read, most = self.z[own], self.data.sensor.range_max
        says = np.isfinite(read) | (ways < most)  # what is out of reach in a mirror is so behind an opening
        fits = np.isfinite(read) & (np.abs(self.got[own] - ways) < MIN_OFF)
        return 2 * int(says.sum()) > len(says) and float(fits[says].mean()) >= MIN_MIRRORED

    def share(self, kind: str, place: Floats) -> float:
        """Return the share of the rays aimed at a place (2,) that show a change there."""
        x, y = (place - self.lasers[:, :2]).T[:, :, None]
        ahead, beside = (
            x * np.cos(self.angle) + y * np.sin(self.angle),
            y * np.cos(self.angle) - x * np.sin(self.angle),
        )
        aimed = (np.abs(beside) < CELL / 2) & (ahead > 0) & ~np.isnan(self.z)
        if kind == "new":  # whatever stops the ray earlier says nothing
            aimed &= (ahead < self.reach - MIN_OFF) & (self.got > ahead - CELL)
            shows = self.is_new & (self.z < ahead + CELL)
        else:
            # no answer may be the surface's, or the sensor's
            aimed &= (np.abs(self.expected - ahead) < CELL) & np.isfinite(self.z)
            shows = self.is_open
        return float((aimed & shows).sum() / max(aimed.sum(), 1))


def _grouped(seen: _Sight, kind: str) -> list[tuple[MapChange, Bools]]:
    """Cluster the points of one kind; return what is large enough and is surely there, and its rays."""
    some, r = (seen.is_new, seen.z) if kind == "new" else (seen.is_open, seen.expected)
    n_readings = some.size
    scan, ray = np.nonzero(some)
    points = seen.points(scan, ray, r[scan, ray])
    if kind == "new":  # what stands free; near a mapped wall it is the wall
        clear = Barriers(seen.data.arena).distances(points) > NEAR_WALL
        scan, ray, points = scan[clear], ray[clear], points[clear]
    if not len(scan):
        return []
    low = points.min(axis=0)
    cell = ((points - low) / CELL).astype(np.intp)
    count = np.zeros(cell.max(axis=0) + 1, dtype=np.intp)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1)
    least = max(3, int(0.05 * MIN_SHARE * n_readings))
    labels, n = ndimage.label(count >= least, structure=np.ones((3, 3)))
    label = labels[cell[:, 0], cell[:, 1]]
    out = []
    for k in range(1, n + 1):
        rays = label == k
        share = float(rays.sum()) / n_readings
        if share < MIN_SHARE or len(np.unique(scan[rays])) < MIN_SCANS:
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
            is_named=max(w, h) < MAX_SMALL if kind == "new" else bool(is_thing) or seen.is_mirror(own),
        )
        out.append((change, own))
    return out
