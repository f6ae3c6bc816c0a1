"""Where the surfaces of an occupancy-grid map lie in its cells: in their middle, or at their borders.

A robot's map has the surfaces in the middle of the cells on average. A simulator that makes its world from a map extrudes
the cells, so that every wall is half a cell nearer. The likelihood of the scans decides between the two. The bias of the
laser is free in both, since it changes all readings alike. A wall that is half a cell w/2 nearer changes a reading by

    -w / (2 cos incidence).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.raster_map import RasterMap
from sensorgraph.diagnosis.scan.fit import fit, start_state, thin
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools

Prepared: TypeAlias = tuple[ScanData, dict[str, Any]]
"""Scans in a map, and notes for the report."""


def raster_map_of(
    arena: Arena, prepare: Callable[[RasterMap], Prepared], noise_bounds: NoiseBounds
) -> tuple[RasterMap, Prepared]:
    """Return an occupancy-grid arena with its surfaces where the scans have them, and the scans prepared for it.

    Parameters
    ----------
    prepare : Prepares the scans for comparison with a map.
    """
    pixels = RasterMap.of(arena)
    prepared = prepare(pixels)
    if _distance_before_walls(prepared[0]) < pixels.pixel / 4:
        return pixels, prepared
    drawn = pixels.as_drawn()
    again = prepare(drawn)
    is_compared = np.isfinite(prepared[0].ranges) & np.isfinite(again[0].ranges)
    evidence = [_log_likelihood(data, is_compared, noise_bounds) for data in (prepared[0], again[0])]
    return (drawn, again) if evidence[1] > evidence[0] else (pixels, prepared)


def _distance_before_walls(data: ScanData) -> float:
    """Return the median distance [m] of the returns before the walls, along their normals; 0 if there are no walls."""
    if data.sensor.is_composite or measures_cones(data.sensor):
        return 0.0
    beams = data.scene().shoot()
    off = beams.ranges - np.where(data.returned, data.ranges, np.nan)
    near = (beams.wall >= 0) & (np.abs(off) < 4 * data.tolerances.map)
    return float(np.median(off[near] * beams.cosine[near])) if near.any() else 0.0


def _log_likelihood(data: ScanData, is_compared: Bools, noise_bounds: NoiseBounds) -> float:
    """Return the penalised log-likelihood [nats] of some returns (n_scans, n_rays), with the laser's bias free."""
    data = replace(data, ranges=np.where(is_compared, data.ranges, np.nan), memo={})
    few = thin(data, max(1, data.n_scans // SCAN.selection.n_scans))
    model = (RANGE_BIAS(b=0.0),)
    return fit(few, model, start_state(few, noise_bounds), noise_bounds, outer=2, inner=6).j
