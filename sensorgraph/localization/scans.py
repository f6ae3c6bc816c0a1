"""Returns of a run as points in base_link, deskewed for the motion during a sweep, with surface normals; the space they crossed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert
from planners.kernel import outer_kernel
from sensorgraph.localization.settings import CLOSURES, SCANS, UNKNOWN_NORMAL_LENGTH
from sensorgraph.types import Bools, Floats, Ints

SPACING = 0.015
"""[m] Minimum distance between consecutive points of a scan; closer points are dropped."""
NEIGHBOURHOOD = 0.12
"""[m] Distance along the scan within which neighbours contribute to the normal of a point."""
MAX_GAP = float(np.radians(3.0))
"""[rad] Maximum bearing difference between neighbouring returns of a dense laser; in wider gaps the space is unobserved."""
NOISE_MARGIN = 0.1
"""[m] Distance from the end of a ray within which a point fits it: noise, and errors of a motion within a second."""
MIN_VISIBLE = 8
"""Number of visible points from which two views can contradict each other."""
SCANS_PER_BLOCK = 1000
"""Number of scans that are deskewed at once; it bounds the memory."""

_COLUMNS = ("points", "normals", "ranges", "starts", "rays")
"""Fields of `ScanPoints` with a row for each point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanPoints:
    """Returns of all scans of a run, in order."""

    first: Ints
    """(n_scans + 1,) Scan k has the points first[k] to first[k + 1] - 1."""
    points: Floats
    """(n_points, 2) [m] Points in base_link at the stamp of their scan."""
    normals: Floats
    """(n_points, 2) Unit normal of the surface towards the laser, in base_link. Without enough neighbours it
    is the direction to the laser, with length `UNKNOWN_NORMAL_LENGTH`."""
    ranges: Floats
    """(n_points,) [m] Length of the ray."""
    starts: Floats
    """(n_points, 2) [m] Origin of the ray, in base_link at the stamp of the scan."""
    rays: Ints
    """(n_points,) Number of the ray."""

    @property
    def n_scans(self) -> int:
        """Number of scans."""
        return len(self.first) - 1

    @property
    def spacing(self) -> float:
        """Median distance [m] between consecutive points of a scan; 0 without points."""
        steps = np.hypot(*np.diff(self.points, axis=0).T)
        inner = np.ones(len(steps), dtype=np.bool_)
        ends = self.first[1:-1] - 1
        inner[ends[(ends >= 0) & (ends < len(steps))]] = False
        return float(np.median(steps[inner])) if inner.any() else 0.0

    def of(self, scan: int) -> slice:
        """Return the slice of the points of a scan."""
        return slice(int(self.first[scan]), int(self.first[scan + 1]))

    def with_scans_of(self, other: ScanPoints, chosen: Bools) -> ScanPoints:
        """Return the returns with those of another conversion of the same run for the chosen scans (n_scans,)."""
        sources = [other if one else self for one in chosen]
        counts = [int(source.first[k + 1] - source.first[k]) for k, source in enumerate(sources)]
        columns = [
            [getattr(source, name)[source.of(k)] for k, source in enumerate(sources)] for name in _COLUMNS
        ]
        return ScanPoints._of(counts, [np.concatenate(parts) for parts in columns])

    @staticmethod
    def _of(counts: Ints | list[int], columns: Sequence[Any]) -> ScanPoints:
        """Return the returns with counts (n_scans,) and columns in the order of the fields."""
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
        return ScanPoints(first=first, **dict(zip(_COLUMNS, columns, strict=True)))

    def lengthened(self, by: float) -> ScanPoints:
        """Return the returns with ranges that are longer by a distance [m]."""
        rays = (self.points - self.starts) / np.maximum(self.ranges, 1e-9)[:, None]
        return replace(self, points=self.points + by * rays, ranges=self.ranges + by)

    def without(self, dropped: Bools) -> ScanPoints:
        """Return the returns without some of the points (n_points,)."""
        kept = ~dropped
        first = np.concatenate([[0], np.cumsum(kept)])[self.first].astype(np.intp)
        return ScanPoints(first=first, **{name: getattr(self, name)[kept] for name in _COLUMNS})


