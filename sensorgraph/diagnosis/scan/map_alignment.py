"""Test whether the arena fits the run; if not, find the rigid motion or the scale of the map that corrects it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from logs.run import RangeSensor, Run
from planners.clearance import Barriers
from sensorgraph.diagnosis.result import Unknown
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.wall_raster import SCALE_STEP, SCALES, WallRaster, improved, rotation
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Floats
from sensorgraph.world.orientation import orientation
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.self_fit import self_fit

SETTINGS = SCAN.alignment
UNITS = {
    100.0: "centimetres",
    1000.0: "millimetres",
    1 / 0.0254: "inches",
    1 / 0.3048: "feet",
    0.001: "kilometres",
}
"""Scale of a map -> possible unit of its coordinates."""
UNIT_SCALES = (*UNITS, 0.01, 0.0254, 0.3048)
PARTLY_MATCHING = (SETTINGS.poor_share + SETTINGS.good_share) / 2
"""Share of returns at walls after a motion of the poses, or of readings with the predicted length at another scale of the
map, above which the place is the right one."""


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Share of the rays that end at walls, for the map as it is and after the best correction."""

    share: float
    """Share of the returns that end at a wall."""
    best_share: float
    """The same share after the motion below."""
    dx: float = 0.0
    """[m] translation of the poses along x, after their rotation about their mean."""
    dy: float = 0.0
    dphi: float = 0.0
    """[rad] rotation of the poses about their mean."""
    matching: float = 1.0
    """Share of the returns with approximately the range that the arena predicts."""
    scale: float = 1.0
    """Ratio of the size of the arena to that of the place; unless it is 1, the arena is to be corrected, not the poses."""

    @property
    def is_good(self) -> bool:
        """Whether the map can be used as it is."""
        return self.matching >= SETTINGS.poor_share and self.best_share < max(
            self.share + SETTINGS.min_gain, SETTINGS.poor_share
        )

    @property
    def fits_elsewhere(self) -> bool:
        """Whether a rigid motion of the poses puts most returns on walls: the place is right, the frame is not."""
        return not self.is_good and self.scale == 1.0 and self.best_share >= PARTLY_MATCHING

    def sentence(self) -> str:
        """Return a statement of the fit of arena and run, and of its correction."""
        now = self.now()
        if self.is_good and self.share >= SETTINGS.good_share:
            return now
        if self.is_good:
            return f"the arena fits the run only in part: {now}; the map lacks objects, or contains objects that are absent"
        if self.best_share < self.share + SETTINGS.min_gain:
            longs = f"{100 * self.matching:.0f} % of the readings have the length that the arena predicts"
            return f"the arena does not fit the run: {now}; {longs}; no rotation, shift or scale of the map corrects that"
        if self.scale != 1.0:
            dx, dy = (round(-d / self.scale, 2) + 0.0 for d in (self.dx, self.dy))
            times = (
                f"{self.scale:.3g}"
                if self.scale < 0.1
                else f"{self.scale:.2f}"
                if self.scale < 10
                else f"{self.scale:.1f}"
            )
            lead = f"the arena does not fit the run, because it is {times} times as large as the place{self._unit()}"
            mend = f"with its coordinates divided by {times} and moved by ({dx:.2f}, {dy:.2f}) m"
        else:
            lead = "the arena does not fit the run"
            mend = (
                f"with the poses turned by {np.degrees(self.dphi):.1f} degrees about their mean and moved by "
                f"({self.dx:.2f}, {self.dy:.2f}) m"
            )
        if self.best_share < SETTINGS.good_share:
            return f"{lead}: {now}; it may belong to another place; even {mend}, it would be {100 * self.best_share:.0f} %"
        return f"{lead}: {now}; {mend}, it would be {100 * self.best_share:.0f} %"

    def now(self) -> str:
        """Return the share of the returns at walls in words."""
        return f"{100 * self.share:.0f} % of the returns end within {100 * SETTINGS.wall_distance:.0f} cm of a wall"

    def _unit(self) -> str:
        near = [unit for scale, unit in UNITS.items() if abs(self.scale / scale - 1) < (SCALE_STEP - 1) / 2]
        return f" ({near[0]} instead of metres?)" if near else ""


