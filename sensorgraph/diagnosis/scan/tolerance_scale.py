"""By how much one part of the reference's error exceeds what robot.yaml states: the jitter of stamps, or the heading.

The scale of the reference's error that a fit has is one for all of it. Where the poses are better than stated and the stamps
are worse, it sees neither: what jitter of a stamp does grows with speed, what a pose is off does not. So with a heading that is
worse than stated beside places that are not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.odd_scans import each_scan
from sensorgraph.diagnosis.scan.settings import SCAN

REST_SCALES = np.geomspace(0.25, 4.0, 7)
"""Multiples of the stated rest of a pose's error that are tried, beside each multiple of the part."""
PART_SCALES = np.geomspace(0.25, 8.0, 16)
MOST = 3.0
"""[nats] that one scan may say for one pair of scales against another: a few scans that are elsewhere are no jitter."""


def tolerance_scale(fitted: Fitted, name: Literal["stamp", "pose_yaw"]) -> float:
    """Return how many times worse than stated one part of the poses is, at least 1; 1 also where the run does not tell.

    The likeliest pair of scales of the part and of the rest, the pose error of each scan integrated out, if it is likelier than
    the fit's one scale of both by what a number takes.

    Parameters
    ----------
    name : of the tolerance: of the scans' stamps, or of the reference's heading
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