def scan_points(
    run: Run, motion: Motion | None = None, *, delays: Floats | None = None, has_normals: bool = True
) -> ScanPoints:
    """Convert the returns of a run to points in base_link at the stamps of their scans.

    Parameters
    ----------
    motion : Motion of base_link in any frame, which deskews the rays of a sweep; None: no deskewing.
    delays : (n_rays,) [s] Time of each ray after the stamp of the scan; None: as in the sensor.
    has_normals : If not, the normals are not estimated, and are 0.
    """
    sensor = run.sensor
    delays = sensor.ray_delays if delays is None else delays
    used = is_used(run)
    starts = range(0, max(run.n_scans, 1), SCANS_PER_BLOCK)
    blocks = [
        _block(run, some, used[some], motion, delays, has_normals)
        for some in (slice(start, start + SCANS_PER_BLOCK) for start in starts)
    ]
    counts, *columns = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return ScanPoints._of(counts, columns)


def is_used(run: Run) -> Bools:
    """Return which ranges (n_scans, n_rays) of a run are those of points."""
    sensor = run.sensor
    used = (run.ranges > sensor.range_min) & (run.ranges < min(sensor.range_max, SCANS.max_range))
    if sensor.resolution > 0:  # the last step before range_max is often a missing return, rounded down
        used &= run.ranges < sensor.range_max - sensor.resolution
    return np.asarray(used)


def _block(
    run: Run, scans: slice, used: Bools, motion: Motion | None, delays: Floats, has_normals: bool
) -> tuple[Ints, Floats, Floats, Floats, Floats, Ints]:
    """Return counts (n,), points, normals, ranges, starts and rays of some scans."""
    rays = laser_rays(run.sensor, run.stamps[scans], motion, delays)  # (n or 1, n_rays, 3)
    ranges = np.where(used, run.ranges[scans], 0.0)
    points = np.stack(
        [rays[..., 0] + ranges * np.cos(rays[..., 2]), rays[..., 1] + ranges * np.sin(rays[..., 2])], axis=-1
    )
    starts = np.broadcast_to(rays[..., :2], points.shape)
    kept = np.zeros(used.shape, dtype=np.bool_)
    normals = np.zeros_like(points)
    if has_normals:
        _normals(points, np.array(starts, order="C"), used, NEIGHBOURHOOD, SCANS.gap, normals)
    _thin(points, used, SPACING, kept)
    return kept.sum(axis=1), points[kept], normals[kept], ranges[kept], starts[kept], np.nonzero(kept)[1]


def laser_rays(sensor: RangeSensor, stamps: Floats, motion: Motion | None, delays: Floats) -> Floats:
    """Return origins and directions of the rays, in base_link at the stamp of each scan.

    Parameters
    ----------
    delays : (n_rays,) [s] Time of each ray after the stamp.

    Returns
    -------
    (n_scans or 1, n_rays, 3) [m, m, rad]
    """
    rays = np.zeros((1, sensor.n_rays, 3))
    rays[..., 2] = sensor.bearings
    if len(sensor.origins):
        rays[0, :, :2] = sensor.origins
    rays = compose(np.broadcast_to(sensor.mount, rays.shape), rays)
    if motion is None or not delays.any():
        return rays
    base = motion.at(stamps[:, None] + delays)  # (n, n_rays, 3)
    moved = compose(invert(motion.at(stamps)[:, None]), base)
    return compose(moved, np.broadcast_to(rays, moved.shape))


@outer_kernel
def _thin(points: Floats, used: Bools, spacing: float, kept: Bools) -> None:
    """Keep a point unless it is near the previously kept point of the scan."""
    n_scans, n_rays = used.shape
    for i in range(n_scans):
        last = -1
        for k in range(n_rays):
            if not used[i, k]:
                continue
            if last >= 0:
                dx = points[i, k, 0] - points[i, last, 0]
                dy = points[i, k, 1] - points[i, last, 1]
                if dx * dx + dy * dy < spacing * spacing:
                    continue
            kept[i, k] = True
            last = k


