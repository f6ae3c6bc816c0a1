"""A plain particle filter with AMCL's models and Nav2's parameters: what a user of Nav2 has, beside our localisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.scans import scan_points

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceField:
    """Distance to the nearest occupied cell, as AMCL's likelihood field has it."""

    low: Floats
    cell: float
    distance: Floats
    """(ny, nx) [m]"""

    @classmethod
    def of(cls, free: NDArray[np.bool_], low: Floats, cell: float) -> DistanceField:
        """Measure it on a grid (ny, nx) of cells that are not occupied."""
        return cls(low=low, cell=cell, distance=np.minimum(cell * distance_transform_edt(free), 2.0))


def filtered(
    run: Run, truth: Floats, field: DistanceField, parameters: Mapping[str, float], rng: np.random.Generator
) -> Floats:
    """Return the poses (n_scans, 3) that a particle filter has after its updates, nan between them.

    AMCL's models (Thrun, Burgard and Fox 2005, tables 5.6 and 6.3): 60 beams, 2,000 particles, updates every 0.25 m or
    0.2 rad; it is told where to start.

    Parameters
    ----------
    run : its poses are the odometry
    truth : (n_scans, 3) base_link in map
    parameters : by their names in Nav2
    """
    motion = odometry_of(run)
    assert motion is not None
    odometry = odometry_at_scans(run, motion)
    first = int(np.flatnonzero(np.isfinite(truth[:, 0]))[0])
    particles = truth[first] + rng.normal(size=(2000, 3)) * [0.25, 0.25, 0.07]
    mean, last, estimates = truth[first], first, np.full_like(truth, np.nan)
    scans = scan_points(run)
    for k in range(first, len(truth)):
        step = compose(invert(odometry[last]), odometry[k])
        if np.hypot(step[0], step[1]) > 0.25 or abs(wrap(step[2])) > 0.2:
            particles = _moved(particles, step, parameters, rng)
            own = np.arange(scans.first[k], scans.first[k + 1])
            if len(own):
                seen = scans.points[own[np.linspace(0, len(own) - 1, min(60, len(own))).astype(int)]]
                weights = _weights(particles, seen, field, parameters)
                mean = _mean(particles, weights)
                at = np.searchsorted(np.cumsum(weights), (np.arange(2000) + rng.uniform()) / 2000)
                particles = particles[np.clip(at, 0, 1999)]
            last = k
            estimates[k] = mean
    return estimates


def _moved(
    particles: Floats, step: Floats, parameters: Mapping[str, float], rng: np.random.Generator
) -> Floats:
    way, turn = float(np.hypot(step[0], step[1])), float(wrap(step[2]))
    before = float(np.arctan2(step[1], step[0])) if way > 0.01 else 0.0
    after = float(wrap(turn - before))
    a = min(abs(before), abs(wrap(before - np.pi)))  # backwards is as good as forwards
    b = min(abs(after), abs(wrap(after - np.pi)))
    n = len(particles)
    a1, a2, a3, a4 = (parameters[f"alpha{k}"] for k in (1, 2, 3, 4))
    first = before - rng.normal(size=n) * np.sqrt(a1 * a**2 + a2 * way**2)
    length = way - rng.normal(size=n) * np.sqrt(a3 * way**2 + a4 * (a**2 + b**2))
    second = after - rng.normal(size=n) * np.sqrt(a1 * b**2 + a2 * way**2)
    x = particles[:, 0] + length * np.cos(particles[:, 2] + first)
    y = particles[:, 1] + length * np.sin(particles[:, 2] + first)
    return np.column_stack([x, y, particles[:, 2] + first + second])


def _weights(
    particles: Floats, seen: Floats, field: DistanceField, parameters: Mapping[str, float]
) -> Floats:
    cos, sin = np.cos(particles[:, 2:]), np.sin(particles[:, 2:])
    x = particles[:, :1] + cos * seen[:, 0] - sin * seen[:, 1]
    y = particles[:, 1:2] + sin * seen[:, 0] + cos * seen[:, 1]
    i, j = ((x - field.low[0]) / field.cell).astype(int), ((y - field.low[1]) / field.cell).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < field.distance.shape[1]) & (j < field.distance.shape[0])
    d = np.where(inside, field.distance[np.where(inside, j, 0), np.where(inside, i, 0)], 2.0)
    p = parameters["z_hit"] * np.exp(-(d**2) / (2 * parameters["sigma_hit"] ** 2))
    p = p + parameters["z_rand"] / parameters["laser_max_range"]
    weights = 1.0 + (p**3).sum(axis=1)  # as AMCL has it
    return np.asarray(weights / weights.sum())


def _mean(particles: Floats, weights: Floats) -> Floats:
    place = weights @ particles[:, :2]
    return np.array(
        [*place, np.arctan2(weights @ np.sin(particles[:, 2]), weights @ np.cos(particles[:, 2]))]
    )
