"""Ray casting: exact range, incidence and wall of every ray of every scan.

`cast` works wall by wall: it finds the rays between the bearings of the two ends of a wall and intersects
only those. Its cost is walls + hits, instead of walls x rays. With many walls, each ray traverses a grid of
them instead (`wall_grid`). `cast_rays` is for rays without a common origin, as of a sensor that sweeps during motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np

from logs.run import RangeSensor
from logs.transforms import compose
from planners.arena import Arena, wrap
from sensorgraph.types import Floats, Ints
from sensorgraph.world.ray_intersection import nearest_from_each
from sensorgraph.world.wall_grid import WallGrid, nearest_in_grid

POSES_PER_BATCH = 48  # poses per batch: the working set stays in the cache
MAX_UNSORTED_WALLS = 160  # number of walls up to which every wall is intersected from every pose
BEARING_PAD = 1e-12  # [rad] widens the bearings of a wall, so that no ray passes through a shared corner
GRAZING_ANGLE = 1e-3  # [rad] angle between ray and wall below which the hit is limited to the wall's ends


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """Ideal readings."""

    ranges: Floats
    """(n_scans, n_rays) [m]; +inf without a hit within range_max, -inf nearer than range_min (REP-117)."""
    incidence: Floats
    """(n_scans, n_rays) [rad] Angle between ray and wall normal, 0 = head-on; nan without a wall in range."""
    wall: Ints
    """(n_scans, n_rays) Index of the wall in `Arena.walls`; -1 without a wall in range."""


def laser_poses(poses: Floats, mount: Floats) -> Floats:
    """Return the laser poses for base_link poses (..., 3) and a mount (3,): T_map_base @ T_base_laser."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x = poses[..., 0] + c * mount[0] - s * mount[1]
    y = poses[..., 1] + s * mount[0] + c * mount[1]
    return np.stack([x, y, poses[..., 2] + mount[2]], axis=-1)


def ray_starts(lasers: Floats, sensor: RangeSensor) -> Floats:
    """Return the origin of each ray of a composite sensor, for laser poses (..., n_rays, 3) in map."""
    starts = np.column_stack([sensor.origins, np.zeros(sensor.n_rays)])
    return compose(lasers, starts)


def cast(arena: Arena, poses: Floats, sensor: RangeSensor) -> Hits:
    """Cast every ray of every scan against the walls.

    Parameters
    ----------
    poses : (n_scans, 3) [m, m, rad], base_link in map

    Returns
    -------
    Hits with arrays (n_scans, n_rays)
    """
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise ValueError(f"poses has shape {poses.shape}, expected (n_scans, 3)")
    lasers = laser_poses(poses, sensor.mount)
    if sensor.is_composite:
        rays = ray_starts(lasers[:, None], sensor)
        return cast_rays(arena, rays[..., :2], rays[..., 2] + sensor.bearings, sensor)
    return _Caster(_prepared_walls(arena), sensor)(lasers)


def cast_laser(walls: Floats, lasers: Floats, bearings: Floats, farthest: float) -> tuple[Floats, Ints]:
    """Cast from laser poses against walls, without an arena and without the limits of a sensor.

    Parameters
    ----------
    walls : (n_walls, 2, 2) [m, map]
    lasers : (n_scans, 3) [m, m, rad] Laser in map.
    bearings : (n_rays,) [rad] Increasing, over less than a full turn.

    Returns
    -------
    Ranges (n_scans, n_rays) [m], inf beyond `farthest`, and the index of the wall, -1 without a hit.
    """
    if len(walls) == 0:
        shape = (len(lasers), len(bearings))
        return np.full(shape, np.inf), np.full(shape, -1, dtype=np.intp)
    sensor = RangeSensor(bearings=bearings, range_min=0.0, range_max=farthest)
    hits = _Caster(_prepared_copy(np.ascontiguousarray(walls).tobytes()), sensor)(lasers)
    return hits.ranges, hits.wall


