"""Calibration of predictions on scans set aside: the spread of ranges and the probability of being off."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planners.kernel import kernel
from sensorgraph.models.base import OFF_DISTANCE, POINTS
from sensorgraph.models.cells.evidence import MIN_RANGE
from sensorgraph.models.cells.grid import max_cells_met, per_ray
from sensorgraph.models.cells.ray_march import CellTable, stop_candidates
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.distribution import TAIL
from sensorgraph.models.mixture import MEAN, MEDIAN, MODE, P_OFF
from sensorgraph.types import Bools, Floats

ANSWERS = CELLS.answers
TRIED_SIGMAS = np.geomspace(*ANSWERS.tried_sigmas, ANSWERS.n_tried)
DENSITY_AT_0 = 0.3989422804
"""Standard normal density at 0."""
OUTLIER_DENSITY, KNOTS = ANSWERS.outlier_density, np.array(ANSWERS.knots)


@kernel
def log_likelihoods(
    poses: Floats, ranges: Floats, bearings: Floats, table: CellTable, sigmas: Floats, out: Floats
) -> None:
    """Fill out (n_sigmas,) with the log likelihood of all returns for each spread about the faces.

    p(z) = outlier density + sum_i w_i N(z; r_i, sigma²). Poses (n, n_rays or 1, 3) are those of the laser.
    """
    size = max_cells_met(table.reach, table.cell)
    at = np.empty((size, 2), dtype=np.int64)
    ends, r, w, sigma, unseen = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    out[:] = 0.0
    for p in range(len(poses)):
        for q in range(len(bearings)):
            z = ranges[p, q]
            if not (z > MIN_RANGE and z < table.reach):
                continue
            pose = poses[p, min(q, poses.shape[1] - 1)]
            angle = pose[2] + bearings[q]
            n, _ = stop_candidates(
                pose[0],
                pose[1],
                math.cos(angle),
                math.sin(angle),
                table,
                at,
                ends,
                r,
                w,
                sigma,
                unseen,
            )
            for k in range(len(sigmas)):
                density = OUTLIER_DENSITY
                for i in range(n):
                    e = (z - r[i]) / sigmas[k]
                    if abs(e) < TAIL:
                        density += w[i] * DENSITY_AT_0 * math.exp(-0.5 * e * e) / sigmas[k]
                out[k] += math.log(density)


def best_sigma(poses: Floats, ranges: Floats, bearings: Floats, table: CellTable) -> float:
    """Return the spread [m] that maximises the likelihood of set-aside returns, with parabolic interpolation."""
    out = np.empty(len(TRIED_SIGMAS))
    log_likelihoods(per_ray(poses), ranges, bearings, table, TRIED_SIGMAS, out)
    k = int(np.clip(np.argmax(out), 1, len(TRIED_SIGMAS) - 2))
    below, here, above = out[k - 1 : k + 2]
    bend = below - 2 * here + above
    shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(TRIED_SIGMAS[k] * (TRIED_SIGMAS[1] / TRIED_SIGMAS[0]) ** np.clip(shift, -1, 1))


def calibrate_p_off(summaries: NDArray[np.float64], ranges: Floats, scored: Bools) -> Floats:
    """Fit the observed probability of being off to the predicted one; return (3, n_knots), for each of `POINTS`.

    A function that is linear between `KNOTS` minimises sum_i (off_i - value(predicted_i))² + ridge sum_k (value_k -
    KNOTS_k)². It is clipped to [0, 1] and made monotonic. With few data it stays close to the prediction.
    """
    columns = {"mode": MODE, "median": MEDIAN, "mean": MEAN}
    out = np.empty((len(POINTS), len(KNOTS)))
    for k, name in enumerate(POINTS):
        predicted = summaries[k][..., P_OFF][scored]
        off = np.abs(summaries[k][..., columns[name]][scored] - ranges[scored]) > OFF_DISTANCE
        left = np.clip(np.searchsorted(KNOTS, predicted, side="right") - 1, 0, len(KNOTS) - 2)
        share = (predicted - KNOTS[left]) / np.diff(KNOTS)[left]
        hat = np.zeros((len(predicted), len(KNOTS)))
        hat[np.arange(len(predicted)), left] = 1.0 - share
        hat[np.arange(len(predicted)), left + 1] = share
        ridge = ANSWERS.knot_weight
        value = np.linalg.solve(hat.T @ hat + ridge * np.eye(len(KNOTS)), hat.T @ off + ridge * KNOTS)
        out[k] = np.maximum.accumulate(np.clip(value, 0.0, 1.0))
    return out
