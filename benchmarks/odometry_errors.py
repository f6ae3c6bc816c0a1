"""Errors of a robot's odometry from update to update of a filter, fitted to a located run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from benchmarks.particle_filter import driven
from logs import pair
from logs.run import Run
from logs.transforms import compose, invert
from planners.types import Floats
from sensorgraph.exporting.amcl_filter import updates

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