def align(data: ScanData, rng: np.random.Generator) -> Alignment:
    """Compare the end points of the measured rays with the walls; if few match, search for a better placement."""
    points = _ends(data, rng)
    if len(points) < SCAN.intake.min_scans:
        return Alignment(share=1.0, best_share=1.0)
    raster = WallRaster(data.arena.walls)
    is_coarse = raster.cell > SETTINGS.coarse_cell  # for example a map in millimetres
    at_walls = Barriers(data.arena).distances(points) < SETTINGS.wall_distance if is_coarse else None
    share = raster.share(points) if at_walls is None else float(at_walls.mean())
    matching = _matching_share(data)
    if share >= SETTINGS.good_share and matching >= SETTINGS.poor_share:
        return Alignment(share=share, best_share=share, matching=matching)
    moved = Alignment(share=share, best_share=share)
    if not is_coarse and (share <= SETTINGS.poor_share or matching < SETTINGS.poor_share):
        moved = _moved(data, raster, points, share)
    least = max(moved.best_share + SETTINGS.min_scale_gain, SETTINGS.good_share)
    searches = (
        (partial(_far_scaled, data),) if is_coarse else (partial(_scaled, raster), partial(_far_scaled, data))
    )
    for search in searches:
        scaled = search(points, share)
        if scaled.best_share > least and not scaled.is_good:
            return replace(scaled, matching=matching)
    return replace(moved, matching=matching)


def misalignment(alignment: Alignment, run: Run, data: ScanData) -> Unknown | None:
    """Return why the run cannot be compared with the arena, and the correction; None if it can."""
    statement = _wrong_orientation(alignment, run, data)
    if not statement and alignment.is_good:
        return None
    return Unknown(
        statement=statement
        or _contradiction(alignment, replace(run, sensor=data.sensor))
        or alignment.sentence(),
        statistic=alignment.share,
        threshold=alignment.best_share,
    )


def _contradiction(alignment: Alignment, run: Run) -> str:
    """Return a statement that no map fits, since ranges and poses differ in scale; empty if the scans agree.

    Scans whose poses are 5 % too close together look like those of a place that is 2 % smaller.
    """
    found = None if alignment.scale == 1.0 else self_fit(run)
    if found is None or found.name != "scale":
        return ""
    return (
        f"the arena does not fit the run: {alignment.now()}. No map does, since {found.line()}; correct the unit or the scale of "
        "the poses, or that of the ranges"
    )


def _wrong_orientation(alignment: Alignment, run: Run, data: ScanData) -> str:
    """Return a statement that the scan is mirrored or turned, if this explains the few rays at walls; else empty."""
    if alignment.share > SETTINGS.good_share:
        return ""
    found = orientation(replace(run, sensor=data.sensor), data.arena)
    if found is None or found.best == "as logged":
        return ""
    now, then = found.fits["as logged"], found.fits[found.best]
    if then > min(2 * SETTINGS.wall_distance, 0.5 * now):
        return ""
    return (
        f"the scan fits the arena if it is {found.best}: the median error is then {100 * then:.0f} cm instead of "
        f"{100 * now:.0f} cm; check the sign of angle_increment, the mount's yaw and the driver's `inverted` setting"
    )


def _matching_share(data: ScanData) -> float:
    """Return the share of the returns with approximately the range that the arena predicts.

    In an arena full of walls, many rays end at some wall by chance, but not at the range of the first wall.
    """
    n = min(data.n_scans, SCAN.selection.n_scans)
    some = np.linspace(0, data.n_scans - 1, n).astype(np.intp)
    sensor, measured = data.sensor, data.ranges[some]
    if _is_one_laser(sensor):
        lasers = laser_poses(data.poses[some], sensor.mount)
        cast, _ = cast_laser(data.arena.walls, lasers, sensor.bearings, sensor.range_max)
    else:
        cast = data.subset(some).scene().shoot().ranges
    returned = np.isfinite(measured)
    if not returned.any():
        return 1.0
    off = np.abs(measured[returned] - cast[returned])
    return float((off < SETTINGS.wall_distance + SETTINGS.matching_error * measured[returned]).mean())


def _moved(data: ScanData, raster: WallRaster, points: Floats, share: float) -> Alignment:
    """Search for the rigid motion of the poses that puts most end points on walls."""
    middle = data.poses[:, :2].mean(axis=0)
    points = points - middle
    turns = np.linspace(-np.pi, np.pi, SETTINGS.n_turns, endpoint=False)
    coarse = [(turn, *raster.correlated(points @ rotation(turn).T)) for turn in turns]
    best = (share, 0.0, middle)
    for turn, shift, count in sorted(coarse, key=lambda one: -one[2])[: SETTINGS.n_refined]:
        if count / len(points) > best[0] - SETTINGS.min_gain / 2:
            _, turned, _, moved = improved(raster, points, turn, 1.0, shift)
            got = raster.share(points @ rotation(turned).T + moved)
            if got > best[0]:
                best = (got, turned, moved)
    shift = best[2] - middle
    return Alignment(
        share=share, best_share=best[0], dx=float(shift[0]), dy=float(shift[1]), dphi=float(best[1])
    )


