"""Test whether an effect exceeds the errors that the setup may have, given the tolerances of the fit."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc, chdtri

from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast, log_p_at
from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.places import obstacles
from sensorgraph.world.pixel_walls import MAX_STEP
from sensorgraph.world.robot import Tolerances

SURELY_MATERIAL = "surely_material"
"""Name of the rule that a size exceeds its materiality with sufficient probability."""


def is_map_error(fitted: Fitted, amendment: Amendment) -> bool:
    """Return whether a change of the building is within the errors of the map.

    This holds in three cases:

    - A wall or an obstacle moved by no more than the specified tolerance of the map.
    - A disc stands out of a mapped object by a small distance. A disc that may be as large as the largest disc also counts,
      because it was fitted to a flat object.
    - In an occupancy-grid map, an object moved by less than a cell, a wall segment is short, or an object that is
      reported missing stops most rays.
    """
    data, values = fitted.solver.data, amendment.parameters
    if amendment.effect.place != "spot":
        return _is_within_statement(data, amendment) or (
            data.grain > 0 and _is_within_pixels(data, amendment)
        )
    largest = amendment.effect.parameter("r").high - amendment.effect.sizes["r"]
    if values["r"] + 2 * amendment.stderr.get("r", 0.0) > largest:
        return True
    spot = np.array([[values["x"], values["y"]]])
    stands_out = values["r"] - float(data.barriers.distances(spot)[0])
    if stands_out > 0 and data.grain > 0 and _seen_before_walls(fitted, amendment) < _bulge(data):
        return True
    if data.arena.contains(spot)[0]:
        return False
    return stands_out < SCAN.naming.map_sigmas * data.tolerances.map * required_ratio(fitted, amendment)


def _is_within_statement(data: ScanData, amendment: Amendment) -> bool:
    """Return whether a move is within the specified map tolerance, at the confidence level of a single parameter's bound.

    In a map of many objects the one with the largest error is tested, so each may be off by more (Bonferroni).
    """
    effect = amendment.effect
    if not data.stated_map or effect.place is None or effect.diagnostics.corner_shifts is None:
        return False
    n_things = data.arena.n_walls if effect.place == "wall" else len(obstacles(data.arena))
    chance = chdtrc(1, SCAN.nuisance.max_tolerances**2) / max(n_things, 1)
    moved = np.hypot.reduce([amendment[name] for name in effect.steps])
    return bool(moved < data.stated_map * np.sqrt(chdtri(len(effect.steps), chance)))


def _bulge(data: ScanData) -> float:
    """Return the maximum distance [m] by which an object may stand out of the walls of an occupancy-grid map."""
    return SCAN.naming.map_pixels * 2 * data.grain


def _seen_before_walls(fitted: Fitted, amendment: Amendment) -> float:
    """Return the maximum distance [m] from mapped walls of readings on a disc; 0 without such readings."""
    data, values = fitted.solver.data, amendment.parameters
    scene = data.scene()
    scene.run((*data.known, *(a for a in fitted.model if a != amendment)))
    beams = bare_cast(scene)
    ahead, aside = beams.towards(values["x"], values["y"])
    reach = ahead - np.sqrt(np.maximum(values["r"] ** 2 - aside**2, 0.0))
    meets = (np.abs(aside) < values["r"]) & (reach > 0) & (reach < beams.ranges)
    z = np.where(data.returned, data.ranges, np.nan)
    meets &= np.abs(z - reach) < np.abs(z - beams.ranges)
    x, y = beams.ox + reach * beams.ux, beams.oy + reach * beams.uy
    points = np.stack([x[meets], y[meets]], axis=1)
    return float(data.barriers.distances(points).max(initial=0.0))


def _is_within_pixels(data: ScanData, amendment: Amendment) -> bool:
    """Return whether a change of the walls in an occupancy-grid map is within the size of its cells or its standard errors.

    A wall and the object next to it may each be off by half a cell.
    """
    values, pixel, effect = amendment.parameters, 2 * data.grain, amendment.effect
    if effect.on_part_of_wall:
        back = effect.diagnostics.stands_back
        return is_short_of_pixels(data, amendment) or (back is not None and back(amendment) < 2 * pixel)
    if effect.place in ("wall", "obstacle") and effect.steps:
        size = float(np.hypot.reduce([values[name] for name in effect.steps]))
        error = float(np.hypot.reduce([amendment.stderr.get(name, 0.0) for name in effect.steps]))
        return size - 2 * error < pixel or (effect.place == "wall" and _is_where_another_is(data, amendment))
    if effect.place is None and effect.diagnostics.corner_shifts is not None:
        return _farthest_corner(data, amendment) < MAX_STEP * 2 * data.grain
    return effect.place == "obstacle" and _passed_share(data, amendment.place) < SCAN.naming.min_passed_share


def _is_where_another_is(data: ScanData, amendment: Amendment) -> bool:
    """Return whether most of a moved wall coincides, within a pixel, with another wall of the map."""
    scene = data.scene()
    amendment(scene)
    first, last = scene.walls[data.arena.names.index(amendment.place)]
    along = np.linspace(0.1, 0.9, 9)[:, None]
    return float(np.median(data.barriers.distances(first + along * (last - first)))) < 2 * data.grain


def is_short_of_pixels(data: ScanData, amendment: Amendment) -> bool:
    """Return whether a wall segment in an occupancy-grid map is as short as an error at a corner."""
    values = amendment.parameters
    return amendment.effect.on_part_of_wall and values["b"] - values["a"] < 2 * _bulge(data)


def _farthest_corner(data: ScanData, amendment: Amendment) -> float:
    """Return the maximum displacement [m] of a corner along x or y by a change of the whole map, without the mean shift."""
    scene = data.scene()
    before = scene.walls.copy()
    amendment(scene)
    shift = (scene.walls - before).reshape(-1, 2)
    return float(np.abs(shift - shift.mean(axis=0)).max())


def _passed_share(data: ScanData, place: str) -> float:
    """Return the share of the rays aimed at an obstacle of the map that read a larger range."""
    own = np.array([name.split("/")[0] == place for name in data.arena.names])
    expected, wall = data.plain_cast
    aimed = (wall >= 0) & own[wall] & ~np.isnan(data.ranges)
    passed = aimed & (data.ranges > expected + 4 * data.grain)
    return float(passed.sum() / max(aimed.sum(), 1))


def changes_too_few(fitted: Fitted, amendment: Amendment) -> bool:
    """Return whether an effect without a size explains too few readings, as with a cut-off next to the specified one."""
    if amendment.effect.sizes or amendment.effect.diagnostics.is_lattice:
        return False
    data = fitted.solver.data
    rest = tuple(a for a in fitted.model if a != amendment)
    better = log_p_at(data, fitted.model, fitted.state) - log_p_at(data, rest, fitted.state)
    settings = SCAN.goodness_of_fit
    return float((better > settings.clearly_better).mean()) < settings.min_share


def required_ratio(fitted: Fitted, amendment: Amendment) -> float:
    """Return the minimum size of an effect in materialities: more for wide specified tolerances, or if the fit widened them."""
    proved = max(1.0, fitted.state.map_scale, fitted.state.pose_scale)
    usual, told = prior_widths(Tolerances()), prior_widths(fitted.solver.data.tolerances)
    return proved * float((told / usual)[list(amendment.effect.nuisances)].max(initial=1.0))
