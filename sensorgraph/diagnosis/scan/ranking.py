"""Rank the effects that were tried by evidence; at a known site, what may be clutter comes last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_clutter import surely_stands
from sensorgraph.effects.places import named_walls
from sensorgraph.types import Bools


def ranked(
    data: ScanData, tried: Sequence[tuple[Fitted, float]], threshold: float
) -> list[tuple[Fitted, float]]:
    """Return the tried effects in order of their evidence; at a known site, possible clutter comes only if nothing else does.

    Parameters
    ----------
    tried : Fits, each with the gain [nats] of the last effect in its model.
    threshold : [nats] Evidence that a name requires.
    """
    order = sorted(without_ends(data, tried), key=lambda pair: -pair[1])
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


def without_ends(data: ScanData, tried: Sequence[tuple[Fitted, float]]) -> Sequence[tuple[Fitted, float]]:
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
