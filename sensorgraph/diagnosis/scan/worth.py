"""Evidence of an effect after the penalties for its parameters, for the choice of its place, and for site clutter.

    worth = J(with) - J(without) - price k - log n - clutter

Here k is the number of parameters, and n the number of places.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.ranking import n_parameters
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.site_clutter import clutter_floor
from sensorgraph.diagnosis.scan.spread_evidence import evidence
from sensorgraph.effects import Amendment
from sensorgraph.effects.places import obstacles
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
