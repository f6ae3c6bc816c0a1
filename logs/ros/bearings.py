"""The bearings of a scan from the angles that its driver states, which may contradict each other.

A LaserScan states the first bearing, the last one and the step between rays; the number of rays is that of its ranges. A
driver that changes the number and forgets the step, or takes every second ray and keeps it, states two different steps.
The surfaces decide: they are straight with the true step, and bent with another one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.errors import LogError
from logs.sweep import differs
from logs.types import Floats

MAX_TURNS = 2
"""Turns of a laser that one scan holds at most."""
MIN_DISAGREEMENT = 0.05
"""Smallest share by which two steps differ that is reported; less bends no surface visibly."""
MIN_STRAIGHTER = 0.7
"""Share of the bend that the step of `angle_max` leaves at most, where it replaces the stated one."""
MAX_SCANS = 50
"""Number of scans whose surfaces are compared, and one more of each part of the log at most."""
MISSING_RAYS = 0.1
"""Share of the rays stated by the angles that lacks in a scan whose readings were filtered, at least; a laser whose speed varies
has a few per cent more or fewer."""
WINDOW = 12
"""The bend is that of arcs of a twelfth of the rays, which is wide enough to exceed noise."""


def stated_bearings(n_rays: int, angle_min: float, increment: float) -> Floats:
    """Return the bearings (n_rays,) [rad]; those of a driver that states degrees are converted."""
    stated = angle_min + increment * np.arange(n_rays, dtype=np.float64)
    return np.radians(stated) if are_degrees(n_rays, increment) else stated


def are_degrees(n_rays: int, increment: float) -> bool:
    """Return whether rays would go around more than MAX_TURNS times if their increment were in radians."""
    return (n_rays - 1) * abs(increment) > 2 * np.pi * MAX_TURNS


def are_contradictory(n_rays: int, angle_min: float, angle_max: float, increment: float) -> bool:
    """Return whether the step between rays differs from that between the first and the last bearing."""
    if n_rays < 3 or increment == 0 or not np.isfinite(angle_max):
        return False
    by_ends = (angle_max - angle_min) / (n_rays - 1)
    few = 2 / (n_rays - 1)  # an end that is one step off is common, and the step is right
    return by_ends != 0 and abs(by_ends / increment - 1) > max(MIN_DISAGREEMENT, few)


def check_filtered(name: str, kinds: Sequence[tuple[int, int, Floats]]) -> None:
    """Refuse scans from which a filter has removed readings, another number each time: the bearings of the others are not known.

    Parameters
    ----------
    kinds : Number of scans, their number of readings, and their limits: angle_min, angle_max, angle_increment, ... as stated.

    Raises
    ------
    LogError : Most scans have at least `MISSING_RAYS` fewer readings than their angles state, and of several numbers.
    """
    counts, lengths, limits = map(np.array, zip(*kinds, strict=True))
    with np.errstate(all="ignore"):
        stated = np.abs((limits[:, 1] - limits[:, 0]) / limits[:, 2]) + 1.0
    is_short = lengths < (1.0 - MISSING_RAYS) * stated
    if len(np.unique(lengths[is_short])) < 3 or 2 * counts[is_short].sum() <= counts.sum():
        return
    raise LogError(
        f"{name}: scans hold {lengths[is_short].min()} to {lengths[is_short].max()} readings, but their angles state "
        f"{np.median(stated[is_short]):.0f} rays: a filter has removed readings, and the bearings of the others are not known; "
        "log the scans before this filter, or let it set readings to nan or inf"
    )


def bearings_of(limits: Floats, ranges: Sequence[Floats]) -> tuple[Floats, list[str]]:
    """Return the bearings (n_rays,) [rad] of scans, and notes.

    Parameters
    ----------
    limits : angle_min, angle_max, angle_increment, ... as stated
    ranges : (n_scans, n_rays) [m] each, parts of the log; few of their scans are compared

    Raises
    ------
    LogError : The angles are not finite, or all rays would have one bearing.
    """
    angle_min, angle_max, increment = limits[:3].tolist()
    n = ranges[0].shape[1]
    by_ends = (angle_max - angle_min) / (n - 1) if n > 1 else 0.0
    if increment == 0 or not np.isfinite(increment):
        increment = by_ends
    if not np.isfinite(angle_min) or (n > 1 and not 1e-9 < abs(increment) < np.inf):
        raise LogError(
            f"scans have {n} rays, angle_min {angle_min:g} and angle_increment {increment:g}; expected a finite first "
            "bearing, and an increment other than 0"
        )
    stated = stated_bearings(n, angle_min, increment)
    if not are_contradictory(n, angle_min, angle_max, increment):
        return stated, []
    said = f"angle_increment {increment:.6g} with {n} rays ends at {stated[-1]:.4g} rad, but angle_max is {angle_max:.4g}"
    other = stated_bearings(n, angle_min, by_ends)
    every = 1 + sum(map(len, ranges)) // MAX_SCANS
    some = np.concatenate([part[::every] for part in ranges])
    if bend(some, other) < MIN_STRAIGHTER * bend(some, stated):
        return other, [
            f"{said}: surfaces are straight with the step {by_ends:.6g} between both ends: it was used"
        ]
    return stated, [f"{said}: the increment was used; if walls are bent, correct it in the driver"]


def bend(ranges: Floats, bearings: Floats) -> float:
    """Return how bent the surfaces of scans are: the sagitta of an arc of rays by its chord, its lower quartile.

    Most arcs of a room without a corner in them are straight, so that their quartile is noise. inf: there are none.
    """
    half = max(1, len(bearings) // (2 * WINDOW))
    with np.errstate(all="ignore"):  # no return: not finite
        points = ranges * np.exp(1j * bearings)
        first, middle, last = points[:, : -2 * half], points[:, half:-half], points[:, 2 * half :]
        sagitta = np.abs(((middle - first) / (last - first)).imag)
    sagitta = sagitta[np.isfinite(sagitta)]
    return float(np.quantile(sagitta, 0.25)) if len(sagitta) else np.inf


def seconds_to_first_ray(
    stated: Floats, stated_increment: float, bearings: Floats, increment: float
) -> float:
    """Return the time [s] from the first ray of a scan to the first of other bearings, to which it is resampled.

    The stamp of a scan is the time of its first ray. The result is 0 if one stamp does not suffice: if the two do not rotate
    alike, or if the rays of neither lie between those of the other.

    Parameters
    ----------
    stated, stated_increment : (n,) [rad] bearings of the scan, and the time [s] between its rays
    bearings, increment : (m,) [rad] bearings to which it is resampled, and the time [s] between them
    """
    if len(stated) < 2 or len(bearings) < 2 or not (np.isfinite(increment) and np.isfinite(stated_increment)):
        return 0.0
    steps = (stated[-1] - stated[0]) / (len(stated) - 1), (bearings[-1] - bearings[0]) / (len(bearings) - 1)
    per_angle = stated_increment / steps[0], increment / steps[1]  # [s/rad]
    if per_angle[0] == 0 or differs(*per_angle):
        return 0.0
    slack = max(map(abs, steps))
    one, other = (np.sort(ends[[0, -1]]) for ends in (stated, bearings))
    is_inside = any(a[0] >= b[0] - slack and a[1] <= b[1] + slack for a, b in ((one, other), (other, one)))
    return float(per_angle[0] * (bearings[0] - stated[0])) if is_inside else 0.0
