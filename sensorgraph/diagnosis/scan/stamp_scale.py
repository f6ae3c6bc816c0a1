"""By how much the stamps of scans jitter, as a multiple of what robot.yaml states.

The scale of the reference's error that a fit has is one for all of it. Where the poses are better than stated and the stamps
are worse, it sees neither: what jitter of a stamp does grows with speed, what a pose is off does not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.odd_scans import each_scan
from sensorgraph.diagnosis.scan.settings import SCAN

POSE_SCALES = np.geomspace(0.25, 4.0, 7)
"""Multiples of the stated error of a pose that are tried, beside each multiple of the stamp's."""
STAMP_SCALES = np.geomspace(0.25, 8.0, 16)
MOST = 3.0
"""[nats] that one scan may say for one pair of scales against another: a few scans that are elsewhere are no jitter."""


def stamp_scale(fitted: Fitted) -> float:
    """Return how many times worse than stated the stamps of the scans are, at least 1; 1 also where the run does not tell.

    The likeliest pair of scales of poses and stamps, the pose error of each scan integrated out, if it is likelier than the
    fit's one scale of both by what a number takes.
    """
    each, data, common = each_scan(fitted), fitted.solver.data, fitted.state.pose_scale
    still = pose_prior(replace(data, tolerances=replace(data.tolerances, stamp=0.0), memo={}), 1.0)
    jitter = pose_prior(data, 1.0) - still
    told = each.log_p_of_prior(common**2 * (still + jitter))

    def gain(pose: float, stamp: float) -> float:
        better = each.log_p_of_prior(pose**2 * still + stamp**2 * jitter) - told
        return float(np.clip(better, -MOST, MOST).sum())

    gains = np.array([[gain(pose, stamp) for stamp in STAMP_SCALES] for pose in POSE_SCALES])
    found = float(STAMP_SCALES[gains.max(axis=0).argmax()])
    held = max(gain(pose, min(common, found)) for pose in POSE_SCALES)
    is_sure = gains.max() - max(held, 0.0) > SCAN.selection.threshold + SCAN.selection.price
    return max(found, 1.0) if is_sure else 1.0
