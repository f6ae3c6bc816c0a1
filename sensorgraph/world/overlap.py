"""Decide whether scans contradict each other where they overlap: one saw through what the other measured.

A wrong pose puts surfaces into space that another scan has seen to be free. Right poses do not, however far apart the
scans were taken; a few people and doors do it for a few points. The limits are conventions, not fitted to data.
"""

from __future__ import annotations

import numpy as np

from logs.run import RangeSensor
from logs.transforms import compose, invert, wrap
from sensorgraph.types import Bools, Floats, Ints

PLACE = 0.3
"""[m] Distance in front of a measured surface that is not regarded as free."""
TURN = 0.02
"""[rad] Heading error of a pose; it adds to this distance in proportion to the range."""
REACH = 10.0
"""[m] Maximum range of points that are compared."""
RAYS = 2
"""Number of rays to each side that must also have seen through a point."""
MIN_POINTS = 20
"""Minimum number of common points of two scans that overlap."""
PAIRS = 3
"""Number of scans with which a scan is compared: the nearest that overlap."""
NEAREST = 12
"""Number of nearest scans that are tried."""
N_SCANS = 300
"""Number of scans that are compared, for all parts of a run together."""
GROUP = 10
"""Minimum number of scans of a part that is judged on its own; shorter parts are judged together."""
MAX_CONTRADICTION = 0.16
"""Share of points seen through above which poses are wrong; median over pairs of scans. Parts of four corrected public
logs have less than 0.15 (in a crowd 0.28), and most of them 0.25 to 0.9 after a shift of 1.2 to 3 m."""


def contradiction(ranges: Floats, poses: Floats, part: Ints, sensor: RangeSensor) -> float:
    """Return the largest share of points that scans of other parts have seen through, over the parts; nan without overlap.

    Parameters
    ----------
    ranges : (n, n_rays) [m]
    poses : (n, 3) [m, m, rad] of the laser in map.
    part : (n,) number of the part of the run, between two jumps. Scans are compared with those of other parts.
    sensor : One laser; its rays have one origin.
    """
    sizes = np.bincount(part)
    group = np.where(sizes[part] >= GROUP, part, -1)
    numbers = np.unique(group)
    each = max(N_SCANS // len(numbers), PAIRS)
    worst = [np.nan]
    for number in numbers:
        members = np.flatnonzero(group == number)
        some = members[np.linspace(0, len(members) - 1, min(each, len(members))).astype(np.intp)]
        shares = [share for i in some for share in _shares(i, ranges, poses, part, sensor)]
        worst.append(float(np.median(shares)) if shares else np.nan)
    return float(np.fmax.reduce(worst))


def _shares(i: int, ranges: Floats, poses: Floats, part: Ints, sensor: RangeSensor) -> list[float]:
    """Return the share of points seen through, for the nearest scans of other parts that overlap with scan i.

    It is the mean of the two directions: people in front of one scan are seen through by the other, not in turn.
    """
    others = np.flatnonzero(part != part[i])
    distance = np.hypot(*(poses[others, :2] - poses[i, :2]).T)
    shares = list[float]()
    for j in others[np.argsort(distance)[:NEAREST]]:
        there = _share(ranges[i], ranges[j], compose(invert(poses[j]), poses[i]), sensor)
        back = _share(ranges[j], ranges[i], compose(invert(poses[i]), poses[j]), sensor)
        if np.isfinite(there + back):
            shares.append((there + back) / 2)
        if len(shares) == PAIRS:
            break
    return shares


def _share(own: Floats, other: Floats, relative: Floats, sensor: RangeSensor) -> float:
    """Return the share of the common points of two scans that the other one saw through; nan if they do not overlap."""
    common, through = seen_by(own, other, relative, sensor)
    return float(through.sum() / common.sum()) if common.sum() >= MIN_POINTS else float("nan")


def seen_by(own: Floats, other: Floats, relative: Floats, sensor: RangeSensor) -> tuple[Bools, Bools]:
    """Return which rays (n_rays,) of a scan end where another scan could see, and which of them it saw through.

    Parameters
    ----------
    own, other : (n_rays,) [m]
    relative : (3,) [m, m, rad] pose of the laser in the frame of the other scan.
    """
    bearings = sensor.bearings
    with np.errstate(invalid="ignore"):
        is_near = np.isfinite(own) & (own > 0) & (own < REACH)
        free = np.where(other > 0, other, 0.0)  # nan, and -inf: closer than the minimum range
    r = np.where(is_near, own, 0.0)
    ends = np.stack([r * np.cos(bearings), r * np.sin(bearings), np.zeros_like(r)], axis=1)
    there = compose(np.broadcast_to(relative, ends.shape), ends)
    far, bearing = np.hypot(there[:, 0], there[:, 1]), np.arctan2(there[:, 1], there[:, 0])
    order = np.argsort(bearings)
    sorted_bearings, free = bearings[order], free[order]
    turned = sorted_bearings[0] + wrap(bearing - sorted_bearings[0]) % (2 * np.pi)
    at = np.searchsorted(sorted_bearings, turned)
    beside = [free[np.clip(at + k, 0, len(order) - 1)] for k in range(-RAYS, RAYS)]
    least = np.min(beside, axis=0)
    margin = PLACE + TURN * far
    is_inside = is_near & (at > 0) & (at < len(order)) & (far < REACH)
    return is_inside & (far < least + margin), is_inside & (far < least - margin)
