"""Learning of the visibility polynomial from rays whose scans are not part of the evidence.

The stopping of rays is a discrete-time survival process: p = P(ray stops in the cell | ray reaches the cell) and
logit p = beta·phi. The coefficients maximise sum weight (label log p + (1 - label) log(1 - p)) minus a quadratic
penalty. The label is the posterior probability of a stop, and the weight that of reaching the cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from planners.kernel import kernel
from sensorgraph.models.cells.evidence import MIN_RANGE, CellEvidence
from sensorgraph.models.cells.grid import CellIndices, max_cells_met, per_ray, sector_of, traverse
from sensorgraph.models.cells.ray_march import RATES, CellTable, face_range, row_of
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.cells.visibility import Floats32, expand_products, features
from sensorgraph.models.stretches import N_FOLDS, N_STRETCHES
from sensorgraph.types import Bools, Floats

MIN_SET_ASIDE = 50
"""Number of key frames to set aside; a short log sets aside several folds in turn to reach it."""
RANGE_SPREAD = CELLS.first_sigma
CANDIDATE_DISTANCE = 5 * RANGE_SPREAD
"""[m] Distance from the measured range within which a cell may have stopped the ray."""
NEGLIGIBLE = 0.01
"""Probability of reaching a cell below which the cell is no sample, and of a stop up to which it counts as passed."""
INTERCEPT_RIDGE = 1e-6
"""Precision of the prior of the constant term."""
MAX_PASSED_SAMPLES = 60_000
"""Maximum number of samples of passed cells, of all folds; they are weighted to represent all of them."""
MIN_STEP, MIN_FALL = 1e-3, 1e-5
"""Minimum fraction of a Newton step, and relative decrease of the loss at which the iteration ends."""


class SetAside(NamedTuple):
    """Key frames that are not part of the evidence."""

    poses: Floats
    """(n, 3) or (n, n_rays, 3) [m, m, rad] Poses of the laser."""
    ranges: Floats
    """(n, n_rays) [m]"""
    bearings: Floats
    """(n_rays,) [rad]"""


def is_set_aside(n: int, fold: int = 0) -> Bools:
    """Return a mask of the scans (n,) that are set aside for learning: ten stretches of 2 % for each fold 0 ... 4."""
    stretch = np.arange(n) * min(N_STRETCHES, n) // max(n, 1)
    return np.asarray(stretch % N_FOLDS == (2 + fold) % N_FOLDS)


def n_folds_of(n: int) -> int:
    """Return the number of folds of n key frames to set aside in turn: 0 if there are fewer key frames than folds."""
    return 0 if n < N_FOLDS else min(N_FOLDS, math.ceil(MIN_SET_ASIDE * N_FOLDS / n))


@kernel
def list_at_risk(
    poses: Floats, ranges: Floats, bearings: Floats, table: CellTable, rows: CellIndices,
    sectors: CellIndices, label: Floats, weight: Floats,
) -> int:  # fmt: skip
    """List every cell that a ray reached; poses (n, n_rays or 1, 3) of the laser.

    Fills row, sector, label and weight of up to len(rows) samples, and returns their number. The row of a cell that no other
    ray crossed is -1; such cells may lie outside the table. The label is the
    probability that the cell stopped the ray, given that no cell before it did. The weight is the probability that no
    cell before it did; a pass counts in proportion to its chord. A return that no cell near its end explains gives no
    samples.
    """
    size = max_cells_met(table.reach, table.cell)
    at = np.empty((size, 2), dtype=np.int64)
    ends, stop = np.empty(size), np.empty(size)
    n = 0
    for p in range(len(poses)):
        for q in range(len(bearings)):
            z = ranges[p, q]
            if not z > MIN_RANGE:
                continue
            pose = poses[p, min(q, poses.shape[1] - 1)]
            angle = pose[2] + bearings[q]
            c, s = math.cos(angle), math.sin(angle)
            b = sector_of(c, s)
            hit = z < table.reach
            x0, y0 = pose[0] - table.low[0], pose[1] - table.low[1]
            far = min(z + CANDIDATE_DISTANCE, table.reach) if hit else table.reach
            n_steps = traverse(x0, y0, c, s, far, table.cell, at, ends)
            if n + n_steps > len(rows):
                return n
            before, unexplained, total = 0.0, 1.0, 0.0
            for k in range(n_steps):
                row = row_of(at[k, 0], at[k, 1], table)
                chord = ends[k] - before
                stop[k] = 0.0
                if hit and ends[k] > z - CANDIDATE_DISTANCE:
                    r, _ = face_range(
                        x0, y0, c, s, at[k, 0], at[k, 1], 0.5 * (before + ends[k]),
                        table.angle[row, b], table.offset[row, b], table.cell,
                    )  # fmt: skip
                    chance = -math.expm1(-RATES[table.rate[row, b]] * chord)
                    stop[k] = unexplained * chance * math.exp(-0.5 * ((z - r) / RANGE_SPREAD) ** 2)
                    unexplained *= 1.0 - chance
                    total += stop[k]
                before = ends[k]
            if hit and total <= 0.0:
                continue
            before, at_risk = 0.0, 1.0
            for k in range(n_steps):
                chord = ends[k] - before
                before = ends[k]
                if chord <= 0.0:  # through a corner
                    continue
                if at_risk < NEGLIGIBLE:
                    break
                share = stop[k] / total if hit else 0.0
                current = min(share / at_risk, 1.0)
                rows[n], sectors[n] = row_of(at[k, 0], at[k, 1], table), b
                weight[n] = at_risk * (current + (1.0 - current) * chord / table.cell)
                label[n] = at_risk * current / weight[n]
                at_risk -= share
                n += 1
    return n


def fit_logistic(
    phi: Floats32, label: Floats, weight: Floats, start: Floats, prior: Floats, *, steps: int,
    ridge: float = CELLS.ridge,
) -> Floats:  # fmt: skip
    """Fit a logistic regression by Newton's method with step halving.

    Maximise sum weight (label log p + (1 - label) log(1 - p)) - ½ sum penalty (beta - prior)², with
    p = 1 / (1 + exp(-phi·beta)). The step solves (phi' W phi + penalty) change = phi' (weight (label - p)) -
    penalty (beta - prior), with W = weight p (1 - p). The penalty is `ridge`, and `INTERCEPT_RIDGE` for the constant.
    """
    penalty = np.full(len(start), ridge)
    penalty[0] = INTERCEPT_RIDGE

    wide = phi.astype(np.float64)  # once, not for each product with a vector

    def loss(beta: Floats) -> tuple[float, Floats]:
        eta = wide @ beta
        return float(weight @ (np.logaddexp(0.0, eta) - label * eta) + penalty @ (beta - prior) ** 2 / 2), eta

    beta = start.copy()
    current, eta = loss(beta)
    for _ in range(steps):
        p = np.exp(-np.logaddexp(0.0, -eta))
        gradient = wide.T @ (weight * (label - p)) - penalty * (beta - prior)
        root = phi * np.sqrt(weight * p * (1.0 - p)).astype(np.float32)[:, None]
        gram = (root.T @ root).astype(np.float64)
        change = np.linalg.solve(gram + np.diag(penalty), gradient)
        length = 1.0
        while True:  # a full step may overshoot far from the solution
            after, eta = loss(beta + length * change)
            if after <= current or length < MIN_STEP:
                break
            length /= 2
        beta = beta + length * change
        if current - after < MIN_FALL * current:
            break
        current = after
    return beta


def training_samples(
    evidence: CellEvidence,
    poses: Floats,
    ranges: Floats,
    bearings: Floats,
    table: CellTable,
    most: int = MAX_PASSED_SAMPLES,
) -> tuple[Floats32, Floats, Floats]:
    """Return phi (n, n_terms), label (n,) and weight (n,) of the cells that set-aside rays reached."""
    size = ranges.size * max_cells_met(table.reach, table.cell)
    rows, sectors = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    label, weight = np.empty(size), np.empty(size)
    n = list_at_risk(per_ray(poses), ranges, bearings, table, rows, sectors, label, weight)
    label, weight = label[:n], weight[:n]
    use: list[CellIndices] = []
    weight = weight.copy()
    for group in (np.flatnonzero(label > NEGLIGIBLE), np.flatnonzero(label <= NEGLIGIBLE)):
        keep = group[:: max(1, math.ceil(len(group) / most))]
        weight[keep] *= weight[group].sum() / max(weight[keep].sum(), 1e-12)
        use.append(keep)
    chosen = np.concatenate(use)
    return expand_products(features(evidence, rows[chosen], sectors[chosen])), label[chosen], weight[chosen]
