"""A place known in part, as a graph of one run holds it: rays that leave what was seen there are not judged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sensorgraph.diagnosis.raster_map import known_and_unchanged, looks_into_unknown
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.world.open_borders import open_borders


def without_unknown_space(data: ScanData, *, with_changes: bool = True) -> tuple[ScanData, dict[str, Any]]:
    """Leave out rays that enter unknown space before they meet a wall; return what to say of them.

    Parameters
    ----------
    with_changes : keep what shows that the building has changed since its walls were found; False: leave it out, too, where
        it is more things than a diagnosis may name
    """
    if data.sensor.is_composite or measures_cones(data.sensor):
        return data, {"into_unknown_share": 0.0}
    borders = open_borders(data.arena)
    if not with_changes:
        return known_and_unchanged(data, borders, few=SCAN.selection.max_effects)
    if not len(borders):
        return data, {"into_unknown_share": 0.0}
    _, unknown = looks_into_unknown(data, borders)
    ranges = np.where(unknown, np.nan, data.ranges)
    return replace(data, ranges=ranges, memo={}), {"into_unknown_share": float(unknown.mean())}
