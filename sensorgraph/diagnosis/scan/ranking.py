"""Rank the effects that were tried: by evidence, and by the laws of their readings if these decide."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_clutter import surely_stands
from sensorgraph.diagnosis.scan.unnamed.absorbed_readings import why_not_absorbed
from sensorgraph.effects import Amendment
from sensorgraph.effects.places import named_walls
from sensorgraph.types import Bools

Tried = list[tuple[Fitted, float]]
"""Fits, each with the gain [nats] of the last effect in its model."""


def n_parameters(amendment: Amendment) -> int:
    """Return the number of parameters of an effect that count for the complexity penalty."""
    effect = amendment.effect
    counted = [v != 0.0 or not effect.parameter(k).absent_at_zero for k, v in amendment.parameters.items()]
    return max(sum(counted), 1)


def ranked(data: ScanData, tried: Tried, threshold: float) -> Tried:
    """Return the tried effects in order of preference.

    Parameters
    ----------
    threshold : [nats] Evidence that a name requires.
    """
    order = _by_law(data, sorted(without_ends(data, tried), key=lambda pair: -pair[1]), threshold)
    if not data.clutter_nats:
        return order
    certain = [pair for pair in order if not _may_be_clutter(pair, data)]
    # possible clutter waits, because it would absorb the readings of other effects
    if any(gain >= threshold for _, gain in certain):
        order = certain
    return order


def _may_be_clutter(pair: tuple[Fitted, float], data: ScanData) -> bool:
    """Return whether an object in the room may be clutter of the building."""
    amendment = pair[0].model[-1]
    return amendment.effect.place == "spot" and not surely_stands(amendment, data)


def _by_law(data: ScanData, order: Tried, threshold: float) -> Tried:
    """Decide between people and outliers with nearly the same gain by the properties of their readings."""
    best, gain = order[0]
    absorber = best.model[-1].effect
    if not absorber.diagnostics.explains:
        return order
    rivals = [
        pair
        for pair in order[1:]
        if (other := pair[0].model[-1].effect) is not absorber
        and other.diagnostics.explains
        and pair[1] >= max(threshold, gain - threshold)
    ]
    if not rivals or _keeps_its_law(data, best):
        return order
    first = next((pair for pair in rivals if _keeps_its_law(data, pair[0])), order[0])
    return [first, *(one for one in order if one is not first)]


def _keeps_its_law(data: ScanData, fitted: Fitted) -> bool:
    """Return whether the readings that the last effect absorbs have the properties of that effect."""
    return not why_not_absorbed(FitResiduals(data, fitted), fitted.model[-1])[0]


def without_ends(data: ScanData, tried: Tried) -> Tried:
    """Compare panes, mirrors and black parts of one wall on the rays that clearly meet or clearly miss them.

    A ray near an end may be on either side of it. That costs an effect with certain loss more likelihood than
    one with probable loss.
    """
    order = sorted(tried, key=lambda pair: -pair[1])
    best, gain = order[0]
    if not best.model[-1].effect.on_part_of_wall:
        return tried
    out = [order[0]]
    for got, nats in order[1:]:
        a = got.model[-1]
        if a.effect.on_part_of_wall and a.place == best.model[-1].place:
            clear = ~(_near_ends(data, best) | _near_ends(data, got))
            nats = gain - float(
                (best.solution.responsibilities.log_p - got.solution.responsibilities.log_p)[clear].sum()
            )
        out.append((got, nats))
    return out


def _near_ends(data: ScanData, fitted: Fitted) -> Bools:
    """Return which rays (n_scans, n_rays) meet the wall of the last effect within a few blur widths of one of its ends."""
    a, t, scene = fitted.model[-1], data.tolerances, fitted.cast.scene
    bare = bare_cast(scene)
    on = np.isin(bare.wall, named_walls(data.arena, a.place))
    blur = (t.pose_xy + t.pose_yaw * bare.ranges) / np.maximum(bare.cosine, 0.1) + t.map
    with np.errstate(invalid="ignore"):
        along = bare.along(scene.walls)
        near = np.minimum(np.abs(along - a["a"]), np.abs(along - a["b"])) < SCAN.selection.end_blur * blur
    return np.asarray(on & near)
