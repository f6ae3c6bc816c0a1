"""Follow scans in a 5 cm occupancy grid by a likelihood field: what a user of grids would do, beside our localisation.

The field is that of Thrun, Burgard and Fox (2005), table 6.3, interpolated between cells as in Kohlbrecher et al. (2011);
each scan is matched by Gauss-Newton, with the same steps from scan to scan as ours has, and the same prior on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from benchmarks.occupancy_grid import GRID_CELL, Grid
from logs.run import Run, pair
from logs.transforms import compose, invert, wrap
from planners.types import Floats
from sensorgraph.localization.map_settings import MAP_TRACKING
from sensorgraph.localization.scan_track import ScanTrack, information_at
from sensorgraph.localization.scans import ScanPoints

MOST_DISTANCE = 2.0
"""[m] as AMCL's laser_likelihood_max_dist."""
RANDOM = 0.5 / 0.5 / 10.0
"""[1/m] z_rand / z_hit over the longest range."""
LOST = 0.5
"""[m] from the truth, at which the robot is put back to it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceGrid:
    """Distance to the nearest occupied cell, between the middles of cells interpolated."""

    low: Floats
    distance: Floats
    """(nx, ny) [m]"""

    @classmethod
    def of(cls, grid: Grid, threshold: float) -> DistanceGrid:
        """Take the cells with a share of hits of `threshold` or more."""
        free = grid.share.reshape(grid.shape) < threshold
        distance = np.minimum(GRID_CELL * distance_transform_edt(free), MOST_DISTANCE)
        return cls(low=np.asarray(grid.low, dtype=np.float64), distance=np.asarray(distance))

    def at(self, points: Floats) -> tuple[Floats, Floats]:
        """Return distances (n,) [m] and their gradients (n, 2) at points (n, 2)."""
        at = (points - self.low) / GRID_CELL - 0.5
        cell = np.clip(np.floor(at).astype(np.intp), 0, np.array(self.distance.shape) - 2)
        u, v = np.clip(at - cell, 0.0, 1.0).T
        i, j = cell.T
        d = self.distance
        a, b, c, e = d[i, j], d[i + 1, j], d[i, j + 1], d[i + 1, j + 1]
        value = (1 - u) * ((1 - v) * a + v * c) + u * ((1 - v) * b + v * e)
        slope = np.column_stack([(1 - v) * (b - a) + v * (e - c), (1 - u) * (c - a) + u * (e - b)])
        return value, slope / GRID_CELL


def grid_of(run: Run) -> Grid:
    """Make the grid of a located run."""
    pairing = pair(run)
    poses = pairing.poses[pairing.paired]
    if run.pose_frame == "base_link":
        poses = compose(poses, np.broadcast_to(run.sensor.mount, poses.shape))
    return Grid(poses, run.ranges[pairing.paired], run.sensor.bearings)


def follow(field: DistanceGrid, sigma: float, scans: ScanPoints, steps: ScanTrack, truth: Floats) -> Floats:
    """Return the poses (n_scans, 3) of all scans, from the truth on; nan before it is known."""
    s = MAP_TRACKING
    poses = np.full_like(truth, np.nan)
    known = np.flatnonzero(np.isfinite(truth[:, 0]))
    poses[known[0]] = truth[known[0]]
    for k in range(int(known[0]) + 1, len(truth)):
        step = compose(invert(steps.poses[k - 1]), steps.poses[k])
        poses[k] = compose(poses[k - 1], step)
        own = scans.of(k)
        if own.stop - own.start >= s.min_points:
            way = float(np.hypot(step[0], step[1]))
            sd = np.asarray(s.prior_floor) + s.prior_per_motion * (way + abs(step[2]))
            poses[k] = _matched(field, sigma, scans.points[own], poses[k], information_at(poses[k], sd))
        if np.isfinite(truth[k, 0]) and np.hypot(*(poses[k] - truth[k])[:2]) > LOST:
            poses[k] = truth[k]
    return poses


def _matched(field: DistanceGrid, sigma: float, points: Floats, prior: Floats, information: Floats) -> Floats:
    """Return the pose (3,) that fits a scan's points (n, 2) and its prior best."""
    pose = prior.copy()
    for _ in range(8):
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        ahead = points @ np.array([[cos, sin], [-sin, cos]])
        distance, slope = field.at(ahead + pose[:2])
        hit = np.exp(-0.5 * (distance / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        weight = hit / (hit + RANDOM) / sigma**2
        jacobian = np.column_stack([slope, slope[:, 1] * ahead[:, 0] - slope[:, 0] * ahead[:, 1]])
        off = pose - prior
        off[2] = wrap(off[2])
        move = np.linalg.solve(
            (jacobian * weight[:, None]).T @ jacobian + information,
            -(jacobian.T @ (weight * distance)) - information @ off,
        )
        pose = pose + move
        if np.abs(move).max() < 1e-4:
            break
    return np.asarray(pose)
