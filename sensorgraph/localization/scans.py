"""Returns of a run as points in base_link, deskewed for the motion during a sweep, with surface normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor, Run
from logs.transforms import compose, invert
from planners.kernel import kernel
from sensorgraph.localization.settings import SCANS, UNKNOWN_NORMAL_LENGTH
from sensorgraph.types import Bools, Floats, Ints

SCANS_PER_BLOCK = 1000
"""Number of scans that are deskewed at once; it bounds the memory."""


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
        parts = [(source, source.of(k)) for k, source in enumerate(sources)]
        counts = [part.stop - part.start for _, part in parts]
        return ScanPoints(
            first=np.concatenate([[0], np.cumsum(counts)]).astype(np.intp),
            points=np.concatenate([source.points[part] for source, part in parts]),
            normals=np.concatenate([source.normals[part] for source, part in parts]),
            ranges=np.concatenate([source.ranges[part] for source, part in parts]),
            starts=np.concatenate([source.starts[part] for source, part in parts]),
            rays=np.concatenate([source.rays[part] for source, part in parts]),
        )

    def without(self, dropped: Bools) -> ScanPoints:
        """Return the returns without some of the points (n_points,)."""
        kept = ~dropped
        return ScanPoints(
            first=np.concatenate([[0], np.cumsum(kept)])[self.first].astype(np.intp),
            points=self.points[kept],
            normals=self.normals[kept],
            ranges=self.ranges[kept],
            starts=self.starts[kept],
            rays=self.rays[kept],
        )


def scan_points(
    run: Run,
    motion: Motion | None = None,
    *,
    delays: Floats | None = None,
) -> ScanPoints:
    """Convert the returns of a run to points in base_link at the stamps of their scans.

    Parameters
    ----------
    motion : Motion of base_link in any frame, which deskews the rays of a sweep; None: no deskewing.
    delays : (n_rays,) [s] Time of each ray after the stamp of the scan; None: as in the sensor.
    """
    sensor = run.sensor
    delays = sensor.ray_delays if delays is None else delays
    used = (run.ranges > sensor.range_min) & (run.ranges < min(sensor.range_max, SCANS.max_range))
    if sensor.resolution > 0:  # the last step before range_max is often a missing return, rounded down
        used &= run.ranges < sensor.range_max - sensor.resolution
    blocks = [
        _block(
            run,
            slice(start, start + SCANS_PER_BLOCK),
            used[start : start + SCANS_PER_BLOCK],
            motion,
            delays,
        )
        for start in range(0, max(run.n_scans, 1), SCANS_PER_BLOCK)
    ]
    counts = np.concatenate([block[0] for block in blocks])
    points, normals, ranges, starts = (np.concatenate([block[k] for block in blocks]) for k in range(1, 5))
    return ScanPoints(
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.intp),
        points=points,
        normals=normals,
        ranges=ranges,
        starts=starts,
        rays=np.concatenate([block[5] for block in blocks]),
    )


def _block(
    run: Run, scans: slice, used: Bools, motion: Motion | None, delays: Floats
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
    _normals(points, np.ascontiguousarray(starts), used, SCANS.reach, SCANS.gap, normals)
    _thin(points, used, SCANS.spacing, kept)
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


@kernel
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


@kernel
def _normals(points: Floats, starts: Floats, used: Bools, reach: float, gap: float, normals: Floats) -> None:
    """Fit a line to the neighbours of each point along its scan; the normal points to the laser."""
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
