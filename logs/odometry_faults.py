"""Poses of odometry that no robot can have: single wrong ones, jumps, and poses that are only repeated.

Within a time T after a step of the duration tau, an acceleration a moves a robot by at most a T (T + tau) / 2 from where its
velocity leads, and by at most a T² / 8 from the chord of its way. Poses farther away, by more than noise, are wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.publishers import PUBLISHER_LIMITS, PublisherLimits
from logs.transforms import wrap
from logs.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True)
class FaultLimits:
    """Limits for the faults of odometry; conventions, not fitted to data."""

    length: int = 5
    """Maximum number of wrong poses in a row, as of a message that is damaged or a register that is read as 0."""
    significance: float = 10.0
    """Distance of a wrong pose, relative to the median distance of all poses, which is their noise."""
    share: float = 0.1
    """Maximum share of wrong poses; more are noise, or another publisher."""
    repeats: int = 2
    """Minimum median number of equal poses in a row of odometry that is published more often than it is measured ..."""
    values: int = 20
    """... of at least so many different ones."""
    longer: float = 1.5
    """Duration of equal poses, relative to the usual one, above which the robot stands."""


FAULT_LIMITS = FaultLimits()


def wrong_poses(
    stamps: Floats,
    poses: Floats,
    faults: FaultLimits = FAULT_LIMITS,
    robot: PublisherLimits = PUBLISHER_LIMITS,
) -> Bools:
    """Return which poses are wrong: a few in a row, while the poses before and after them continue each other.

    Parameters
    ----------
    stamps : (n,) [s] in order.
    poses : (n, 3) [m, m, rad]

    Returns
    -------
    (n,)
    """
    known: Bools = np.asarray(np.isfinite(poses).all(axis=1))
    wrong = ~known
    noise = 0.0
    for length in range(1, faults.length + 1):
        index = np.flatnonzero(~wrong)
        n = len(index) - length - 2
        if n < 1:
            break
        t, p = stamps[index], poses[index]
        first = np.arange(1, n + 1)  # the last pose before those that may be wrong
        whole, before = t[first + length + 1] - t[first], t[first] - t[first - 1]
        chord, step = _steps(p[first], p[first + length + 1]), _steps(p[first - 1], p[first])
        ahead = step * np.divide(whole, before, out=np.full(n, np.inf), where=before > 0)[:, None]
        with np.errstate(invalid="ignore"):
            most = robot.distance + robot.acceleration * whole * (whole + before) / 2
            continues = _length(chord - ahead, robot) <= most
        off = np.full(n, np.inf)
        for k in range(1, length + 1):
            share = np.divide(t[first + k] - t[first], whole, out=np.zeros(n), where=whole > 0)
            off = np.minimum(off, _length(_steps(p[first], p[first + k]) - share[:, None] * chord, robot))
        noise = noise or float(np.median(off))
        away = off > np.maximum(
            robot.distance + robot.acceleration * whole**2 / 8, faults.significance * noise
        )
        for k in range(1, length + 1):
            wrong[index[first[continues & away] + k]] = True
    wrong = wrong & known
    return wrong if wrong.sum() <= faults.share * known.sum() else np.zeros_like(wrong)


def jumps(
    stamps: Floats,
    poses: Floats,
    faults: FaultLimits = FAULT_LIMITS,
    robot: PublisherLimits = PUBLISHER_LIMITS,
) -> Ints:
    """Return the indices (m,) of the poses before jumps, which neither the velocity before nor the one after explains.

    Parameters
    ----------
    stamps, poses : (n,) [s] in order, (n, 3) [m, m, rad]
    """
    steps, took = _steps(poses[:-1], poses[1:]), np.diff(stamps)
    if len(steps) < 3:
        return np.zeros(0, dtype=np.intp)
    velocities = np.divide(steps, took[:, None], out=np.full_like(steps, np.inf), where=took[:, None] > 0)
    excess, most = np.full((2, len(steps) - 2), np.inf), np.zeros((2, len(steps) - 2))
    step, dt = steps[1:-1], took[1:-1]
    with np.errstate(invalid="ignore"):
        for side, near in enumerate((slice(None, -2), slice(2, None))):
            excess[side] = _length(step - velocities[near] * dt[:, None], robot)
            most[side] = robot.distance + robot.acceleration * dt * (dt + took[near]) / 2
        excess = np.nan_to_num(excess, nan=0.0)
        noise = float(np.median(excess.min(axis=0)))
        is_jump = (excess > np.maximum(most, faults.significance * noise)).all(axis=0)
    found = np.flatnonzero(is_jump) + 1
    return found if len(found) <= faults.share * len(steps) else np.zeros(0, dtype=np.intp)


def measured_poses(stamps: Floats, poses: Floats, faults: FaultLimits = FAULT_LIMITS) -> Ints | None:
    """Return the indices of the poses that were measured, of odometry that repeats each; None if most differ from the last.

    The first of equal poses is the measured one. Where they last longer than usual, the robot stands until the usual time
    before the next pose.

    Parameters
    ----------
    stamps, poses : (n,) [s] in order, (n, 3) [m, m, rad]
    """
    first = np.flatnonzero(np.append(True, (poses[1:] != poses[:-1]).any(axis=1)))
    if len(first) < faults.values or np.median(np.diff(first)) < faults.repeats:
        return None
    usual = float(np.median(np.diff(stamps[first])))
    stands = np.diff(stamps[first], append=stamps[-1]) > faults.longer * usual
    ends = np.append(stamps[first[1:]] - usual, stamps[-1])
    until = np.searchsorted(stamps, ends[stands], side="right") - 1
    return np.unique(np.concatenate([first, until]))


def _steps(first: Floats, second: Floats) -> Floats:
    """Return the steps (n, 3) between poses, in the frame of the odometry."""
    steps = second - first
    steps[:, 2] = wrap(steps[:, 2])
    return steps


def _length(steps: Floats, robot: PublisherLimits) -> Floats:
    """Return the lengths (n,) [m] of steps (n, 3), with turns as distances."""
    return np.asarray(np.sqrt(np.square(steps * [1.0, 1.0, robot.lever]).sum(axis=1)))
