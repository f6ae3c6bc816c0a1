"""Measure settings of a laser in a run: rays, angles, ranges and rate."""

from __future__ import annotations

import numpy as np

from logs.run import Run
from sensorgraph.amending.findings import MeasuredLaser
from sensorgraph.errors import SensorgraphError
from sensorgraph.robust import robust_sigma

SAME_STEP = 1e-4
"""[rad] Largest deviation of the angle between neighbouring rays from its mean."""
MIN_SCANS = 3


def measure_laser(run: Run) -> MeasuredLaser:
    """Return the settings of a run's laser; the rate is the inverse of the median period.

    Raises
    ------
    SensorgraphError : The run has too few scans, or its laser is not one fan with even steps.
    """
    name = str(run.meta.get("source", "the run"))
    if run.n_scans < MIN_SCANS:
        raise SensorgraphError(
            f"{name}: {run.n_scans} scans; expected {MIN_SCANS} or more to measure the rate"
        )
    bearings = np.unwrap(run.sensor.bearings)
    steps = np.diff(bearings)
    if run.sensor.is_composite or len(steps) == 0 or np.ptp(steps) > SAME_STEP:
        raise SensorgraphError(f"{name}: the laser is not one fan with even steps; leave the run out")
    periods = np.diff(run.stamps)
    period = float(np.median(periods))
    if period <= 0:
        raise SensorgraphError(f"{name}: its scans have no increasing times; leave the run out")
    scatter = robust_sigma(periods - period)
    returns = run.ranges[np.isfinite(run.ranges)]
    return MeasuredLaser(
        n_rays=run.sensor.n_rays,
        angle_min=float(bearings.min()),
        angle_max=float(bearings.max()),
        range_min=float(run.sensor.range_min),
        range_max=float(run.sensor.range_max),
        rate=1 / period,
        # the median of n periods has 1.25 times the standard error of their mean
        rate_sigma=max(1.25 * scatter / np.sqrt(len(periods)), 1e-6 * period) / period**2,
        mean_square_range=float(np.mean(returns**2)) if len(returns) else 0.0,
        name=name,
    )
