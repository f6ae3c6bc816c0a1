"""Visibility, spread, calibration and tails of a model of cells, from the scans that a log sets aside."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from sensorgraph.models.base import POINTS, Point
from sensorgraph.models.cells.distribution import KNOTS, NORMAL_TAILS, fit_tails
from sensorgraph.models.cells.evidence import MIN_RANGE, CellEvidence
from sensorgraph.models.cells.grid import per_ray
from sensorgraph.models.cells.learning import (
    MAX_PASSED_SAMPLES,
    SetAside,
    fit_logistic,
    is_set_aside,
    n_folds_of,
    training_samples,
)
from sensorgraph.models.cells.probability_calibration import calibrate_p_off, fit_spread
from sensorgraph.models.cells.ray_march import CellTable, new_work, summarise_rays, tabulate
from sensorgraph.models.cells.settings import CELLS
from sensorgraph.models.cells.visibility import TERMS
from sensorgraph.models.mixture import which_of
from sensorgraph.types import Floats, Progress

NEWTON_STEPS = 4
"""Number of Newton steps, starting from the shipped polynomial."""


@cache
def shipped_visibility() -> tuple[float, ...]:
    """Return the shipped coefficients, which were learned from several buildings.

    Raises
    ------
    ValueError : The terms in visibility.json differ from those of the polynomial.
    """
    table = json.loads((files("sensorgraph.data") / "visibility.json").read_text())["beta"]
    if tuple(table) != TERMS:
        raise ValueError("the terms in visibility.json differ from those of the polynomial; learn it again")
    return tuple(table.values())


def learn_visibility(
    poses: Floats, ranges: Floats, bearings: Floats, cell: float, reach: float, report: Progress
) -> tuple[Floats, tuple[float, float, float], Floats, Floats]:
    """Learn beta (n_terms,), the spread [m], the calibration (3, n_knots) and the tails (3,) on stretches set aside."""
    beta = np.array(shipped_visibility())
    first = CELLS.first_sigma, 0.0, CELLS.first_sigma
    folds = []
    for fold in range(n_folds_of(len(poses))):
        aside = is_set_aside(len(poses), fold)
        evidence = CellEvidence.of(poses[~aside], ranges[~aside], bearings, cell=cell, reach=reach).widened()
        folds.append((evidence, SetAside(poses[aside], ranges[aside], bearings)))
    if not folds:
        return beta, first, np.tile(KNOTS, (len(POINTS), 1)), NORMAL_TAILS
    report(1, 5)
    most = MAX_PASSED_SAMPLES // len(folds)
    samples = [
        training_samples(evidence, *scans, tabulate(evidence, beta, first), most) for evidence, scans in folds
    ]
    report(2, 5)
    phi, label, weight = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    beta = fit_logistic(phi, label, weight, beta, beta, steps=NEWTON_STEPS)
    report(3, 5)
    tables = [tabulate(evidence, beta, first) for evidence, _ in folds]
    set_aside = [scans for _, scans in folds]
    spread = fit_spread(set_aside, tables)
    tables = [table._replace(sigma=spread[0], across=spread[1], rough=spread[2]) for table in tables]
    report(4, 5)
    summaries, measured = [], []
    for scans, table in zip(set_aside, tables, strict=True):
        summaries.append(
            [summarise_poses(table, scans.poses, bearings, point)[0] for point in ("mode", "median", "mean")]
        )
        measured.append(scans.ranges)
    z = np.concatenate(measured)
    reliability = calibrate_p_off(np.concatenate(summaries, axis=1), z, (z > MIN_RANGE) & (z < reach))
    return beta, spread, reliability, fit_tails(set_aside, tables, reliability[which_of("mode")])


def summarise_poses(
    table: CellTable, poses: Floats, bearings: Floats, point: Point
) -> tuple[NDArray[np.float64], Floats, Floats]:
    """Traverse the cells along all rays from poses (n, 3) or (n, n_rays, 3).

    Returns
    -------
    summaries (n_poses, n_rays, 6), probability of a return near the median, length [m] through unobserved cells
    """
    shape = (len(poses), len(bearings))
    out, near, unobserved = np.empty((*shape, 6)), np.empty(shape), np.empty(shape)
    summarise_rays(per_ray(poses), bearings, table, which_of(point), new_work(table), out, near, unobserved)
    return out, near, unobserved
