"""Exclude rays that leave the known part of a place, such as a graph of one run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sensorgraph.diagnosis.raster_map import known_and_unchanged, looks_into_unknown
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import IntoUnknown, ScanData
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.site_clutter import surely_stands
from sensorgraph.effects import EFFECTS
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.world.open_borders import open_borders

AROUND = 0.3
"""[m] distance from an object, within which a ray counts as passing it."""
RIM = 0.2
"""[m] distance to unknown space, within which a reading may belong to an object at its border: two cells of a graph."""


def without_unknown_space(data: ScanData, *, with_changes: bool = True) -> tuple[ScanData, dict[str, Any]]:
    """Exclude rays that enter unknown space before they meet a wall; return the scans and notes for the report.

    Parameters
    ----------
    with_changes : Keep readings that show a change of the building since its walls were found. False: exclude
        them as well, if the changes are more than a diagnosis may name.
    """
    if data.sensor.is_composite or measures_cones(data.sensor):
        return data, {"into_unknown_share": 0.0}
    borders = open_borders(data.arena)
    if not with_changes:
        return known_and_unchanged(data, borders)
    if not len(borders):
        return data, {"into_unknown_share": 0.0}
    border, unknown = looks_into_unknown(data, borders)
    leaving = IntoUnknown(
        horizon=np.maximum(border - RIM, 0.0), ranges=np.where(unknown, data.ranges, np.nan)
    )
    ranges = np.where(unknown, np.nan, data.ranges)
    data = replace(data, ranges=ranges, into_unknown=leaving, memo={})
    return data, {"into_unknown_share": float(unknown.mean())}


def judged_around_things(data: ScanData, noise_bounds: NoiseBounds) -> ScanData:
    """Include rays that leave the map, up to its border, if they pass an object that certainly stands there.

    All rays that pass the object are included, whether it stops them or not. Other returns before the border
    stay excluded: most of them are parts of the building that the run did not map.
    """
    if data.into_unknown is None:
        return data
    whole = data.judged_to_horizon(np.isfinite(data.into_unknown.horizon))
    null = fit(whole, (), start_state(whole, noise_bounds), noise_bounds, outer=1, inner=4)
    residuals = FitResiduals(whole, null)
    some = np.zeros(whole.ranges.shape, dtype=np.bool_)
    for effect in (e for e in EFFECTS.values() if e.place == "spot" and e.diagnostics.propose is not None):
        assert effect.diagnostics.propose is not None
        for proposal in effect.diagnostics.propose(residuals):
            if surely_stands(effect(**proposal.values), whole):
                ahead, aside = residuals.beams.towards(proposal.values["x"], proposal.values["y"])
                some |= (ahead > 0) & (np.abs(aside) < proposal.values["r"] + AROUND)
    return data.judged_to_horizon(some) if some.any() else data