def directions(phi: Floats, bearings: Floats) -> tuple[Floats, Floats]:
    """Return cos and sin of phi + bearing, (n_scans, n_rays), by the addition theorem (numpy's cos is slow)."""
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    cb, sb = np.cos(bearings), np.sin(bearings)
    return c * cb - s * sb, s * cb + c * sb


def cast_rays(arena: Arena, origins: Floats, headings: Floats, sensor: RangeSensor) -> Hits:
    """Cast rays with individual origins, every ray against every wall.

    Parameters
    ----------
    origins : (n_scans, n_rays, 2) [m] In map.
    headings : (n_scans, n_rays) [rad] Directions of the rays in map.

    Returns
    -------
    Hits with arrays (n_scans, n_rays)
    """
    shape = headings.shape
    x, y = np.ascontiguousarray(origins.reshape(-1, 2).T, dtype=np.float64)
    ux, uy = np.cos(headings).ravel(), np.sin(headings).ravel()
    ranges, wall = nearest_from_each(arena.walls, x, y, ux, uy)
    ranges, incidence, wall = _apply_limits(_unit_tangents(arena.walls), ux, uy, ranges, wall, sensor)
    return Hits(ranges=ranges.reshape(shape), incidence=incidence.reshape(shape), wall=wall.reshape(shape))


def _apply_limits(
    along: Floats, ux: Floats, uy: Floats, ranges: Floats, wall: Ints, sensor: RangeSensor
) -> tuple[Floats, Floats, Ints]:
    """Apply the range limits of the sensor and compute the incidence; return ranges, incidence and wall."""
    out = ~(ranges <= sensor.range_max)
    wall = np.where(out, -1, wall)
    cosine = np.abs(ux * along[1][wall] - uy * along[0][wall])
    incidence = np.where(out, np.nan, np.arccos(np.minimum(cosine, 1.0)))
    limited = np.where(out, np.inf, np.where(ranges < sensor.range_min, -np.inf, ranges))
    return limited, incidence, wall


class _CastBatch:
    """A batch of scans during a cast: laser poses, directions of the rays, and the nearest hits so far."""

    def __init__(self, poses: Floats, bearings: Floats) -> None:
        self.poses = poses  # (n_poses, 3)
        self.turn = wrap(poses[:, 2] + bearings[0])  # (n_poses,) direction of ray 0
        self.ux, self.uy = directions(poses[:, 2], bearings)  # (n_poses, n_rays)
        self.ranges = np.full(self.ux.shape, np.inf)
        self.wall = np.full(self.ux.shape, -1, dtype=np.intp)


