"""Whether an effect is more than the set-up may hide, by the tolerances that the fit has found."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from sensorgraph.diagnosis.scan.fit import Fitted, bare_cast, log_p_at
from sensorgraph.diagnosis.scan.nuisance import prior_widths
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.places import obstacles
from sensorgraph.world.pixel_walls import MAX_STEP
from sensorgraph.world.robot import Tolerances


def is_map_error(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether a change of the building is no more than the map may be wrong there.

    An obstacle stands out of a mapped one by so little, or is a wall: a disc that may be as large as discs are has been fitted
    to something flat. In a map of pixels, something moves by less than a cell, a part of a wall is short, what is said to be
    gone stops most rays. A wall or an obstacle has moved by no more than the map is stated to be off.
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
    """Tell whether a move is within the stated tolerance of the map, at the confidence at which one number is bounded.

    Of a map of many things the one that is off the most is asked about, so each may be off by more (Bonferroni).
    """
    effect = amendment.effect
    if not data.stated_map or effect.place is None or effect.diagnostics.corner_shifts is None:
        return False
    n_things = data.arena.n_walls if effect.place == "wall" else len(obstacles(data.arena))
    chance = chi2.sf(SCAN.nuisance.max_tolerances**2, 1) / max(n_things, 1)
    moved = np.hypot.reduce([amendment[name] for name in effect.steps])
    return bool(moved < data.stated_map * np.sqrt(chi2.isf(chance, len(effect.steps))))


def _bulge(data: ScanData) -> float:
    """Return how far a thing may stand out of the walls of a map of pixels and be no more than its cells leave open [m]."""
    return SCAN.naming.map_pixels * 2 * data.grain


def _seen_before_walls(fitted: Fitted, amendment: Amendment) -> float:
    """Return how far from mapped walls readings end on a disc at most [m]; where none does, it may have any shape."""
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
    """Tell whether a change of the walls in a map of pixels is of the size of its cells, or not surely of more.

    A wall and what stands beside it may be off by half a cell each.
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
    """Tell whether a wall has moved to where the map has another one, within a pixel, along most of it."""
    scene = data.scene()
    amendment(scene)
    first, last = scene.walls[data.arena.names.index(amendment.place)]
    along = np.linspace(0.1, 0.9, 9)[:, None]
    return float(np.median(data.barriers.distances(first + along * (last - first)))) < 2 * data.grain


def is_short_of_pixels(data: ScanData, amendment: Amendment) -> bool:
    """Tell whether a part of a wall in a map of pixels is no longer than an error at a corner looks."""
    values = amendment.parameters
    return amendment.effect.on_part_of_wall and values["b"] - values["a"] < 2 * _bulge(data)


def _farthest_corner(data: ScanData, amendment: Amendment) -> float:
    """Return how far a change of the whole map moves a corner along x or y at most [m], but for a shift of all of them."""
    scene = data.scene()
    before = scene.walls.copy()
    amendment(scene)
    shift = (scene.walls - before).reshape(-1, 2)
    return float(np.abs(shift - shift.mean(axis=0)).max())


def _passed_share(data: ScanData, place: str) -> float:
    """Return the share of the rays aimed at an obstacle of the map that read farther."""
    own = np.array([name.split("/")[0] == place for name in data.arena.names])
    expected, wall = data.plain_cast
    aimed = (wall >= 0) & own[wall] & ~np.isnan(data.ranges)
    passed = aimed & (data.ranges > expected + 4 * data.grain)
    return float(passed.sum() / max(aimed.sum(), 1))


def changes_too_few(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an effect without a size explains fewer readings than a user would mind: a cut-off next to the stated one."""
    if amendment.effect.sizes or amendment.effect.diagnostics.is_lattice:
        return False
    data = fitted.solver.data
    rest = tuple(a for a in fitted.model if a != amendment)
    better = log_p_at(data, fitted.model, fitted.state) - log_p_at(data, rest, fitted.state)
    settings = SCAN.goodness_of_fit
    return float((better > settings.clearly_better).mean()) < settings.min_wrong_share


def required_ratio(fitted: Fitted, amendment: Amendment) -> float:
    """Return how many materialities an effect must have: more, where tolerances are stated wider, or proved too tight."""
    scale = max(fitted.state.map_scale, fitted.state.pose_scale)
    is_stretched = scale > SCAN.nuisance.stretched_scale
    proved = SCAN.naming.stretched_factor * scale if is_stretched else max(1.0, scale)
    usual, told = prior_widths(Tolerances()), prior_widths(fitted.solver.data.tolerances)
    return proved * float((told / usual)[list(amendment.effect.nuisances)].max(initial=1.0))
