"""A place known in part, as a graph of one run holds it: rays that leave what was seen there are not judged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sensorgraph.diagnosis.raster_map import known_and_unchanged, looks_into_unknown
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import IntoUnknown, ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.site_clutter import surely_stands
from sensorgraph.effects import EFFECTS
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.world.open_borders import open_borders

AROUND = 0.3
"""[m] about a thing, within which a ray passes it."""
RIM = 0.2
"""[m] before unknown space, where a reading may be of what stands at its rim: two cells of a graph."""


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
    border, unknown = looks_into_unknown(data, borders)
    leaving = IntoUnknown(
        horizon=np.maximum(border - RIM, 0.0), ranges=np.where(unknown, data.ranges, np.nan)
    )
    ranges = np.where(unknown, np.nan, data.ranges)
    data = replace(data, ranges=ranges, into_unknown=leaving, memo={})
    return data, {"into_unknown_share": float(unknown.mean())}


def judged_around_things(data: ScanData, noise_bounds: NoiseBounds) -> ScanData:
    """Judge rays that leave the map up to there, where they pass a thing that surely stands before it.

    All the rays that pass it are taken, whether it stops them or not. What else stands before the rim stays out: a building
    has more of that than of what a run can hide.
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
