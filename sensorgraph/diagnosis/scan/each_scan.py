"""Normal equations of each scan for its pose error, and their likelihood under a prior with the error integrated out.

log p_i(prior) = right_i' (block_i + prior⁻¹)⁻¹ right_i / 2 - log |I + prior block_i| / 2

`tolerance_scale` is the ratio of one part of the reference error to its tolerance: the jitter of stamps, or the heading.

    gain(of_rest, of_part) = Σ_i clip(log p_i(of_rest² rest + of_part² part) - log p_i(common² (rest + part)), ±MOST)

Here `rest` and `part` are the prior covariances of the pose error of scan i: of everything else, and of this
part. The log-likelihood log p_i has the pose error integrated out (`each_scan`), and `common` is the pose scale
of the fit.

A fit has one scale for the whole reference error. If poses are better than specified and stamps are worse,
that scale shows neither: the error from stamp jitter grows with speed, and the pose error does not. The same
applies to a heading that is worse than specified while the position is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Floats

REST_SCALES = np.geomspace(0.25, 4.0, 7)
"""Multiples of the rest of the pose error that are tried, for each multiple of the part."""
PART_SCALES = np.geomspace(0.25, 8.0, 16)
MOST = 3.0
"""[nats] Maximum contribution of one scan to a comparison of scales, because a few scans at wrong poses are
not jitter."""


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


def tolerance_scale(fitted: Fitted, name: Literal["stamp", "pose_yaw"]) -> float:
    """Return the ratio of one part of the pose error to its tolerance, at least 1; also 1 if it is undetermined.

    The result is the scale of the part in the most likely pair of scales of part and rest. The pair must be
    more likely than the common scale of the fit by the evidence that one parameter requires.

    Parameters
    ----------
    name : Tolerance of the part: stamps of the scans, or heading of the reference.
    """
    each, data, common = each_scan(fitted), fitted.solver.data, fitted.state.pose_scale
    without = replace(data.tolerances, **{name: 0.0})
    rest = pose_prior(replace(data, tolerances=without, memo={}), 1.0)
    part = pose_prior(data, 1.0) - rest
    told = each.log_p_of_prior(common**2 * (rest + part))

    def gain(of_rest: float, of_part: float) -> float:
        better = each.log_p_of_prior(of_rest**2 * rest + of_part**2 * part) - told
        return float(np.clip(better, -MOST, MOST).sum())

    gains = np.array([[gain(a, b) for b in PART_SCALES] for a in REST_SCALES])
    found = float(PART_SCALES[gains.max(axis=0).argmax()])
    held = max(gain(a, min(common, found)) for a in REST_SCALES)
    is_sure = gains.max() - max(held, 0.0) > SCAN.selection.threshold + SCAN.selection.price
    return max(found, 1.0) if is_sure else 1.0