def _scaled(raster: WallRaster, points: Floats, share: float) -> Alignment:
    """Find the scale of the measurements about the origin, with a shift, that puts most end points on walls."""
    shifts, counts = zip(*(raster.correlated(scale * points) for scale in SCALES), strict=True)
    if max(counts) < (share + SETTINGS.min_gain / 2) * len(points):
        return Alignment(share=share, best_share=share)
    found = [
        improved(raster, points, 0.0, float(SCALES[k]), shifts[k], by_scale=True)
        for k in np.argsort(counts)[-SETTINGS.n_refined :]
    ]
    _, _, scale, shift = max(found, key=lambda one: one[0])
    best_share = raster.share(scale * points + shift)
    return Alignment(share=share, best_share=best_share, dx=float(shift[0]), dy=float(shift[1]), scale=scale)


def _far_scaled(data: ScanData, points: Floats, share: float) -> Alignment:
    """Find a scale of the map that is far from 1, as with another unit, and verify it by casts.

    A map is at least about as wide as the part that the run has seen. The map is shrunk, so that the wall distance stays
    the same. In a small map most rays may meet some wall by chance, but not at the right range.
    """
    seen = np.ptp(np.quantile(points, [0.02, 0.98], axis=0), axis=0)
    walls = data.arena.walls
    widest = float((np.ptp(walls.reshape(-1, 2), axis=0) / np.maximum(seen, SETTINGS.cell)).min())
    least, high = (factor * widest for factor in SETTINGS.far_range)
    low = SETTINGS.scale_range[0] * widest
    n = max(int(np.log(high / low) / np.log(SCALE_STEP)) + 1, 2)
    tried = [*np.geomspace(low, high, n), *(scale for scale in UNIT_SCALES if least < scale < high)]
    found = []
    for scale in tried:
        if not SETTINGS.scale_range[0] < scale < SETTINGS.scale_range[1]:
            raster = WallRaster(walls / scale)
            shift, count = raster.correlated(points)
            found.append((count, float(scale), shift, raster))
    found.sort(key=lambda one: -one[0])
    best = Alignment(share=share, best_share=share)
    for count, scale, shift, raster in found[: SETTINGS.n_refined]:
        if count < (share + SETTINGS.min_gain / 2) * len(points):
            break
        _, _, rest, shift = improved(raster, points, 0.0, 1.0, shift, by_scale=True)
        got = raster.share(rest * points + shift)
        mended = replace(data.arena, walls=(walls / scale - shift) / rest)
        if got > best.best_share and _matching_share(replace(data, arena=mended, memo={})) >= PARTLY_MATCHING:
            dx, dy = (scale * shift).tolist()
            best = Alignment(share=share, best_share=got, dx=dx, dy=dy, scale=scale * rest)
    return best


def _ends(data: ScanData, rng: np.random.Generator) -> Floats:
    """Return the end points of some of the measured rays, (n, 2) [m, map]."""
    scan, ray = np.nonzero(data.returned)
    if len(scan) > SETTINGS.n_points:
        some = rng.choice(len(scan), SETTINGS.n_points, replace=False)
        scan, ray = scan[some], ray[some]
    r = data.ranges[scan, ray]
    if not _is_one_laser(data.sensor):  # for cones, in the direction of the nearest surface of the arena
        beams = data.scene().shoot()
        x, y = (np.broadcast_to(o, data.ranges.shape)[scan, ray] for o in (beams.ox, beams.oy))
        return np.stack([x + r * beams.ux[scan, ray], y + r * beams.uy[scan, ray]], axis=1)
    lasers = laser_poses(data.poses, data.sensor.mount)
    phi = lasers[scan, 2] + data.sensor.bearings[ray]
    return np.stack([lasers[scan, 0] + r * np.cos(phi), lasers[scan, 1] + r * np.sin(phi)], axis=1)


def _is_one_laser(sensor: RangeSensor) -> bool:
    return not (sensor.is_composite or measures_cones(sensor))
