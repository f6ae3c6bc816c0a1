"""Evidence of an effect after the penalties for its parameters, for the choice of its place, and for site clutter.

    worth = J(with) - J(without) - price k - log n - clutter

Here k is the number of parameters, and n the number of places. A smooth effect of the whole laser or the whole
map shows on plain walls. Next to a depth edge, a reading depends on the side of the edge that the ray passes. At
thin objects, a wall error of a millimetre moves rays to the other side, and a fit finds such a place by small
shifts of everything. Therefore, evidence from rays next to edges alone does not support a smooth effect, and does
not decide between two of them. Sites with known-good runs are exempt: they have sharper tests, and a
map of scan fragments is full of edges.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.ranking import Tried, n_parameters
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_clutter import clutter_floor
from sensorgraph.diagnosis.scan.spread_evidence import evidence
from sensorgraph.effects import Amendment, Effect
from sensorgraph.types import Bools
from sensorgraph.world.ray_order import neighbouring_rays
from sensorgraph.world.sensor_parts import sensor_of_rays


def worth(data: ScanData, amendment: Amendment, better: Fitted, plain: Fitted) -> float:
    """Return the evidence [nats] of a fit over one without the effect, minus its penalties."""
    gain = evidence(data, amendment, better, plain) - price(amendment, data)
    if gain < SCAN.selection.threshold or data.clutter_nats or not shows_everywhere(amendment.effect):
        return gain
    away = nats_away_from_edges(data, better, plain) - price(amendment, data)
    return gain if away >= SCAN.selection.threshold else min(gain, away)


def led_on_plain_walls(data: ScanData, tried: Tried, plain: Fitted) -> Tried:
    """Return the tried effects, with the leads of smooth effects over each other measured on rays away from edges.

    Parameters
    ----------
    plain : Fit without any of the tried effects.
    """
    smooth = [pair for pair in tried if shows_everywhere(pair[0].model[-1].effect)]
    if data.clutter_nats or len(smooth) < 2:
        return tried
    away = [nats_away_from_edges(data, fitted, plain) - price(fitted.model[-1], data) for fitted, _ in smooth]
    best = int(np.argmax(away))
    told = {
        id(f): min(gain, smooth[best][1] - (away[best] - a))
        for (f, gain), a in zip(smooth, away, strict=True)
    }
    return [(fitted, told.get(id(fitted), gain)) for fitted, gain in tried]


def price(amendment: Amendment, data: ScanData) -> float:
    """Return the penalty [nats] of an effect for its parameters, for the choice of its place, and for site clutter."""
    places = {"wall": data.arena.n_walls, "obstacle": SCAN.selection.n_obstacle_places}.get(
        amendment.effect.place or "", 1
    )
    if amendment.place and amendment.effect.place is None:
        places = len(np.unique(sensor_of_rays(data.sensor)))
    paid = SCAN.selection.price * n_parameters(amendment) + float(np.log(max(places, 1)))
    return paid + clutter_floor(amendment, data)


def shows_everywhere(effect: Effect) -> bool:
    """Return whether an effect shifts the readings of all rays smoothly.

    Such an effect has a parameter with a tolerance, or moves the whole map.
    """
    moves_all = bool(effect.nuisances) or effect.diagnostics.corner_shifts is not None
    return effect.place is None and moves_all


def nats_away_from_edges(data: ScanData, better: Fitted, plain: Fitted) -> float:
    """Return the gain [nats] of a fit over another on rays away from depth edges, scaled to the number of all rays.

    Rays next to a ray at an edge are also excluded. Without any ray away from edges, the result is the whole
    gain.
    """
    beside = _beside_edges(data, better) | _beside_edges(data, plain)
    judged = data.returned
    n, n_away = int(judged.sum()), int((judged & ~beside).sum())
    gained = better.j - plain.j
    if n_away == 0:
        return gained
    by_ray = better.solution.responsibilities.log_p - plain.solution.responsibilities.log_p
    return float(gained - by_ray[beside].sum()) * n / n_away


def _beside_edges(data: ScanData, fitted: Fitted) -> Bools:
    """Return which rays (n_scans, n_rays) of the cast of a fit are at a depth edge, or next to such a ray."""
    out = np.zeros((data.n_scans, data.n_rays), dtype=np.bool_)
    if fitted.cast.edges is None:
        return out
    out[fitted.cast.edges.index] = True
    right, left = neighbouring_rays(data.sensor)
    spread = out.copy()
    spread[:, left] |= out[:, right]
    spread[:, right] |= out[:, left]
    return spread
