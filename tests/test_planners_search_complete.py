"""A search goes on after what it cannot get: past cells that nothing leads into, and out of traps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planners_samples import door_arena

from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.reach import Reach, reach
from planners.search.area import search_area
from planners.search.beam import beam_search, drive
from planners.search.kernel_goals import cell_distances
from planners.search.log_phases import missed
from planners.search.motion_primitives import MAX_DURATION, spin_primitives
from planners.search.nearest_goal import nearest_goal_search
from planners.search.room_drive import spin_curve
from planners.search.search import CoverageSearch, SearchStatus
from planners.search.settings import SearchSettings
from planners.types import Bools
from planners.vehicle import Limits

FLOOR = door_arena(9)  # one room, 16 x 12 cells
SHUT, OPEN = (5, 6), (13, 6)
"""A cell that is put out of reach, and one far behind it."""
START = np.array([0.625, 1.625, 0.0, 0.0])


def free_floor() -> Reach:
    return reach(FLOOR, Barriers(FLOOR), clearance=0.22, cell=0.25)


def searching(
    *cells: tuple[int, int], blocked: tuple[int, int] | None = None, rate: float = 10.0
) -> CoverageSearch:
    """Search the floor for all headings of some cells; `blocked` is kept shut by a wall that only its links ignore."""
    free = free_floor()
    need: Bools = np.zeros((*free.shape, 16), dtype=np.bool_)
    for cell in cells:
        need[cell] = True
    place = search_area(free)
    if blocked is not None:
        p, (i, k) = free.per_cell, blocked
        distance = place.distance.copy()
        distance[i * p : (i + 1) * p, k * p : (k + 1) * p] = 0.0
        place = replace(place, distance=distance)
    settings = SearchSettings(beam_width=20, goal_width=40)
    search = CoverageSearch(place, spin_primitives(Limits(), 16, rate), need, rate, settings=settings)
    search.start_at(START)
    return search


@pytest.mark.parametrize("rate", [40.0, 10.0, 5.0, 4.0, 3.0, 2.0, 1.0])
def test_a_log_of_any_rate_sees_the_bins_of_a_search(rate: float) -> None:
    """At 5 Hz and below, no primitive could stay in the middle half of a bin as long as was asked: nothing was covered."""
    search = searching(OPEN, (OPEN[0] + 1, OPEN[1]), rate=rate)
    assert search.run(lambda _: True) == SearchStatus.DONE
    assert search.come_to_rest()
    curve = spin_curve(search.result(), search.primitives, Limits().alpha)
    free, need = free_floor(), np.zeros((*free_floor().shape, 16), dtype=np.bool_)
    need[OPEN] = True
    grid = Coverage.empty(origin=free.origin, cell=free.cell, cells=need.any(axis=2), headings=16)
    assert missed(curve, need, grid, rate).sum() <= 1  # of 16, for the second try of a search


@pytest.mark.parametrize("rate", [10.0, 20.0, 40.0])
@pytest.mark.parametrize("headings", [8, 12, 16])
def test_sensors_that_are_fast_enough_have_the_usual_primitives(rate: float, headings: int) -> None:
    primitives = spin_primitives(Limits(), headings, rate)
    assert primitives.core_margin == 0.5
    assert primitives.unit <= MAX_DURATION
    assert primitives.core.mean() == 0.5


def test_what_lies_behind_a_cell_out_of_reach_is_still_driven_to() -> None:
    """A run alone stops before the nearest cell, which it cannot enter."""
    alone = searching(SHUT, OPEN, blocked=SHUT)
    alone.run(lambda _: True)
    assert alone.world.need[OPEN].all()
    search = searching(SHUT, OPEN, blocked=SHUT)
    search.complete(lambda _: True)
    assert not search.world.need.any()
    np.testing.assert_array_equal(np.argwhere(search.given_up.any(axis=2)), [SHUT])


def test_nothing_is_given_up_on_an_open_floor() -> None:
    search = searching(SHUT, OPEN)
    search.complete(lambda _: True)
    assert search.left == 0
    assert not search.given_up.any()


def test_done_is_said_when_all_is_met() -> None:
    assert searching(OPEN).run(lambda _: True) == SearchStatus.DONE


def test_a_search_that_was_compiled_compiles_nothing_more() -> None:
    search = searching(SHUT, OPEN)
    search.compile()
    kernels: list[Any] = [beam_search, drive, cell_distances, nearest_goal_search]
    before = [len(kernel.signatures) for kernel in kernels]
    assert min(before) > 0
    assert search.run(lambda _: True) == SearchStatus.DONE
    assert [len(kernel.signatures) for kernel in kernels] == before
