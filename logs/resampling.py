"""Resample scans with varying bearings to the bearings of one sensor.

Between two returns a and b of one surface, 1 / r = (1 - share) / a + share / b. Along a straight wall, the inverse
range is a sine of the bearing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.transforms import wrap
from logs.types import Floats

STEEPEST = float(np.tan(np.radians(80.0)))
"""Tangent of the maximum incidence at which two neighbouring returns count as one surface; beyond it is an edge."""
SAME_BEARING = 1e-3
"""Share of an increment within which two bearings count as equal, and the reading is kept unchanged."""


def resample(ranges: Floats, bearings: Floats, wanted: Floats) -> Floats:
    """Interpolate scans to other bearings.

    Between two returns of one surface, the inverse range is interpolated linearly. At an edge and next to a missing
    return, the nearest ray is used. A bearing more than half an increment outside the scan is nan.

    Parameters
    ----------
    ranges : (n_scans, n) [m], missing returns as in REP-117
    bearings : (n,) [rad] of these ranges, strictly increasing or decreasing
    wanted : (m,) [rad] bearings of the result

    Returns
    -------
    (n_scans, m) [m]
    """
    if len(bearings) == 0:
        return np.full((len(ranges), len(wanted)), np.nan)
    if len(bearings) == 1:
        near = np.abs(wrap(wanted - bearings[0])) < SAME_BEARING
        return np.where(near, ranges[:, :1], np.nan)
    if bearings[-1] < bearings[0]:
        bearings, ranges = bearings[::-1], ranges[:, ::-1]
    step = float(bearings[-1] - bearings[0]) / (len(bearings) - 1)
    if bearings[-1] - bearings[0] + 1.5 * step > 2 * np.pi:  # a full turn: the last ray is next to the first
        n = max(int(np.searchsorted(bearings, bearings[0] + 2 * np.pi - step / 2)), 1)
        bearings, ranges = bearings[:n], ranges[:, :n]
        bearings = np.concatenate([[bearings[-1] - 2 * np.pi], bearings, [bearings[0] + 2 * np.pi]])
        ranges = np.concatenate([ranges[:, -1:], ranges, ranges[:, :1]], axis=1)
    middle = (bearings[0] + bearings[-1]) / 2
    at = middle + wrap(wanted - middle)
    right = np.clip(np.searchsorted(bearings, at), 1, len(bearings) - 1)
    left = right - 1
    width = bearings[right] - bearings[left]
    share = (at - bearings[left]) / width
    a, b = ranges[:, left], ranges[:, right]  # (n_scans, m)
    between = (share > SAME_BEARING) & (share < 1 - SAME_BEARING)
    with np.errstate(invalid="ignore", divide="ignore"):
        one_surface = np.abs(a - b) <= STEEPEST * width * np.minimum(a, b)
        smooth = between & np.isfinite(a) & np.isfinite(b) & one_surface
        along = 1.0 / ((1 - share) / a + share / b)
    out = np.where(smooth, along, np.where(share <= 0.5, a, b))
    outside = (at < bearings[0] - step / 2) | (at > bearings[-1] + step / 2)
    return np.asarray(np.where(outside, np.nan, out))


def take_nearest(values: Floats, bearings: Floats, wanted: Floats) -> Floats:
    """Return the value of the nearest ray for each wanted bearing; nan more than half an increment outside the scan.

    Parameters
    ----------
    values : (n_scans, n) one value for each ray
    bearings, wanted : (n,) and (m,) [rad]

    Returns
    -------
    (n_scans, m)
    """
    if len(bearings) == 0:
        return np.full((len(values), len(wanted)), np.nan)
    away = np.abs(wrap(wanted[:, None] - bearings))  # (m, n)
    step = abs(float(bearings[-1] - bearings[0])) / max(len(bearings) - 1, 1)
    return np.where(
        away.min(axis=1) <= (0.5 + SAME_BEARING) * step + 1e-9, values[:, away.argmin(axis=1)], np.nan
    )


def resampled_text(n_rays: Sequence[int], n_scans: Sequence[int]) -> str:
    """Return the note that scans of several geometries were resampled to the most common one.

    Parameters
    ----------
    n_rays, n_scans : number of rays and number of scans of each geometry
    """
    most, total = max(n_scans), sum(n_scans)
    own = n_rays[n_scans.index(most)]
    span = (
        f"{min(n_rays)} to {max(n_rays)} rays"
        if min(n_rays) < max(n_rays)
        else f"{own} rays at several bearings"
    )
    return f"scans have {span}: {total - most} of {total} were resampled to the bearings of most scans ({own} rays), none was dropped"
