"""Evidence for an effect of the sensor, at a site that is known by its good runs: only where the parts of the way agree.

The clutter of a site is local: a wall that the map lacks, a cabinet that has moved, a door. Where the robot stands, it is
seen in scan after scan at the same bearing and range, as a part of the robot would be; along a corridor a wall that is a
little off looks like the floor that a tilted laser sees, until a niche contradicts it. What the sensor itself does shows
all along the way. So the run is cut into parts in which the ends of beams move equally far, and a sign test asks whether
the parts agree: it does not mind that one place, where the map is quite wrong, says more than all others together. Numbers
of the whole sensor have a sharper test, their size in good runs and a jackknife (`site_variation`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Floats, Ints


def evidence(data: ScanData, amendment: Amendment, better: Fitted, plain: Fitted) -> float:
    """Return the evidence of a fit over one without the effect [nats]; at a site known by good runs, `spread_evidence`."""
    if data.clutter_nats and must_be_spread(amendment):
        return spread_evidence(data, better, plain)
    return better.j - plain.j


def must_be_spread(amendment: Amendment) -> bool:
    """Tell whether an effect of the sensor has no sharper test than that all parts of the way show it.

    A warm-up has none: it begins where the robot begins, and another place may read a little more.
    """
    effect = amendment.effect
    has_more = any(v != 0.0 and effect.parameter(k).absent_at_zero for k, v in amendment.parameters.items())
    return is_of_sensor(amendment) and (has_more or not effect.nuisances)


def is_of_sensor(amendment: Amendment) -> bool:
    """Tell whether an effect goes with the sensor, or with some of its bearings, and sits at no place of the site."""
    return amendment.effect.place in (None, "sector")


def spread_evidence(data: ScanData, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats]; none where the parts of the way do not agree that there is any."""
    n, gained = SCAN.site.n_parts, _by_scan(data, better) - _by_scan(data, plain)
    by_part = np.bincount(parts_of_way(data), gained, minlength=n)
    chance = float(
        bdtrc(int((by_part > 0).sum()) - 1, n, 0.5)
    )  # of so many parts or more, if each says either
    return better.j - plain.j if chance < SCAN.site.disagreement else min(better.j - plain.j, 0.0)


def _by_scan(data: ScanData, fitted: Fitted) -> Floats:
    """Return the log-likelihood of each scan's readings and of its pose (n_scans,) [nats]."""
    delta = fitted.state.delta
    precision = np.linalg.inv(pose_prior(data, fitted.state.pose_scale))
    of_pose = 0.5 * np.einsum("ni,nij,nj->n", delta, precision, delta)
    return np.asarray(fitted.solution.responsibilities.log_p.sum(axis=1) - of_pose)


def parts_of_way(data: ScanData) -> Ints:
    """Number the parts (n_scans,) in which the ends of all judged beams together move equally far, at a median range."""
    returned = data.ranges[data.returned]
    reach = float(np.median(returned)) if len(returned) else 1.0
    step = np.diff(data.poses, axis=0)
    judged = np.isfinite(data.ranges).sum(axis=1)[1:]
    moved = judged * (np.hypot(step[:, 0], step[:, 1]) + reach * np.abs(step[:, 2]))
    way = np.concatenate([[0.0], np.cumsum(moved)])
    share = way / way[-1] if way[-1] > 0 else np.zeros(len(way))
    return np.minimum((share * SCAN.site.n_parts).astype(np.intp), SCAN.site.n_parts - 1)
