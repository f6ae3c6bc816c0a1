"""Whether an accepted effect matters: its size, or the readings that it changes, beside the errors that the setup and its map may have."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import ndtr, pdtr

from sensorgraph.diagnosis.scan.fit import Fitted, log_p_at
from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.world.robot import Tolerances

SURELY_MATERIAL = "surely_material"
"""Name of the rule that a size exceeds its materiality with sufficient probability."""


def material_chance(fitted: Fitted, amendment: Amendment) -> float:
    """Return the probability that an effect of a fit matters: its size, or without one the share of the readings that it changes.

        P(share > min_share) = P(X <= n),   X ~ Poisson(min_share N)

    n of N readings are clearly better explained with the effect; their rate has a flat prior.
    """
    if amendment.effect.sizes or amendment.effect.diagnostics.is_lattice:
        return material_probability(amendment, amendment.stderr, required_ratio(fitted, amendment))
    data, settings = fitted.solver.data, SCAN.goodness_of_fit
    rest = tuple(a for a in fitted.model if a != amendment)
    better = log_p_at(data, fitted.model, fitted.state) - log_p_at(data, rest, fitted.state)
    n_changed = int((better > settings.clearly_better).sum())
    return float(pdtr(n_changed, settings.min_share * better.size))


def material_probability(amendment: Amendment, stderr: Mapping[str, float], slack: float = 1.0) -> float:
    """Return the probability that an effect's size is at least `slack` times its materiality; 1 without a limit.

        Φ((ratio - slack) / error)

    The error is taken along the direction of the size, since several sizes add as a vector. The other sign does not count:
    a size that the run does not determine (error -> inf) is as probably material as not.
    """
    sizes = amendment.effect.sizes
    ratio = size_ratio(amendment.effect, amendment.parameters)
    if not np.isfinite(ratio):
        return 1.0
    parts = {
        k: (amendment[k] / m, stderr.get(k, 0.0) / m) for k, m in sizes.items() if k in amendment.parameters
    }
    along = sum((value * error) ** 2 for value, error in parts.values()) ** 0.5 / max(ratio, 1e-9)
    error = max(along, 1e-6)
    return float(ndtr((ratio - slack) / error))


def required_ratio(fitted: Fitted, amendment: Amendment) -> float:
    """Return the minimum size of an effect in materialities: more for wide specified tolerances, or if the fit widened them."""
    proved = max(1.0, fitted.state.map_scale, fitted.state.pose_scale)
    usual, told = prior_widths(Tolerances()), prior_widths(fitted.solver.data.tolerances)
    return proved * float((told / usual)[list(amendment.effect.nuisances)].max(initial=1.0))


def is_map_error(fitted: Fitted, amendment: Amendment) -> bool:
    """Return whether a change of the building is within the errors of the map.

    This holds for a wall of an occupancy-grid map, or the map as a whole, that moved by less than a cell, and for a disc that stands
    out of a mapped object by a small distance. A disc that may be as large as the largest one also counts, because it was fitted to
    a flat object.
    """
    data, values = fitted.solver.data, amendment.parameters
    if amendment.effect.place != "spot":
        return _is_within_cell(data, amendment)
    largest = amendment.effect.parameter("r").high - amendment.effect.sizes["r"]
    if values["r"] + 2 * amendment.stderr.get("r", 0.0) > largest:
        return True
    spot = np.array([[values["x"], values["y"]]])
    if data.arena.contains(spot)[0]:
        return False
    stands_out = values["r"] - float(data.barriers.distances(spot)[0])
    return stands_out < SCAN.nuisance.max_tolerances * data.tolerances.map * required_ratio(fitted, amendment)


def _is_within_cell(data: ScanData, amendment: Amendment) -> bool:
    """Return whether the walls that an effect moves, less twice its standard error, stay within a cell of the map."""
    effect = amendment.effect
    if data.grain <= 0 or effect.place == "obstacle" or effect.diagnostics.corner_shifts is None:
        return False
    scene = data.scene()
    before = scene.walls.copy()
    amendment(scene)
    shift = (scene.walls - before).reshape(-1, 2)
    if effect.place is None:
        shift = shift - shift.mean(axis=0)  # the poses absorb it
    return float(np.hypot(*shift.T).max()) - 2 * amendment.stderr.get("d", 0.0) < 2 * data.grain
