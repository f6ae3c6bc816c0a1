"""AMCL's filter on a log: what a user of Nav2 has, beside our localisation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from logs.run import Run
from planners.types import Floats
from sensorgraph.exporting.amcl_filter import LASER_MODELS, CellDistances, filtered
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of


def driven(run: Run) -> Floats:
    """Return the odometry (n_scans, 3) at the scans of a run that has one."""
    motion = odometry_of(run)
    assert motion is not None
    return odometry_at_scans(run, motion)


def followed(
    run: Run,
    truth: Floats,
    field: CellDistances,
    parameters: Mapping[str, float],
    rng: np.random.Generator,
    laser_model: str = LASER_MODELS[0],
) -> Floats:
    """Return the poses (n_scans, 3) of the filter after its updates, nan between them; it is told where to start.

    Parameters
    ----------
    run : its poses are the odometry
    truth : (n_scans, 3) base_link in map
    parameters : by their names in Nav2
    """
    first = int(np.flatnonzero(np.isfinite(truth[:, 0]))[0])
    out = np.full_like(truth, np.nan)
    out[first:] = filtered(
        driven(run)[first:], run.ranges[first:], run.sensor, truth[first], field, parameters,
        rng=rng, laser_model=laser_model,
    )  # fmt: skip
    return out
