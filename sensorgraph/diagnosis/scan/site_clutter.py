"""What the clutter of a site may bring an effect, and why a thing that surely stands there pays nothing for it.

Where a map has a wall it may be a little off, or lack what leans there, and a model that fits badly puts its largest discs
there, or into space that nobody has looked into. How much such discs bring in good runs is what a further one pays. A thing
in known free space that stops what is aimed at it is none of them, whatever else the building brings.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools
from sensorgraph.world.beams import Beams


def clutter_floor(amendment: Amendment, data: ScanData) -> float:
    """Return the further evidence [nats] that a name takes at this site."""
    floor = data.clutter_nats.get(amendment.name, 0.0)
    return 0.0 if 0.0 < floor < np.inf and surely_stands(amendment, data) else floor


def surely_stands(amendment: Amendment, data: ScanData) -> bool:
    """Tell whether an effect is something round that stands alone in known free space and stops what is aimed at it.

    Counted are rays that meet the inner part of the disc, and of which the map says that they go on beyond it. Those that
    end at its face were stopped, those that go on were not; what ends before it says nothing. Rays that end as near, but
    beside it, are of something larger.
    """
    values, site = amendment.parameters, SCAN.site
    if amendment.effect.place != "spot" or "r" not in values:
        return False
    at, near = np.array([[values["x"], values["y"]]]), SCAN.goodness_of_fit.outline_distance
    if not data.arena.contains(at)[0] or data.barriers.distances(at)[0] < values["r"] + near:
        return False
    stopped, passed, beside = _met(data, at[0, 0], at[0, 1], values["r"])
    n_stopped, n_passed = int(stopped.sum()), int(passed.sum())
    return (
        n_stopped >= site.min_stopped_rays
        and n_stopped >= site.min_stopped_share * (n_stopped + n_passed)
        and int(stopped.any(axis=1).sum()) >= site.min_stopped_scans
        and int(beside.sum()) <= site.max_beside_share * n_stopped
    )


def _met(data: ScanData, x: float, y: float, r: float) -> tuple[Bools, Bools, Bools]:
    """Return which rays (n_scans, n_rays) end at the face of a disc at which they are aimed, beyond it, or beside it.

    A face out of range is none: a reading without a return does not tell whether it was met.
    """
    beams, near = _beams(data), SCAN.goodness_of_fit.outline_distance
    ahead, aside = beams.towards(x, y)
    face = ahead - np.sqrt(np.maximum(r**2 - aside**2, 0.0))
    known = np.inf if data.horizon is None else data.horizon
    free = np.minimum(np.minimum(beams.ranges, known), data.sensor.range_max)
    ahead = np.where((face > 0) & (free > face + 2 * near), ahead, np.inf)
    aside = np.abs(aside)
    aimed = np.isfinite(ahead) & (aside < SCAN.site.inner_share * r)
    next_to = (aside > r + near) & (aside < r + 3 * near)
    with np.errstate(invalid="ignore"):
        stopped, passed = np.abs(data.ranges - face) <= near, data.ranges > face + near
        beside = next_to & (data.ranges < free - near) & (np.abs(data.ranges - ahead) < r + near)
    if data.beyond is not None:
        passed |= data.beyond
    return aimed & stopped, aimed & passed, beside


def _beams(data: ScanData) -> Beams:
    """Return the rays in the bare map."""
    return data.kept(b"bare map", lambda: data.scene().shoot())
