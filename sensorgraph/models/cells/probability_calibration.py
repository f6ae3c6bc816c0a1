"""Calibration of predictions on scans set aside: the spread of ranges and the probability of being off."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planners.kernel import outer_kernel
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


@outer_kernel
def add_squares(
    poses: Floats, ranges: Floats, bearings: Floats, table: CellTable, work: RayWork, sums: Floats, rough: Floats
) -> None:  # fmt: skip
    """Add what the measured ranges tell of the variances sigma² and across² to `sums`, and of rough² to `rough`.

    With p(z) = outlier density + sum_i w_i N(z; r_i, s_i²), candidate i has the responsibility w_i N(z; r_i, s_i²) / p(z).
    `sums` (2, 3) are the normal equations of the squared residuals on 1 and tan²(angle of incidence), weighted by
    responsibility / s_i⁴. `rough` (2,) sums responsibilities and squared residuals [m²] in cells without a line. Poses
    (n, n_rays or 1, 3) are those of the laser.
    """
    _, _, r, w, sigma, _ = work
    for p in range(len(poses)):
        for q in range(len(bearings)):
            z = ranges[p, q]
            if not (z > MIN_RANGE and z < table.reach):
                continue
            n, _ = candidates_of(p, q, poses, bearings, table, work)
            total = density_at(z, r, w, sigma, n) + OUTLIER_DENSITY
            for i in range(n):
                square = (z - r[i]) ** 2
                variance = sigma[i] * sigma[i]
                if square >= TAIL * TAIL * variance or w[i] < MAX_MERGED:
                    continue  # merged cells have a spread of their own
                share = w[i] * DENSITY_AT_0 * math.exp(-0.5 * square / variance) / sigma[i] / total
                if sigma[i] == table.rough:
                    rough[0] += share
                    rough[1] += share * square
                    continue
                tangent = max(variance - table.sigma * table.sigma, 0.0) / (table.across * table.across)
                weight = share / (variance * variance)
                sums[0, 0] += weight
                sums[0, 1] += weight * tangent
                sums[1, 1] += weight * tangent * tangent
                sums[0, 2] += weight * square
                sums[1, 2] += weight * tangent * square
    sums[1, 0] = sums[0, 1]


def fit_spread(set_aside: Sequence[SetAside], tables: Sequence[CellTable]) -> tuple[float, float, float]:
    """Return sigma, across and rough [m], which maximise the likelihood of set-aside returns, by EM.

    Each fold of set-aside scans has a table of the other scans. M-step: weighted least squares of the squared residuals.
    The prior is `KNOT_WEIGHT` returns at normal incidence, at 45 degrees and without a line, with the initial variance.
    """
    first = CELLS.first_sigma
    sigma, across, rough = first, 0.5 * first, 1.01 * first
    for _ in range(EM_STEPS):
        sums = KNOT_WEIGHT * np.array([[2.0, 1.0, 2.0 * first**2], [1.0, 1.0, first**2]]) / first**4
        others = KNOT_WEIGHT * np.array([1.0, first**2])
        for (poses, ranges, bearings), table in zip(set_aside, tables, strict=True):
            now = table._replace(sigma=sigma, across=across, rough=rough)
            add_squares(per_ray(poses), ranges, bearings, now, new_work(now), sums, others)
        from scipy.optimize import nnls  # imported here, since it takes 0.2 s

        scale = np.sqrt(np.diag(sums))
        variances = nnls(sums[:, :2] / scale[:, None] / scale, sums[:, 2] / scale)[0] / scale
        sigma, across = np.sqrt(np.maximum(variances, MIN_SPREAD**2)).tolist()
        rough = math.sqrt(max(others[1] / others[0], MIN_SPREAD**2))
    return sigma, across, rough


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
