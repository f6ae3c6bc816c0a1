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
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.diagnosis.motion.whitening import both_kinds, clipped
from sensorgraph.types import Floats

MIN_RATIO = 1e-9
"""Ratio of walk and level noise, at which the walk is practically constant."""


def fused_motion(rows: OdometryRows, wheels: WheelIncrements, residual: Floats) -> WheelIncrements:
    """Return the increments of the wheels less their noise, as far as the reference shows it.

    Their noise is a random walk, seen in the noise of the averaged reference. It is smoothed with the
    local-level model (Durbin and Koopman 2012, section 2.4). The residual determines both variances.

    Parameters
    ----------
    residual : (2 n,) [m], then [rad]; residual of the model.
    """
    ends = np.append(wheels.start, wheels.end[-1]) - rows.clock
    noise = [np.diff(_wheel_noise(part, rows, ends)) for part in both_kinds(residual, rows.n)]
    return replace(wheels, distance=wheels.distance + noise[0], turn=wheels.turn + noise[1])


def _wheel_noise(residual: Floats, rows: OdometryRows, ends: Floats) -> Floats:
    """Return the accumulated noise of the wheels at the ends of the increments, from a residual (n,)."""
    part = np.where(rows.valid, clipped(residual, rows.valid, EVIDENCE.clip_limit, 1e-12), 0.0)
    period = float(np.median(np.diff(rows.stamps)))
    walk, level = _variances(part, period)
    smooth = _smoothed_walk(np.cumsum(part), max(walk / level, MIN_RATIO))
    return np.asarray(np.interp(ends, rows.stamps, smooth))


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
    return walk, max((single - 2 / 3 * walk) / 2, 1e-18)
