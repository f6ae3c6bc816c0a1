"""Estimate the ratio of one part of the reference error to its tolerance: the jitter of stamps, or the heading.

    gain(of_rest, of_part) = Σ_i clip(log p_i(of_rest² rest + of_part² part) - log p_i(common² (rest + part)), ±MOST)

Here `rest` and `part` are the prior covariances of the pose error of scan i: of everything else, and of this
part. The log-likelihood log p_i has the pose error integrated out (`each_scan`), and `common` is the pose scale
of the fit.

A fit has one scale for the whole reference error. If poses are better than specified and stamps are worse,
that scale shows neither: the error from stamp jitter grows with speed, and the pose error does not. The same
applies to a heading that is worse than specified while the position is not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from sensorgraph.diagnosis.scan.each_scan import each_scan
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.settings import SCAN

REST_SCALES = np.geomspace(0.25, 4.0, 7)
"""Multiples of the rest of the pose error that are tried, for each multiple of the part."""
PART_SCALES = np.geomspace(0.25, 8.0, 16)
MOST = 3.0
"""[nats] Maximum contribution of one scan to a comparison of scales, because a few scans at wrong poses are
not jitter."""


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
