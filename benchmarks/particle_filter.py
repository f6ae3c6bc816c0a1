"""AMCL's filter on a log, what a user of Nav2 has, and the errors of the odometry from update to update of a filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from logs import pair
from logs.run import Run
from logs.transforms import compose, invert
from planners.types import Floats
from sensorgraph.exporting.amcl import compare_laser_models, estimate_amcl
from sensorgraph.exporting.amcl_filter import LASER_MODELS, CellDistances, filtered, updates
from sensorgraph.exporting.nav2 import chosen, map_of
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.world.identified_arena import arena_of


def driven(run: Run) -> Floats:
    """Return the odometry (n_scans, 3) at the scans of a run that has one."""
    motion = odometry_of(run)
    assert motion is not None
    return odometry_at_scans(run, motion)


class FittedAmcl(NamedTuple):
    """AMCL's map and what the run of the map says of its parameters."""

    field: CellDistances
    numbers: dict[str, float]
    """Parameters by their names in Nav2."""
    laser_model: str
    lines: tuple[str, ...]
    """Each number with its estimate, and the laser model with its errors."""


def fitted_amcl(run: Run, graph: Sensorgraph) -> FittedAmcl:
    """Fit AMCL's parameters and its laser model to a located run, in the map of its graph."""
    arena = arena_of(graph)
    grid = map_of(arena)
    estimates = estimate_amcl(run, arena, grid)
    numbers = chosen(estimates)
    compared = compare_laser_models(run, grid, numbers)
    model = compared.name if compared else LASER_MODELS[0]
    lines = (
        *(f"{name}: {found}" for name, found in estimates.items()),
        f"laser_model_type: {model}, {compared}",
    )
    return FittedAmcl(field=CellDistances.of(grid), numbers=numbers, laser_model=model, lines=lines)


def followed(
    run: Run,
    truth: Floats,
    field: CellDistances,
    parameters: Mapping[str, float],
    rng: np.random.Generator,
    laser_model: str = LASER_MODELS[0],
) -> Floats:
    """Return the poses (n_scans, 3) of the filter after its updates, nan between them; it is told where to start.

    Parameters
    ----------
    run : its poses are the odometry
    truth : (n_scans, 3) base_link in map
    parameters : by their names in Nav2
    """
    first = int(np.flatnonzero(np.isfinite(truth[:, 0]))[0])
    out = np.full_like(truth, np.nan)
    out[first:] = filtered(
        driven(run)[first:], run.ranges[first:], run.sensor, truth[first], field, parameters,
        rng=rng, laser_model=laser_model,
    )  # fmt: skip
    return out


FREEDOM = 4
"""Degrees of freedom of Student's distribution of the motion noise."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Errors of the odometry between two updates, in the frame of the robot: systematic ones and noise."""

    systematic: Floats
    """(3, 2) Mean error of x, y and phi per metre driven and per radian turned."""
    coefficients: Floats
    """(3, 3) Variance of x, y and phi = coefficients · (1e-4, distance² [m²], turn² [rad²])."""

    @classmethod
    def fit(cls, run: Run) -> Motion:
        """Fit to the steps of a located run: means by least squares, variances by weighted least squares.

        The largest 2 % are cut.
        """
        odometry, poses = driven(run), pair(run).poses
        first = int(np.flatnonzero(np.isfinite(poses[:, 0]))[0])
        at = np.array([first + k for k in updates(odometry[first:])])
        steps = compose(invert(odometry[at[:-1]]), odometry[at[1:]])
        errors = compose(invert(steps), compose(invert(poses[at[:-1]]), poses[at[1:]]))
        known = np.isfinite(errors).all(axis=1)
        steps, errors, rows = steps[known], errors[known], features(steps[known])
        small = (np.abs(errors) <= np.quantile(np.abs(errors), 0.98, axis=0)).all(axis=1)
        systematic = np.linalg.lstsq(steps[small][:, [0, 2]], errors[small], rcond=None)[0].T
        squares = (errors - steps[:, [0, 2]] @ systematic.T) ** 2
        found = []
        for y in np.minimum(squares, np.quantile(squares, 0.98, axis=0)).T:
            variance = np.full(len(y), y.mean())
            for _ in range(10):
                solution = nnls(rows / variance[:, None], y / variance)[0]
                variance = rows @ solution + 1e-8
            found.append(solution)
        return cls(systematic=systematic, coefficients=np.array(found))

    def moved(self, particles: Floats, step: Floats, rng: np.random.Generator) -> Floats:
        """Return particles (n, 3) after a step (3,) of the odometry."""
        sigma = np.sqrt(self.coefficients @ features(step[None])[0])
        noise = rng.standard_t(FREEDOM, size=particles.shape) * np.sqrt((FREEDOM - 2) / FREEDOM)
        errors = self.systematic @ step[[0, 2]] + noise * sigma
        return np.asarray(compose(particles, compose(step, errors)))


def features(steps: Floats) -> Floats:
    """Return the features (n, 3) of steps (n, 3), as `Motion` takes them."""
    return np.column_stack([np.full(len(steps), 1e-4), (steps[:, :2] ** 2).sum(axis=1), steps[:, 2] ** 2])
