"""A small particle filter with AMCL's models, to evaluate its parameters on a run.

The models are those of Nav2's AMCL: odometry (Thrun, Burgard and Fox 2005, table 5.6) and likelihood field
(table 6.3). The likelihood of a return is

    p = z_hit exp(-distance² / (2 sigma_hit²)) + z_rand / laser_max_range.

The two laser models combine the returns differently. `likelihood_field` weights a particle by 1 + sum p³,
which is always nearly flat; `likelihood_field_prob` weights it by the product of p.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from logs.run import OccupancyMap, RangeSensor
from logs.transforms import compose, invert
from planners.arena import wrap
from sensorgraph.types import Floats, Ints

LASER_MODELS = ("likelihood_field", "likelihood_field_prob")
"""The first is Nav2's default."""
MIN_D, MIN_A = 0.25, 0.2
"""[m], [rad] Motion between two updates of AMCL (update_min_d, update_min_a)."""
MAX_BEAMS = 60
MAX_DISTANCE = 2.0
"""[m] Maximum distance of a return to the nearest occupied cell (laser_likelihood_max_dist)."""
START_SPREAD = (0.25, 0.25, 0.07)
"""[m, m, rad] Standard deviations of the initial particles."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellDistances:
    """Distance to the nearest occupied cell."""

    low: Floats
    """(2,) [m] Lower left corner of the grid."""
    cell: float
    distance: Floats
    """(ny, nx) [m], at most MAX_DISTANCE."""

    @classmethod
    def of(cls, grid: OccupancyMap) -> CellDistances:
        """Compute the distances of a map."""
        far = grid.resolution * distance_transform_edt(grid.data != 100)
        return cls(
            low=np.asarray(grid.origin[:2]), cell=grid.resolution, distance=np.minimum(far, MAX_DISTANCE)
        )

    def at(self, points: Floats) -> Floats:
        """Return the distance (...) [m] of points (..., 2); nan off the map, and where they are not finite."""
        column, row = np.moveaxis(np.floor((points - self.low) / self.cell), -1, 0)
        ny, nx = self.distance.shape
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (row >= 0) & (column < nx) & (row < ny)
        at = (np.where(inside, one, 0).astype(np.intp) for one in (row, column))
        return np.where(inside, self.distance[tuple(at)], np.nan)

    def table(self, parameters: Mapping[str, float], laser_model: str) -> Floats:
        """Return the contribution of a return in each cell (ny * nx + 1,); the last is for a return off the map."""
        distance = np.append(self.distance.ravel(), MAX_DISTANCE)
        p = parameters["z_hit"] * np.exp(-0.5 * (distance / parameters["sigma_hit"]) ** 2)
        p += parameters["z_rand"] / parameters["laser_max_range"]
        return p**3 if laser_model == LASER_MODELS[0] else np.log(p)


def updates(odometry: Floats) -> Iterator[int]:
    """Yield the scans at which the filter updates, given the odometry (n, 3)."""
    last = 0
    for k in range(len(odometry)):
        way = np.hypot(*(odometry[k, :2] - odometry[last, :2]))
        if way > MIN_D or abs(wrap(odometry[k, 2] - odometry[last, 2])) > MIN_A:
            last = k
            yield k


def filtered(
    odometry: Floats,
    ranges: Floats,
    sensor: RangeSensor,
    start: Floats,
    field: CellDistances,
    parameters: Mapping[str, float],
    *,
    rng: np.random.Generator,
    laser_model: str = LASER_MODELS[0],
    n_particles: int = 2000,
) -> Floats:
    """Return the poses (n, 3) of the filter after its updates, nan at other scans.

    Parameters
    ----------
    odometry : (n, 3) [m, m, rad] Odometry at the scans.
    ranges : (n, n_rays) [m]
    start : (3,) Pose at the first scan, or (n_particles, 3): the particles there.
    parameters : Parameters by their names in Nav2.
    """
    particles = start if start.ndim == 2 else start + rng.normal(size=(n_particles, 3)) * START_SPREAD
    table, out, last = field.table(parameters, laser_model), np.full((len(odometry), 3), np.nan), 0
    rays = np.arange(0, sensor.n_rays, max((sensor.n_rays - 1) // (MAX_BEAMS - 1), 1))
    top = min(parameters["laser_max_range"], sensor.range_max - sensor.resolution)
    for k in updates(odometry):
        step = compose(invert(odometry[last]), odometry[k])
        particles, last = _moved(particles, step, parameters, rng), k
        used = rays[(ranges[k, rays] > sensor.range_min) & (ranges[k, rays] < top)]
        if len(used) == 0:
            continue
        bearings = sensor.bearings[used] + sensor.mount[2]
        ends = sensor.mount[:2] + ranges[k, used, None] * np.column_stack(
            [np.cos(bearings), np.sin(bearings)]
        )
        contributions = _contributions(particles, ends, field, table).sum(axis=1)
        weights = (
            1.0 + contributions
            if laser_model == LASER_MODELS[0]
            else np.exp(contributions - contributions.max())
        )
        weights /= weights.sum()
        out[k] = mean_pose(particles, weights)
        particles = particles[drawn(weights, rng)]
    return out


def _moved(
    particles: Floats, step: Floats, parameters: Mapping[str, float], rng: np.random.Generator
) -> Floats:
    way, turn = float(np.hypot(step[0], step[1])), float(wrap(step[2]))
    before = float(np.arctan2(step[1], step[0])) if way > 0.01 else 0.0
    after = float(wrap(turn - before))
    a = min(abs(before), abs(float(wrap(before - np.pi))))  # reversing counts as driving forwards
    b = min(abs(after), abs(float(wrap(after - np.pi))))
    n = len(particles)
    a1, a2, a3, a4 = (parameters[f"alpha{k}"] for k in (1, 2, 3, 4))
    first = before - rng.normal(size=n) * np.sqrt(a1 * a**2 + a2 * way**2)
    length = way - rng.normal(size=n) * np.sqrt(a3 * way**2 + a4 * (a**2 + b**2))
    second = after - rng.normal(size=n) * np.sqrt(a1 * b**2 + a2 * way**2)
    x = particles[:, 0] + length * np.cos(particles[:, 2] + first)
    y = particles[:, 1] + length * np.sin(particles[:, 2] + first)
    return np.column_stack([x, y, particles[:, 2] + first + second])


def drawn(weights: Floats, rng: np.random.Generator) -> Ints:
    """Return the indices (n,) of new particles, drawn by systematic resampling with weights (n,) that sum to 1."""
    n = len(weights)
    return np.clip(np.searchsorted(np.cumsum(weights), (np.arange(n) + rng.uniform()) / n), 0, n - 1)


def _contributions(particles: Floats, ends: Floats, field: CellDistances, table: Floats) -> Floats:
    """Return the contribution of each return for each particle (n_particles, n_returns)."""
    cos, sin = np.cos(particles[:, 2:]) / field.cell, np.sin(particles[:, 2:]) / field.cell
    place = (particles[:, :2] - field.low) / field.cell
    column = np.floor(place[:, :1] + cos * ends[:, 0] - sin * ends[:, 1]).astype(np.intp)
    row = np.floor(place[:, 1:] + sin * ends[:, 0] + cos * ends[:, 1]).astype(np.intp)
    ny, nx = field.distance.shape
    inside = (column >= 0) & (row >= 0) & (column < nx) & (row < ny)
    return np.asarray(table[np.where(inside, row * nx + column, ny * nx)])


def mean_pose(particles: Floats, weights: Floats) -> Floats:
    """Return the mean pose (3,) of particles (n, 3) with weights (n,) that sum to 1."""
    turn = np.arctan2(weights @ np.sin(particles[:, 2]), weights @ np.cos(particles[:, 2]))
    return np.array([*(weights @ particles[:, :2]), turn])