@outer_kernel
def _normals(points: Floats, starts: Floats, used: Bools, reach: float, gap: float, normals: Floats) -> None:
    """Fit a line to the neighbours of each point along its scan, their principal axis (`line_map`); the normal points to the laser."""
    n_scans, n_rays = used.shape
    for i in range(n_scans):
        for k in range(n_rays):
            if not used[i, k]:
                continue
            n, sx, sy, sxx, sxy, syy = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for way in (-1, 1):
                last, j, length = k, k + way, 0.0
                while 0 <= j < n_rays and used[i, j]:
                    step = np.hypot(
                        points[i, j, 0] - points[i, last, 0], points[i, j, 1] - points[i, last, 1]
                    )
                    length += step
                    if step > gap or (length > reach and last != k):
                        break
                    dx, dy = points[i, j, 0] - points[i, k, 0], points[i, j, 1] - points[i, k, 1]
                    n += 1.0
                    sx, sy = sx + dx, sy + dy
                    sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
                    last, j = j, j + way
            back = np.hypot(points[i, k, 0] - starts[i, k, 0], points[i, k, 1] - starts[i, k, 1]) + 1e-12
            normals[i, k, 0] = UNKNOWN_NORMAL_LENGTH * (starts[i, k, 0] - points[i, k, 0]) / back
            normals[i, k, 1] = UNKNOWN_NORMAL_LENGTH * (starts[i, k, 1] - points[i, k, 1]) / back
            if n < 3:
                continue
            sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            angle = 0.5 * np.arctan2(2 * sxy, sxx - syy)  # direction of the line
            nx, ny = -np.sin(angle), np.cos(angle)
            across = nx * nx * sxx + 2 * nx * ny * sxy + ny * ny * syy
            if across > 0.25 * (sxx + syy):  # variance across above a quarter of the total: no line
                continue
            if nx * (points[i, k, 0] - starts[i, k, 0]) + ny * (points[i, k, 1] - starts[i, k, 1]) > 0:
                nx, ny = -nx, -ny
            normals[i, k, 0], normals[i, k, 1] = nx, ny


class View(NamedTuple):
    """Returns of a scan in the order of their bearings."""

    start: Floats
    """(2,) [m] Mean origin of the rays in base_link."""
    bearing: Floats
    """(n,) [rad] ascending."""
    length: Floats
    """(n,) [m]"""
    widest: float
    """[rad] Gap between neighbouring returns from which the space between them is unobserved."""


def view_of(scans: ScanPoints, own: slice) -> View:
    """Sort the returns of a scan."""
    if own.start == own.stop:
        return View(start=np.zeros(2), bearing=np.zeros(0), length=np.zeros(0), widest=MAX_GAP)
    start = scans.starts[own].mean(axis=0)
    rays = scans.points[own] - start
    bearing, length = np.arctan2(rays[:, 1], rays[:, 0]), np.hypot(*rays.T)
    order = np.argsort(bearing)
    gaps = np.diff(bearing[order])
    widest = max(MAX_GAP, 2.0 * float(np.median(gaps))) if len(gaps) else MAX_GAP
    return View(start=start, bearing=bearing[order], length=length[order], widest=widest)


def crossed(
    points: Floats, pose: Floats, scans: ScanPoints, own: slice, margin: float
) -> tuple[Bools, Bools]:
    """Return which points (n, 2) are visible from a scan, and which of these its rays crossed."""
    return crossed_by(view_of(scans, own), moved_points(points, invert(pose)), margin)


def crossed_by(view: View, points: Floats, margin: float) -> tuple[Bools, Bools]:
    """Return which points (n, 2) in base_link are visible, and which of these the rays of a view crossed."""
    start, bearing, length, widest = view
    if len(bearing) == 0:
        none = np.zeros(len(points), dtype=np.bool_)
        return none, none
    local = points - start
    at, far = np.arctan2(local[:, 1], local[:, 0]), np.hypot(*local.T)
    right = np.searchsorted(bearing, at)
    inside = (right > 0) & (right < len(bearing))
    right = np.clip(right, 1, len(bearing) - 1)
    is_near = bearing[right] - bearing[right - 1] < widest
    in_view = inside & is_near & (far < np.maximum(length[right], length[right - 1]) + margin)
    through = in_view & (far < np.minimum(length[right], length[right - 1]) - margin)
    return in_view, through


def moved_points(points: Floats, pose: Floats) -> Floats:
    """Return points (n, 2) [m] in the frame in which `pose` (3,) is that of their own."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    moved: Floats = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return moved


def contradicts(
    scans: ScanPoints, k: int, pose: Floats, points: Floats, frames: Sequence[int], poses: Floats
) -> bool:
    """Tell whether scan k, taken at `pose`, contradicts what was seen before.

    It does if its rays cross known surfaces, or if its returns lie in space that earlier rays crossed. A view of unknown
    space contradicts nothing.

    Parameters
    ----------
    points : (n, 2) [m] Points of the known surfaces.
    frames, poses : Earlier scans, and their poses (n_frames, 3).
    """
    own = moved_points(scans.points[scans.of(k)], pose)
    views = [crossed(points, pose, scans, scans.of(k), CLOSURES.margin)]
    views += [
        crossed(own, there, scans, scans.of(frame), CLOSURES.margin)
        for frame, there in zip(frames, poses, strict=True)
    ]
    visible = sum(int(seen.sum()) for seen, _ in views)
    gone = sum(int(through.sum()) for _, through in views)
    return visible >= MIN_VISIBLE and gone > CLOSURES.see_through * visible
