"""Whether an effect is more than the set-up may hide, by the tolerances that the fit has found."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment


def is_map_error(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an obstacle stands out of a mapped one by no more than the map may be wrong there, or is a wall.

    A disc that is as large as discs may be has been fitted to something flat.
    """
    if amendment.effect.place != "spot":
        return False
    data, values = fitted.solver.data, amendment.parameters
    if values["r"] > amendment.effect.parameter("r").high - amendment.effect.sizes["r"]:
        return True
    place = np.array([[values["x"], values["y"]]])
    if data.arena.contains(place)[0]:
        return False
    stands_out = values["r"] - float(data.barriers.distances(place)[0])
    return stands_out < SCAN.naming.map_sigmas * data.tolerances.map * required_ratio(fitted)


def required_ratio(fitted: Fitted) -> float:
    """Return how many materialities an effect must have: more, where the tolerances proved too tight."""
    scale = max(fitted.state.map_scale, fitted.state.pose_scale)
    is_stretched = scale > SCAN.nuisance.stretched_scale
    return SCAN.naming.stretched_factor * scale if is_stretched else max(1.0, scale)
