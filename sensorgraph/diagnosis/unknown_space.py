"""A place known in part, as a graph of one run holds it: rays that leave what was seen there are not judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sensorgraph.diagnosis.raster_map import looks_into_unknown
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.world.open_borders import open_borders


def without_unknown_space(data: ScanData) -> tuple[ScanData, float]:
    """Leave out rays that enter unknown space before they meet a wall; return their share, too."""
    if data.sensor.is_composite or measures_cones(data.sensor):
        return data, 0.0
    borders = open_borders(data.arena)
    if not len(borders):
        return data, 0.0
    _, unknown = looks_into_unknown(data, borders)
    ranges = np.where(unknown, np.nan, data.ranges)
    return replace(data, ranges=ranges, memo={}), float(unknown.mean())
