"""Calibration of predictions on scans set aside: the spread of ranges and the probability of being off."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planners.kernel import kernel
from sensorgraph.models.base import OFF_DISTANCE, POINTS
from sensorgraph.models.cells.distribution import KNOT_WEIGHT, KNOTS, OUTLIER_DENSITY
from sensorgraph.models.cells.evidence import MIN_RANGE
from sensorgraph.models.cells.grid import per_ray
from sensorgraph.models.cells.learning import SetAside
from sensorgraph.models.cells.ray_march import MAX_MERGED, CellTable, RayWork, candidates_of, new_work
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.distribution import DENSITY_AT_0, TAIL, density_at
from sensorgraph.models.mixture import MEAN, MEDIAN, MODE, P_OFF
from sensorgraph.types import Bools, Floats

MIN_SPREAD = 0.005
"""[m] Smallest spread about a face, and of the place of a line."""
EM_STEPS = 6
"""Number of EM steps of the spread; later ones change it by less than 2 %."""
N_INCIDENCES = 8
"""Number of classes of the angle of incidence."""


@kernel
def add_squares(
    poses: Floats, ranges: Floats, bearings: Floats, table: CellTable, work: RayWork, weights: Floats,
    squares: Floats, tangents: Floats,
) -> None:  # fmt: skip
    """Add the responsibilities of all candidates for the measured ranges, and their squared residuals [m²].

    With p(z) = outlier density + sum_i w_i N(z; r_i, s_i²), candidate i has the responsibility w_i N(z; r_i, s_i²) / p(z).
    Class 0 is cells without a line; the others are classes of the cosine of incidence, from normal to grazing.
    `tangents` collects the squared tangents of incidence. All three are (n_classes,). Poses (n, n_rays or 1, 3) are those
    of the laser.
    """
    _, _, r, w, sigma, _ = work
    n_classes = len(weights) - 1
    across = table.across * table.across
    for p in range(len(poses)):
        for q in range(len(bearings)):
            z = ranges[p, q]
            if not (z > MIN_RANGE and z < table.reach):
                continue
            n, _ = candidates_of(p, q, poses, bearings, table, work)
            total = density_at(z, r, w, sigma, n) + OUTLIER_DENSITY
            for i in range(n):
                e = (z - r[i]) / sigma[i]
                if abs(e) < TAIL and w[i] >= MAX_MERGED:  # merged cells have a spread of their own
                    share = w[i] * DENSITY_AT_0 * math.exp(-0.5 * e * e) / sigma[i] / total
                    tangent, k = 0.0, 0
                    if sigma[i] != table.rough:
                        tangent = (sigma[i] * sigma[i] - table.sigma * table.sigma) / across
                        k = 1 + min(
                            int((1.0 - 1.0 / math.sqrt(1.0 + max(tangent, 0.0))) * n_classes), n_classes - 1
                        )
                    weights[k] += share
                    squares[k] += share * (z - r[i]) ** 2
                    tangents[k] += share * tangent


def fit_spread(set_aside: Sequence[SetAside], tables: Sequence[CellTable]) -> tuple[float, float, float]:
    """Return sigma, across and rough [m], which maximise the likelihood of set-aside returns, by EM.

    Each fold of set-aside scans has a table of the other scans.

    M-step: a weighted least-squares line through the mean squared residual of each class of incidence, over the squared
    tangent. The weights are those of variances, n_k / variance². Each class has a prior of `KNOT_WEIGHT` returns at the
    initial spread.
    """
    prior, first = KNOT_WEIGHT, CELLS.first_sigma
    spread = np.array([first, 0.5 * first, 1.01 * first])
    for _ in range(EM_STEPS):
        weights, squares, tangents = (np.zeros(N_INCIDENCES + 1) for _ in range(3))
        for (poses, ranges, bearings), table in zip(set_aside, tables, strict=True):
            now = table._replace(sigma=float(spread[0]), across=float(spread[1]), rough=float(spread[2]))
            add_squares(per_ray(poses), ranges, bearings, now, new_work(now), weights, squares, tangents)
        x = tangents / np.maximum(weights, 1e-9)
        y = (squares + prior * first**2) / (weights + prior)
        use = np.flatnonzero(weights[1:] > 0) + 1
        if len(use) < 2:
            break
        scale = np.sqrt(weights[use]) / y[use]
        from scipy.optimize import nnls  # imported here, since it takes 0.2 s

        rows = np.column_stack([np.ones(len(use)), x[use]]) * scale[:, None]
        variances = np.maximum(nnls(rows, y[use] * scale)[0], MIN_SPREAD**2)
        spread = np.array([*np.sqrt(variances), math.sqrt(max(y[0], MIN_SPREAD**2))])
    return float(spread[0]), float(spread[1]), float(spread[2])


def calibrate_p_off(summaries: NDArray[np.float64], ranges: Floats, scored: Bools) -> Floats:
    """Fit the observed probability of being off to the predicted one; return (3, n_knots), for each of `POINTS`.

    A function that is linear between `KNOTS` minimises sum_i (off_i - value(predicted_i))² + KNOT_WEIGHT sum_k (value_k -
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
        normal = hat.T @ hat + KNOT_WEIGHT * np.eye(len(KNOTS))
        value = np.linalg.solve(normal, hat.T @ off + KNOT_WEIGHT * KNOTS)
        out[k] = np.maximum.accumulate(np.clip(value, 0.0, 1.0))
    return out
