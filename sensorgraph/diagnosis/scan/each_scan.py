"""Normal equations of each scan for its pose error, and their likelihood under a prior with the error integrated out.

log p_i(prior) = right_i' (block_i + prior⁻¹)⁻¹ right_i / 2 - log |I + prior block_i| / 2
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class EachScan:
    """Normal equations of each scan for its pose error; everything else is as fitted."""

    block: Floats
    """(n_scans, 3, 3)"""
    right: Floats
    """(n_scans, 3)"""
    prior: Floats
    """(n_scans, 3, 3) Covariance of the pose error."""

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
    return EachScan(
        block=np.matmul(posed, solver.jacobian.pose.transpose(0, 2, 1)),
        right=np.matmul(posed, left[:, :, None])[..., 0],
        prior=prior,
    )
