"""Evidence that the clutter of a site may contribute to an effect, and objects that are exempt from it.

A mapped wall may be slightly off, or objects lean against it that the map lacks. A model that fits badly puts
its largest discs there, or into unobserved space. The evidence of such discs in known-good runs is added to
the threshold of further discs. An object in known free space that stops the rays aimed at it is exempt,
whatever clutter the building contains.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools
from sensorgraph.world.beams import Beams


def clutter_floor(amendment: Amendment, data: ScanData) -> float:
    """Return the additional evidence [nats] that a name requires at this site."""
    floor = data.clutter_nats.get(amendment.name, 0.0)
    return 0.0 if 0.0 < floor < np.inf and surely_stands(amendment, data) else floor


def surely_stands(amendment: Amendment, data: ScanData) -> bool:
    """Return whether an effect is a separate round object in known free space that stops the rays aimed at it.

    Counted are rays that are aimed at the inner part of the disc and, according to the map, continue beyond
    it. A ray that ends at the face of the disc was stopped; a ray that ends beyond it was not. A ray that
    ends before it carries no information. Rays that end next to the disc, at the same distance, indicate a
    larger object.
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
    """Return which rays (n_scans, n_rays) end at the face of a disc at which they are aimed, beyond it, or next to it.

    A face out of range does not count, because a missing return does not show whether the ray met it.
    """
    beams, near = _beams(data), SCAN.goodness_of_fit.outline_distance
    ahead, aside = beams.towards(x, y)
    face = ahead - np.sqrt(np.maximum(r**2 - aside**2, 0.0))
    free = np.minimum(beams.ranges, data.sensor.range_max)
    ahead = np.where((face > 0) & (free > face + 2 * near), ahead, np.inf)
    aside = np.abs(aside)
    aimed = np.isfinite(ahead) & (aside < SCAN.site.inner_share * r)
    next_to = (aside > r + near) & (aside < r + 3 * near)
    with np.errstate(invalid="ignore"):
        stopped, passed = np.abs(data.ranges - face) <= near, data.ranges > face + near
        beside = next_to & (data.ranges < free - near) & (np.abs(data.ranges - ahead) < r + near)
    return aimed & stopped, aimed & passed, beside


def _beams(data: ScanData) -> Beams:
    """Return the rays in the map without effects."""
    return data.kept(b"bare map", lambda: data.scene().shoot())
