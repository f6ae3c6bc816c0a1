"""What the wheels would have said without noise: the motion that structure is looked for in.

Rows are the reference less the wheels. A column of the wheels' own readings shares its noise with the rows: errors in
variables, which attenuate every scale, and make one out of nothing where a column chooses increments by the noisy speed
itself or where the robot stands (Fuller 1987, chapter 1). By the Gauss-Markov theorem the best estimate of the motion
from wheels and reference is uncorrelated with their difference, so columns made of it find nothing where nothing is.
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


def fused_motion(rows: OdometryRows, wheels: WheelIncrements, residual: Floats) -> WheelIncrements:
    """Return the increments of the wheels less the slow part of their noise, which the reference shows.

    The noise is the smoothed level of a random walk, that of the wheels, seen in the noise of the averaged reference
    (local-level model; Durbin and Koopman 2012, section 2.4). How much there is of either, the residual says.

    Parameters
    ----------
    residual : (2 n,) [m], then [rad]; what the model leaves of the rows
    """
    ends = np.append(wheels.start, wheels.end[-1]) - rows.clock
    distance, turn = (
        np.diff(np.interp(ends, rows.stamps, _smoothed_walk(part, rows)))
        for part in both_kinds(residual, rows.n)
    )
    return replace(wheels, distance=wheels.distance + distance, turn=wheels.turn + turn)


def _smoothed_walk(residual: Floats, rows: OdometryRows) -> Floats:
    """Return the walk (n,) in the sum of a residual (n,)."""
    part = np.where(rows.valid, clipped(residual, rows.valid, EVIDENCE.clip_limit, 1e-12), 0.0)
    ratio = _walk_over_level(part, float(np.median(np.diff(rows.stamps))))
    bands = np.full((2, rows.n), -1.0 / ratio)
    bands[1] = 1.0 + 2.0 / ratio
    bands[1, [0, -1]] = 1.0 + 1.0 / ratio
    bands[0, 0] = 0.0
    return np.asarray(solveh_banded(bands, np.cumsum(part)))


def _walk_over_level(residual: Floats, period: float) -> float:
    """Return the variance of one step of the walk over that of the level's noise.

    Sums over a block grow with the walk alone; single rows hold two thirds of a step of it and the noise twice.
    """
    k = max(round(EVIDENCE.cluster / period), 2)
    n = max(len(residual) // k, 1)
    single = float(np.mean(residual**2)) + 1e-18
    block = float(np.mean(residual[: n * k].reshape(n, -1).sum(axis=1) ** 2))
    walk = float(np.clip((block - single) / (k - 2 / 3), 0.0, 1.5 * single))
    ratio = walk / max((single - 2 / 3 * walk) / 2, 1e-18)
    return float(np.clip(ratio, *ODOMETRY.walk_over_level))