class _Caster:
    """Angular-interval method: for each pose and wall, the run of rays between the two ends of the wall."""

    def __init__(self, walls: _Walls, sensor: RangeSensor) -> None:
        self.vertices, self.ends = walls.vertices, walls.ends
        self.along = walls.along
        self.walls, self.grid = walls.walls, walls.grid
        self.sensor = sensor
        self.bearings = bearings = sensor.bearings
        self.n_rays = sensor.n_rays
        step = np.diff(bearings)
        even = (
            len(step) > 0
            and float(np.ptp(step)) < 1e-14 * max(1.0, float(np.abs(bearings).max())) * self.n_rays
        )
        self.step = float((bearings[-1] - bearings[0]) / (self.n_rays - 1)) if even else None

    def __call__(self, poses: Floats) -> Hits:
        """Cast from poses (n_poses, 3) of the laser."""
        shape = (len(poses), self.n_rays)
        ranges, incidence, wall = np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.intp)
        for start in range(0, len(poses), POSES_PER_BATCH):
            part = slice(start, start + POSES_PER_BATCH)
            scans = _CastBatch(poses[part], self.bearings)
            if self.grid is not None:
                self._through_grid(scans, self.grid)
            elif self.along.size:
                self._dense(scans)
            done = _apply_limits(self.along, scans.ux, scans.uy, scans.ranges, scans.wall, self.sensor)
            ranges[part], incidence[part], wall[part] = done
        return Hits(ranges=ranges, incidence=incidence, wall=wall)

    def _dense(self, scans: _CastBatch) -> None:
        """Intersect every wall from every pose; walls share their vertices."""
        poses, n_walls = scans.poses, len(self.along[0])
        x = self.vertices[0] - poses[:, :1]  # (n_poses, n_vertices)
        y = self.vertices[1] - poses[:, 1:2]
        angle = self._angle(x, y, scans.turn[:, None])
        i, j = self.ends
        ax, ay = x[:, i].ravel(), y[:, i].ravel()  # (n_poses * n_walls,)
        pose, k = np.divmod(np.arange(len(poses) * n_walls), n_walls)
        self._meet(scans, pose, k, (ax, ay), angle[:, i].ravel(), angle[:, j].ravel())

    def _through_grid(self, scans: _CastBatch, grid: WallGrid) -> None:
        """Let each ray traverse the cells of a grid of walls."""
        ox, oy = np.repeat(scans.poses[:, :2].T, self.n_rays, axis=1)
        ranges, wall = nearest_in_grid(self.walls, grid, ox, oy, scans.ux.ravel(), scans.uy.ravel())
        scans.ranges, scans.wall = ranges.reshape(scans.ux.shape), wall.reshape(scans.ux.shape)

    @staticmethod
    def _angle(x: Floats, y: Floats, turn: Floats) -> Floats:
        """Return the bearing of points, counted counter-clockwise from ray 0, in [0, 2 pi]."""
        angle = np.arctan2(y, x)
        angle -= turn
        angle += np.where(angle < 0, 2 * np.pi, 0.0)  # numpy's mod is ten times slower
        return angle

    def _meet(
        self,
        scans: _CastBatch,
        pose: Ints,
        walls: Ints,
        end: tuple[Floats, Floats],
        angle_i: Floats,
        angle_j: Floats,
    ) -> None:
        """Intersect the wall of each pair with the rays between its ends.

        `end` is the first end of the wall relative to the pose; the angles of both ends are counted from ray
        0.
        """
        side = (
            end[0] * self.along[1][walls] - end[1] * self.along[0][walls]
        )  # signed distance of the wall's line
        ahead = side > 0  # then the first end is the right one
        right, left = np.where(ahead, angle_i, angle_j), np.where(ahead, angle_j, angle_i)
        pair, at = self._runs(right, left, pose * self.n_rays)
        k = walls[pair]
        ux, uy = scans.ux.reshape(-1)[at], scans.uy.reshape(-1)[at]
        dx, dy = self.along[0][k], self.along[1][k]
        across = ux * dy - uy * dx  # cosine of the incidence
        with np.errstate(divide="ignore", invalid="ignore"):
            r = side[pair] / across
        grazing = np.flatnonzero(np.abs(across) < GRAZING_ANGLE)
        if len(grazing):
            g, p = grazing, pair[grazing]
            a, b = self.vertices[:, self.ends[0][k[g]]], self.vertices[:, self.ends[1][k[g]]]
            r[g] = _intersect_grazing(end[0][p], end[1][p], b[0] - a[0], b[1] - a[1], ux[g], uy[g])
        _keep_nearest(scans.ranges.reshape(-1), scans.wall.reshape(-1), at, r, k)

    def _runs(self, right: Floats, left: Floats, base: Ints) -> tuple[Ints, Ints]:
        """Return (index of the pair, base of the pair + ray) for every ray between the right and left end of each wall."""
        wraps = left < right - 2 * BEARING_PAD  # the wall spans the direction of ray 0: two runs
        first, last = self._window(right, np.where(wraps, 2 * np.pi + BEARING_PAD, left))
        pair, at = _expand_runs(first, last, base)
        where = np.flatnonzero(wraps)
        if len(where):
            _, last = self._window(left[where], left[where])
            more, more_at = _expand_runs(np.zeros_like(last), last, base[where])
            pair, at = np.concatenate([pair, where[more]]), np.concatenate([at, more_at])
        return pair, at

    def _window(self, right: Floats, left: Floats) -> tuple[Ints, Ints]:
        """Return the first and last ray between two angles counted from ray 0."""
        if self.step is None:
            relative = self.bearings - self.bearings[0]
            first = np.searchsorted(relative, right - BEARING_PAD, side="left")
            return first, np.searchsorted(relative, left + BEARING_PAD, side="right") - 1
        pad = BEARING_PAD / self.step
        first = np.ceil(right * (1 / self.step) - pad).astype(np.intp)
        last = np.floor(left * (1 / self.step) + pad).astype(np.intp)
        return first, np.minimum(last, self.n_rays - 1, out=last)


