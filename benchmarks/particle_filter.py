"""AMCL's filter on a log: what a user of Nav2 has, beside our localisation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from logs.run import Run
from planners.types import Floats
from sensorgraph.exporting.amcl import compare_laser_models, estimate_amcl
from sensorgraph.exporting.amcl_filter import LASER_MODELS, CellDistances, filtered
from sensorgraph.exporting.nav2 import chosen, map_of
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.world.identified_arena import arena_of


def driven(run: Run) -> Floats:
    """Return the odometry (n_scans, 3) at the scans of a run that has one."""
    motion = odometry_of(run)
    assert motion is not None
    return odometry_at_scans(run, motion)


class FittedAmcl(NamedTuple):
    """AMCL's map and what the run of the map says of its parameters."""

    field: CellDistances
    numbers: dict[str, float]
    """Parameters by their names in Nav2."""
    laser_model: str
    lines: tuple[str, ...]
    """Each number with its estimate, and the laser model with its errors."""


def fitted_amcl(run: Run, graph: Sensorgraph) -> FittedAmcl:
    """Fit AMCL's parameters and its laser model to a located run, in the map of its graph."""
    arena = arena_of(graph)
    grid = map_of(arena)
    estimates = estimate_amcl(run, arena, grid)
    numbers = chosen(estimates)
    compared = compare_laser_models(run, grid, numbers)
    model = compared.name if compared else LASER_MODELS[0]
    lines = (
        *(f"{name}: {found}" for name, found in estimates.items()),
        f"laser_model_type: {model}, {compared}",
    )
    return FittedAmcl(field=CellDistances.of(grid), numbers=numbers, laser_model=model, lines=lines)


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
