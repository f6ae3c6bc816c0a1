"""Poses of odometry that no robot can have: single wrong ones, jumps, and poses that are only repeated.

A step takes the time tau, and T passes after it. An acceleration a moves the robot by at most a T (T + tau) / 2 from where the
velocity of the step leads. From the chord of its way, it is at most a T² / 8 off. Poses farther away, by more than noise, are
wrong. Stamps scatter, so that only the direction of a velocity counts, and its size within a factor.
"""

from __future__ import annotations

import numpy as np

from logs.jumps import JUMP_LIMITS
from logs.publishers import PUBLISHER_LIMITS as ROBOT
from logs.transforms import difference
from logs.types import Bools, Floats, Ints

# conventions, not fitted to data
MAX_LENGTH = 5
"""Maximum number of wrong poses in a row, as of a message that is damaged or a register that is read as 0."""
SIGNIFICANCE = 10.0
"""Distance of a wrong pose, relative to the median distance of all poses, which is their noise."""
TIMING = 3.0
"""Duration of a step, relative to that by its stamps, at most: stamps scatter where messages arrive late."""
MAX_SHARE = 0.1
"""Maximum share of wrong poses; more are noise, or another publisher."""
MIN_REPEATS = 2
"""Minimum median number of equal poses in a row of odometry that is published more often than it is measured ..."""
MIN_VALUES = 20
"""... of at least so many different ones."""
MAX_LONGER = 1.5
"""Duration of equal poses, relative to the usual one, above which the robot stands."""


