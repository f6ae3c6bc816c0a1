"""Estimate the motion of the wheels without their noise, for the columns of structure.

    total_t = walk_t + level noise,   walk_t = walk_(t-1) + step      (local-level model)

Rows are reference minus wheels. A column made of the wheels' readings shares its noise with the rows (errors
in variables). This attenuates every scale. It also creates false scales where a column selects increments by
their noisy speed, or by standstill (Fuller 1987, chapter 1). By the Gauss-Markov theorem, the best estimate
of the motion from wheels and reference is uncorrelated with their difference. Columns made of that estimate
therefore find nothing in pure noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solveh_banded

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.settings import EVIDENCE, ODOMETRY
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.diagnosis.motion.whitening import both_kinds, clipped
from sensorgraph.types import Floats

MIN_TICK = 1e-5
"""[rad] turn below which a reading is a rounding error, not a tick."""
MIN_MOVING = 20
"""Minimum number of turning increments for the detection of ticks."""
MAX_MULTIPLE = 5.5
"""Maximum number of ticks in an increment that is used to estimate the tick."""
TICKED_SHARE, MAX_OFF_TICK = 0.99, 0.05
"""Minimum share of the increments that are whole ticks, and maximum deviation from them, in ticks."""


def fused_motion(
    rows: OdometryRows, wheels: WheelIncrements, residual: Floats, base: float
) -> WheelIncrements:
    """Return the increments of the wheels less their noise, as far as the reference shows it.

    The slow part of the noise is the random walk of the wheels, seen in the noise of the averaged reference.
    It is smoothed with the local-level model (Durbin and Koopman 2012, section 2.4). The residual determines
    both variances. The fast part is the rounding of encoder counts, if the readings are whole ticks.

    Parameters
    ----------
    residual : (2 n,) [m], then [rad]; residual of the model.
    base : [m] Wheelbase.
    """
    ends = np.append(wheels.start, wheels.end[-1]) - rows.clock
    tick = turn_of_a_tick(wheels.turn)
    counting = (tick * base) ** 2 / 24, tick**2 / 6  # two wheels, each with a uniform error of a tick
    noise = [
        np.diff(_wheel_noise(part, rows, ends, variance))
        for part, variance in zip(both_kinds(residual, rows.n), counting, strict=True)
    ]
    return replace(wheels, distance=wheels.distance + noise[0], turn=wheels.turn + noise[1])


def turn_of_a_tick(turn: Floats) -> float:
    """Return the turn [rad] of which all increments (n,) are whole multiples; 0 without such a turn.

    A base whose wheels count ticks of q metres, b metres apart, reads turns in steps of q / b.
    """
    moving = np.abs(turn[np.abs(turn) > MIN_TICK])
    if len(moving) < MIN_MOVING:
        return 0.0
    step = float(moving.min())
    near = moving[moving < MAX_MULTIPLE * step]
    step = float(np.sum(near) / np.sum(np.round(near / step)))
    off = np.abs(moving / step - np.round(moving / step))
    return step if np.quantile(off, TICKED_SHARE) < MAX_OFF_TICK else 0.0


def _wheel_noise(residual: Floats, rows: OdometryRows, ends: Floats, counting: float) -> Floats:
    """Return the accumulated noise of the wheels at the ends of the increments, from a residual (n,).

    Parameters
    ----------
    counting : Variance of the rounding of ticks, in squared units of the residual.
    """
    part = np.where(rows.valid, clipped(residual, rows.valid, EVIDENCE.clip_limit, 1e-12), 0.0)
    period = float(np.median(np.diff(rows.stamps)))
    counted = counting / max(1.0, period / float(np.median(np.diff(ends))))
    walk, level = _variances(part, period)
    total = np.cumsum(part)
    smooth = _smoothed_walk(total, float(np.clip(walk / level, *ODOMETRY.walk_over_level)))
    share = min(1.0, counted / level)
    slow = np.interp(ends, rows.stamps, smooth)
    return np.asarray(slow + share * np.interp(ends, rows.stamps + period / 2, total - smooth))


def _smoothed_walk(total: Floats, ratio: float) -> Floats:
    """Return the smoothed walk x (n,) in a sum `total` (n,).

        minimise  |total - x|² + |diff x|² / ratio

    Parameters
    ----------
    ratio : Variance of one step of the walk over that of the noise of the level.
    """
    bands = np.full((2, len(total)), -1.0 / ratio)
    bands[1] = 1.0 + 2.0 / ratio
    bands[1, [0, -1]] = 1.0 + 1.0 / ratio
    bands[0, 0] = 0.0
    return np.asarray(solveh_banded(bands, total))


def _variances(residual: Floats, period: float) -> tuple[float, float]:
    """Return the variances of one step of the walk and of the noise of the level.

        walk = (block - single) / (k - 2/3),   level = (single - 2/3 walk) / 2

    single and block are the mean squares of rows and of sums over k rows. Such a sum grows with the walk
    only.
    """
    k = max(round(EVIDENCE.cluster / period), 2)
    n = max(len(residual) // k, 1)
    single = float(np.mean(residual**2)) + 1e-18
    block = float(np.mean(residual[: n * k].reshape(n, -1).sum(axis=1) ** 2))
    walk = float(np.clip((block - single) / (k - 2 / 3), 0.0, 1.5 * single))
    level = max((single - 2 / 3 * walk) / 2, 1e-18)
    lasting = _lasting_walk(residual)
    return (walk, level) if lasting is None or lasting[1] < level else lasting


def _lasting_walk(residual: Floats) -> tuple[float, float] | None:
    """Return both variances for a walk with correlated steps, such as lasting slip; None if they are not.

        gamma_0 = w + 2 l,   gamma_1 = m w - l,   gamma_2 = m² w

    The steps are a first-order autoregression with memory m and variance w; l is the variance of the level
    noise. Sums over blocks would overestimate the walk by a factor (1 + m) / (1 - m).
    """
    if len(residual) < 3:
        return None
    none, one, two = (float(np.mean(residual[k:] * residual[: len(residual) - k])) for k in range(3))
    of_steps = one + none / 2  # w (m + 1/2)
    if two <= 0 or of_steps <= 0:
        return None
    memory = min((two + np.sqrt(two**2 + 2 * of_steps * two)) / (2 * of_steps), 1.0)
    walk = of_steps / (memory + 0.5)
    return walk, max((none - walk) / 2, 1e-18)
