"""The cost-to-go map of a car: nought in a missing bin, endless behind a wall, and about the time it takes."""

from __future__ import annotations

import numpy as np
import pytest
from planners_samples import door_arena

from planners.cars.entry import state_at
from planners.clearance import Barriers
from planners.reach import reach
from planners.search.area import search_area
from planners.search.heuristic import UNREACHED, heuristic_buffers, time_to_goal, update_heuristic
from planners.search.motion_primitives import GEARS, car_primitives
from planners.search.search import CoverageSearch
from planners.search.settings import SearchSettings
from planners.types import Bools, Floats
from planners.vehicle import Limits

LIMITS = Limits(turning_radius=0.4)


def searching(door: float, *bins: tuple[int, int, int], drive: str = "reeds_shepp") -> CoverageSearch:
    arena = door_arena(door)
    free = reach(arena, Barriers(arena), clearance=0.22, cell=0.25)
    need: Bools = np.zeros((*free.shape, 16), dtype=np.bool_)
    need[tuple(np.array(bins).T)] = True
    primitives = car_primitives(LIMITS, 16, 10.0, GEARS[drive])
    search = CoverageSearch(
        search_area(free), primitives, need, 10.0, settings=SearchSettings(guided_width=60)
    )
    search.want(need, inner=False)
    return search


def away(search: CoverageSearch, pose: tuple[float, float, float], mode: int = 0) -> int:
    """Return the units of time from a pose to the nearest missing bin, seen from there."""
    state = state_at(search.primitives, np.array(pose))
    state[3] = mode
    heuristic = heuristic_buffers(search.settings, search.primitives, search.area)
    update_heuristic(state, search.world, heuristic)
    x, y, h, _ = state.tolist()
    return int(time_to_goal(x, y, int(h), mode, search.world, heuristic))


def test_in_a_missing_bin_nothing_is_left_to_drive() -> None:
    search = searching(9.0, (5, 5, 0))
    assert away(search, (1.375, 1.375, search.primitives.first_heading)) == 0


@pytest.mark.parametrize("metres", [0.5, 0.8, 1.1])
@pytest.mark.parametrize("gear", [0, 1])
def test_straight_ahead_takes_the_time_of_the_way_and_a_change_of_gear_what_it_costs(
    metres: float, gear: int
) -> None:
    """Forward into cell 8 (from x = 2.0) along its middle; in reverse it must first stop."""
    search = searching(9.0, (8, 5, 0))
    primitives = search.primitives
    pause = int((primitives.cost - primitives.cost.min(axis=0)).max())
    way = metres / (LIMITS.v * primitives.unit)
    found = away(search, (2.0 - metres, 1.375, primitives.first_heading), gear) - (pause if gear else 0)
    assert found == pytest.approx(way, abs=0.3 * way + 4)  # moves of whole lattice points, of two lengths


def test_a_heading_apart_is_farther_than_the_same_bin_ahead() -> None:
    """What a count of cells does not know: at the same place, turning round takes a car a shuffle."""
    here: Floats = np.array([1.375, 1.375])
    ahead, behind = searching(9.0, (5, 5, 1)), searching(9.0, (5, 5, 8))
    pose = (*here.tolist(), ahead.primitives.first_heading)
    assert 0 < away(ahead, pose) < away(behind, pose) / 3


def test_behind_a_closed_wall_it_is_endless() -> None:
    bins = (9, 5, 0)
    pose = (1.5, 1.375, 0.1)
    assert away(searching(0.0, bins), pose) == UNREACHED
    assert away(searching(9.0, bins), pose) < UNREACHED


def test_a_car_that_only_goes_forward_must_come_round() -> None:
    """The bin just behind it: a circle for Dubins, a change of gear for Reeds and Shepp."""
    pose = (1.6, 1.4, 0.05)
    back = {drive: searching(9.0, (4, 5, 0), drive=drive) for drive in ("reeds_shepp", "dubins")}
    seconds = {drive: away(search, pose) * search.primitives.unit for drive, search in back.items()}
    assert seconds["reeds_shepp"] < 3.0
    assert seconds["dubins"] > 0.8 * 2 * np.pi * 0.4 / LIMITS.v