class _Walls:
    """Prepared walls of an arena."""

    def __init__(self, walls: Floats) -> None:
        points, ends = np.unique(walls[..., 0] + 1j * walls[..., 1], return_inverse=True)
        self.vertices = np.stack([points.real, points.imag])  # (2, n_vertices)
        self.ends = np.ascontiguousarray(ends.reshape(-1, 2).T)  # (2, n_walls)
        self.along = _unit_tangents(walls)  # (2, n_walls)
        self.walls = np.array(walls, order="C")  # writable: a kernel compiles read-only arrays once more
        self.grid = WallGrid.of(walls) if len(walls) > MAX_UNSORTED_WALLS else None


_PREPARED_WALLS: WeakKeyDictionary[Arena, _Walls] = WeakKeyDictionary()


def _prepared_walls(arena: Arena) -> _Walls:
    if arena not in _PREPARED_WALLS:
        _PREPARED_WALLS[arena] = _Walls(arena.walls)
    return _PREPARED_WALLS[arena]


@lru_cache(maxsize=8)
def _prepared_copy(walls: bytes) -> _Walls:
    """Return the prepared walls for equal walls in many casts, though not the same array, as those of a scene."""
    return _Walls(np.frombuffer(walls).reshape(-1, 2, 2))


def _keep_nearest(ranges: Floats, wall: Ints, at: Ints, r: Floats, k: Ints) -> None:
    """Keep the minimum r per ray, and its wall; of equally near walls the first."""
    before = ranges.copy()
    np.minimum.at(ranges, at, r)
    nearest = np.flatnonzero(r == ranges[at])[::-1]  # backwards: of equals the first is written last
    at, k = at[nearest], k[nearest]
    tied = (before[at] == ranges[at]) & (wall[at] >= 0)
    wall[at] = np.where(tied, np.minimum(wall[at], k), k)


def _expand_runs(first: Ints, last: Ints, base: Ints) -> tuple[Ints, Ints]:
    """Return (index, base[index] + ray) for every ray of the runs first..last."""
    count = last - first + 1
    some = np.flatnonzero(count > 0)
    count = count[some]
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    at = np.repeat(base[some] + first[some] - (ends - count), count)
    at += np.arange(total)
    return np.repeat(some, count), at


def _unit_tangents(walls: Floats) -> Floats:
    """Return the unit vector along each wall, (2, n_walls)."""
    d = (walls[:, 1] - walls[:, 0]).T
    return np.ascontiguousarray(d / np.maximum(np.hypot(*d), 1e-300))


def _intersect_grazing(ax: Floats, ay: Floats, dx: Floats, dy: Floats, ux: Floats, uy: Floats) -> Floats:
    """Intersect nearly parallel rays and walls, with the hit limited to the wall between its ends (a, a + d)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip((ax * uy - ay * ux) / (ux * dy - uy * dx), 0.0, 1.0)
    near = np.hypot(ax, ay) <= np.hypot(ax + dx, ay + dy)
    share = np.where(np.isfinite(share), share, np.where(near, 0.0, 1.0))
    along = (ax + share * dx) * ux + (ay + share * dy) * uy
    return np.where(along >= 0, along, np.inf)