def wrong_poses(
    stamps: Floats,
    poses: Floats,
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
    noise, usual = 0.0, _usual(stamps)
    for length in range(1, MAX_LENGTH + 1):
        index = np.flatnonzero(~wrong)
        n = len(index) - length - 2
        if n < 1:
            break
        t, p = stamps[index], poses[index]
        first = np.arange(1, n + 1)  # the last pose before those that may be wrong
        whole = np.maximum(t[first + length + 1] - t[first], (length + 1) * usual)
        before = np.maximum(t[first] - t[first - 1], usual)
        chord, step = (_steps(p[a], p[b]) for a, b in ((first, first + length + 1), (first - 1, first)))
        most = ROBOT.distance + ROBOT.acceleration * whole * (whole + before) / 2
        continues = _off(chord, step, np.full(n, TIMING * (length + 1))) <= most
        off = np.min(
            [_off(_steps(p[first], p[first + k]), chord, np.ones(n)) for k in range(1, length + 1)],
            axis=0,
        )
        noise = noise or float(np.median(off))
        most = ROBOT.distance + ROBOT.acceleration * whole**2 / 8
        found = first[continues & (off > np.maximum(most, SIGNIFICANCE * noise))]
        wrong[index[found[:, None] + np.arange(1, length + 1)]] = True
    wrong = wrong & known
    are_single = wrong.sum() <= MAX_SHARE * known.sum() and not _are_crowded(wrong)
    return wrong if are_single else np.zeros_like(wrong)


def _are_crowded(wrong: Bools) -> bool:
    """Return whether somewhere fewer right poses lie between two groups of wrong ones than there are in the smaller group."""
    sizes = np.diff(np.flatnonzero(np.diff(wrong, prepend=not wrong[0], append=not wrong[-1])))
    groups, right = sizes[int(not wrong[0]) :: 2], sizes[int(wrong[0]) :: 2]
    inner = right[int(not wrong[0]) :][: len(groups) - 1]
    return bool((inner < np.minimum(groups[:-1], groups[1:])).any())


def jumps(
    stamps: Floats,
    poses: Floats,
) -> Ints:
    """Return the indices (m,) of the poses before jumps, which neither the velocity before nor the one after explains.

    Equal poses are one, since a driver that hangs for a moment goes on from where the robot is.

    Parameters
    ----------
    stamps, poses : (n,) [s] in order, (n, 3) [m, m, rad]
    """
    index = _changes(poses)
    stamps, poses = stamps[index], poses[index]
    steps, took = _steps(poses[:-1], poses[1:]), np.maximum(np.diff(stamps), _usual(stamps))
    if len(steps) < 3:
        return np.zeros(0, dtype=np.intp)
    step, dt = steps[1:-1], took[1:-1]
    excess, most = np.zeros((2, len(dt))), np.zeros((2, len(dt)))
    for side, near in enumerate((slice(None, -2), slice(2, None))):
        longer = np.divide(dt, took[near], out=np.ones(len(dt)), where=took[near] > 0)
        excess[side] = _off(step, steps[near], TIMING * np.maximum(longer, 1.0))
        most[side] = ROBOT.distance + ROBOT.acceleration * TIMING * dt * (TIMING * dt + took[near]) / 2
    excess[~np.isfinite(excess)] = 0.0
    noise = float(np.median(excess.min(axis=0)))
    is_jump = (excess > np.maximum(most, max(JUMP_LIMITS.noise, SIGNIFICANCE * noise))).all(axis=0)
    found = index[np.flatnonzero(is_jump) + 2] - 1
    return found if len(found) <= MAX_SHARE * len(steps) else np.zeros(0, dtype=np.intp)


def hung_poses(
    stamps: Floats,
    poses: Floats,
) -> Bools:
    """Return which poses only repeat the one before while the robot moves on, of a driver that hangs and then catches up.

    The step that ends such poses is a jump, unless it began with them, at the speed before or after.

    Parameters
    ----------
    stamps, poses : (n,) [s] in order, (n, 3) [m, m, rad]

    Returns
    -------
    (n,)
    """
    hung = np.zeros(len(poses), dtype=np.bool_)
    first, usual = _changes(poses), _usual(stamps)
    if len(first) < 4:
        return hung
    steps = _steps(poses[first[:-1]], poses[first[1:]])
    dt = np.maximum(stamps[first[1:]] - stamps[first[1:] - 1], usual)
    before, own, after = slice(None, -2), slice(1, -1), slice(2, None)
    excess = _off(steps[own], steps[after], TIMING * np.maximum(dt[own] / np.maximum(dt[after], 1e-9), 1.0))
    most = ROBOT.distance + ROBOT.acceleration * TIMING * dt[own] * (TIMING * dt[own] + dt[after]) / 2
    spans, ways = np.maximum(np.diff(stamps[first]), usual), np.linalg.norm(steps, axis=1)
    speeds = np.divide(ways, spans, out=np.zeros(len(ways)), where=spans > 0)
    reach = TIMING * spans[own] * np.maximum(speeds[before], speeds[after])
    is_hung = (excess > np.maximum(most, JUMP_LIMITS.noise)) & (ways[own] <= reach)
    for k in np.flatnonzero(is_hung) + 1:
        hung[first[k] + 1 : first[k + 1]] = True
    return hung


def measured_poses(stamps: Floats, poses: Floats) -> Ints | None:
    """Return the indices of the poses that were measured, of odometry that repeats each; None if most differ from the last.

    The first of equal poses is the measured one. Where they last longer than usual, the robot stands until the usual time
    before the next pose.

    Parameters
    ----------
    stamps, poses : (n,) [s] in order, (n, 3) [m, m, rad]
    """
    first = _changes(poses)
    if len(first) < MIN_VALUES or np.median(np.diff(first)) < MIN_REPEATS:
        return None
    usual = float(np.median(np.diff(stamps[first])))
    ends = np.append(stamps[first[1:]] - usual, stamps[-1])
    stands = np.diff(stamps[first], append=stamps[-1]) > MAX_LONGER * usual
    until = np.where(stands, np.searchsorted(stamps, ends, side="right") - 1, first)
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(stamps)))
    return np.flatnonzero(np.arange(len(stamps)) <= until[number])


def _changes(poses: Floats) -> Ints:
    """Return the indices (m,) of the poses (n, 3) that differ from the one before, and of the first."""
    return np.flatnonzero(np.append(True, (poses[1:] != poses[:-1]).any(axis=1))[: len(poses)])


def _steps(first: Floats, second: Floats) -> Floats:
    """Return the steps (n, 3) [m] between poses, in the frame of the odometry, with turns as distances."""
    return np.asarray(difference(second, first) * [1.0, 1.0, ROBOT.lever])


def _usual(stamps: Floats) -> float:
    """Return the median time [s] between stamps; a shorter one is that of a message that arrived late."""
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0


def _off(steps: Floats, along: Floats, most: Floats) -> Floats:
    """Return the distances (n,) of steps (n, 3) from the nearest of those `along` (n, 3) times 0 to `most` (n,)."""
    square = np.square(along).sum(axis=1)
    share = np.divide((steps * along).sum(axis=1), square, out=np.zeros(len(steps)), where=square > 0)
    return np.asarray(np.linalg.norm(steps - np.clip(share, 0.0, most)[:, None] * along, axis=1))
