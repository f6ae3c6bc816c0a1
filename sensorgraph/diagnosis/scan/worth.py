"""Evidence of an effect after the penalties for its parameters, for the choice of its place, and for site clutter.

    worth = J(with) - J(without) - price k - log n - clutter

Here k is the number of parameters, and n the number of places.

At a site with known-good runs, the parts of the path must agree on an effect of the sensor:

    P(X >= number of parts with a positive gain) < disagreement,   X ~ Binomial(n_parts, 1/2)

The clutter of a site is local: a wall that is missing in the map, a cabinet that was moved, a door. While the
robot stands still, clutter appears at the same bearing and range in every scan, as a part of the robot would.
In a corridor, a wall that is slightly off looks like the floor seen by a tilted laser. An effect of the
sensor shows along the whole path.

The run is therefore divided into parts in which the ends of beams move equally far. A sign test checks
whether the parts agree. It is robust to a single place with a large map error. Parameters of the whole sensor
have a sharper test: their size in known-good runs, and a jackknife (`site_variation`).

A mapped wall may be slightly off, or objects lean against it that the map lacks. A model that fits badly puts
its largest discs there, or into unobserved space. The evidence of such discs in known-good runs is added to
the threshold of further discs. An object in known free space that stops the rays aimed at it is exempt,
whatever clutter the building contains.
"""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.nuisance import pose_prior
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.places import obstacles
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams
from sensorgraph.world.sensor_parts import sensor_of_rays


def worth(data: ScanData, amendment: Amendment, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats] of a fit over one without the effect, minus its penalties."""
    return evidence(data, amendment, better, plain) - price(amendment, data)


def price(amendment: Amendment, data: ScanData) -> float:
    """Return the penalty [nats] of an effect for its parameters, for the choice of its place, and for site clutter."""
    walls = {"wall": data.arena.n_walls, "obstacle": len(obstacles(data.arena))}
    places = walls.get(amendment.effect.place or "", 1)
    if amendment.place and amendment.effect.place is None:
        places = len(np.unique(sensor_of_rays(data.sensor)))
    paid = SCAN.selection.price * n_parameters(amendment) + float(np.log(max(places, 1)))
    return paid + clutter_floor(amendment, data)


def n_parameters(amendment: Amendment) -> int:
    """Return the number of parameters of an effect that count for the complexity penalty."""
    effect = amendment.effect
    counted = [v != 0.0 or not effect.parameter(k).absent_at_zero for k, v in amendment.parameters.items()]
    return max(sum(counted), 1)


def evidence(data: ScanData, amendment: Amendment, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats] of a fit over one without the effect.

    At a site with known-good runs, `spread_evidence` replaces it for effects that must show on the whole
    path.
    """
    if data.clutter_nats and must_be_spread(amendment):
        return spread_evidence(data, better, plain)
    return better.j - plain.j


def must_be_spread(amendment: Amendment) -> bool:
    """Return whether an effect of the sensor has no sharper test than showing on all parts of the path.

    A warm-up has none: it starts where the robot starts, and readings may be slightly longer at another
    place.
    """
    effect = amendment.effect
    has_more = any(v != 0.0 and effect.parameter(k).absent_at_zero for k, v in amendment.parameters.items())
    return is_of_sensor(amendment) and (has_more or not effect.nuisances)


def is_of_sensor(amendment: Amendment) -> bool:
    """Return whether an effect belongs to the sensor or to some of its bearings, and not to a place of the site."""
    return amendment.effect.place in (None, "sector")


def spread_evidence(data: ScanData, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats]; at most 0 unless the parts of the path agree."""
    n, gained = SCAN.site.n_parts, _by_scan(data, better) - _by_scan(data, plain)
    by_part = np.bincount(parts_of_way(data), gained, minlength=n)
    chance = float(
        bdtrc(int((by_part > 0).sum()) - 1, n, 0.5)
    )  # of this many positive parts or more, if signs are random
    return better.j - plain.j if chance < SCAN.site.disagreement else min(better.j - plain.j, 0.0)


def _by_scan(data: ScanData, fitted: Fitted) -> Floats:
    """Return the log-likelihood (n_scans,) [nats] of the readings and of the pose of each scan."""
    delta = fitted.state.delta
    precision = np.linalg.inv(pose_prior(data, fitted.state.pose_scale))
    of_pose = 0.5 * np.einsum("ni,nij,nj->n", delta, precision, delta)
    return np.asarray(fitted.solution.responsibilities.log_p.sum(axis=1) - of_pose)


def parts_of_way(data: ScanData) -> Ints:
    """Return the part (n_scans,) of the path; in each part, the beam ends move equally far at a median range."""
    returned = data.ranges[data.returned]
    reach = float(np.median(returned)) if len(returned) else 1.0
    step = np.diff(data.poses, axis=0)
    judged = np.isfinite(data.ranges).sum(axis=1)[1:]
    moved = judged * (np.hypot(step[:, 0], step[:, 1]) + reach * np.abs(step[:, 2]))
    way = np.concatenate([[0.0], np.cumsum(moved)])
    share = way / way[-1] if way[-1] > 0 else np.zeros(len(way))
    return np.minimum((share * SCAN.site.n_parts).astype(np.intp), SCAN.site.n_parts - 1)


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
