"""Normal equations of each scan for its pose error, a delay and a range offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class OneColumn:
    """Normal equations of each scan for one parameter, with its pose error integrated out."""

    score: Floats
    """(n_scans,) [1/unit]"""
    information: Floats
    """(n_scans,) [1/unit²]"""

    def log_p(self, value: float) -> Floats:
        """Return the log-likelihood ratio (n_scans,) [nats] of a value to 0."""
        return self.score * value - 0.5 * self.information * value**2

    def log_p_of_spread(self, sd: float) -> Floats:
        """Return the log-likelihood ratio (n_scans,) [nats] of random values with standard deviation sd to 0."""
        return 0.5 * self.score**2 / (self.information + 1 / sd**2) - 0.5 * np.log1p(sd**2 * self.information)


@dataclass(frozen=True, kw_only=True, eq=False)
class EachScan:
    """Normal equations of each scan for its pose error, a delay and an offset; everything else is as fitted."""

    block: Floats
    """(n_scans, 3, 3)"""
    right: Floats
    """(n_scans, 3)"""
    prior: Floats
    """(n_scans, 3, 3) Covariance of the pose error."""
    delay: OneColumn
    """[s]"""
    offset: OneColumn
    """[m] With a much wider prior of the pose error, so that no wrong pose counts as an offset."""

    def poses(self, prior: Floats) -> Floats:
        """Return the most likely pose errors (n_scans, 3) under a prior."""
        return np.asarray(np.linalg.solve(self.block + np.linalg.inv(prior), self.right[..., None])[..., 0])

    def log_p_of_prior(self, prior: Floats) -> Floats:
        """Return the log-likelihood (n_scans,) [nats] of each scan under a prior of its pose error, up to a constant."""
        _, volume = np.linalg.slogdet(np.eye(3) + np.matmul(prior, self.block))
        return np.asarray(0.5 * (self.right * self.poses(prior)).sum(axis=1) - 0.5 * volume)


def each_scan(fitted: Fitted) -> EachScan:
    """Assemble the normal equations of each scan separately."""
    solver, solution = fitted.solver, fitted.solution
    weight = np.where(solver.jacobian.valid, solution.responsibilities.weight, 0.0)
    state = solution.state.copy()
    state.delta[:] = 0.0
    left = solver.y - solver.shift(state, solution.p)
    prior, posed = pose_prior(solver.data, state.pose_scale), solver.jacobian.pose * weight[:, None, :]
    block = np.matmul(posed, solver.jacobian.pose.transpose(0, 2, 1))
    by_left = np.matmul(posed, left[:, :, None])[..., 0]

    def of(column: Floats, widened: float) -> OneColumn:
        inner = np.linalg.inv(block + np.linalg.inv(widened**2 * prior))
        by_column = np.matmul(posed, column[:, :, None])[..., 0]
        given = np.matmul(inner, by_column[..., None])[..., 0]
        return OneColumn(
            score=(column * weight * left).sum(axis=1) - (given * by_left).sum(axis=1),
            information=(column**2 * weight).sum(axis=1) - (given * by_column).sum(axis=1),
        )

    return EachScan(
        block=block,
        right=by_left,
        prior=prior,
        delay=of(solver.stack[:, Nuisance.DELAY], 1.0),
        offset=of(solver.stack[:, Nuisance.BIAS], SCAN.odd_scans.wider[0]),
    )
