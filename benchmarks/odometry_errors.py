"""Errors of a robot's odometry from update to update of a filter, fitted to a located run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from benchmarks.particle_filter import driven
from logs import pair
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.exporting.amcl_filter import updates

Floats = NDArray[np.float64]
MIN_SECONDS = 0.01
"""[s] Shortest time between two updates; some logs repeat their stamps."""
FREEDOM = 4
"""Degrees of freedom of Student's distribution of the motion noise."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Odometry at the scans of a run."""

    odometry: Floats
    """(n_scans, 3) [m, m, rad]"""
    stamps: Floats
    """(n_scans,) [s]"""

    @classmethod
    def of(cls, run: Run) -> Drive:
        """Take the odometry of a run."""
        return cls(odometry=driven(run), stamps=run.stamps)

    def steps(self, at: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return the steps (n - 1, 3) between scans (n,), and their features (n - 1, 5) as `Motion` takes them."""
        steps = compose(invert(self.odometry[at[:-1]]), self.odometry[at[1:]])
        squares = np.column_stack([(steps[:, :2] ** 2).sum(axis=1), steps[:, 2] ** 2])
        seconds = np.maximum(np.diff(self.stamps[at]), MIN_SECONDS)[:, None]
        return steps, np.hstack([np.full((len(steps), 1), 1e-4), squares, squares / seconds**2])


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Errors of the odometry between two updates, in the frame of the robot: systematic ones and noise."""

    systematic: Floats
    """(3, 2) Mean error of x, y and phi per metre driven and per radian turned."""
    coefficients: Floats
    """(3, 5) Variance of x, y and phi = coefficients · (1e-4, distance² [m²], turn² [rad²], speed² [m²/s²], rate² [rad²/s²])."""

    @classmethod
    def fit(cls, run: Run) -> Motion:
        """Fit to the steps of a located run: means by least squares, variances by weighted least squares.

        The largest 2 % are cut. The coefficients of speed and rate are variances of the time between scan and odometry.
        """
        drive, poses = Drive.of(run), pair(run).poses
        first = int(np.flatnonzero(np.isfinite(poses[:, 0]))[0])
        at = np.array([first + k for k in updates(drive.odometry[first:])])
        steps, rows = drive.steps(at)
        errors = compose(invert(steps), compose(invert(poses[at[:-1]]), poses[at[1:]]))
        known = np.isfinite(errors).all(axis=1)
        steps, errors, rows = steps[known], errors[known], rows[known]
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

    def moved(self, particles: Floats, drive: Drive, at: tuple[int, int], rng: np.random.Generator) -> Floats:
        """Return particles (n, 3) after the motion between two scans, given by index."""
        steps, rows = drive.steps(np.array(at))
        noise = rng.standard_t(FREEDOM, size=particles.shape) * np.sqrt((FREEDOM - 2) / FREEDOM)
        errors = self.systematic @ steps[0, [0, 2]] + noise * np.sqrt(self.coefficients @ rows[0])
        return np.asarray(compose(particles, compose(steps[0], errors)))
