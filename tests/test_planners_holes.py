"""Every bin is met, or missed for one reason that is said."""

from __future__ import annotations

import re

import numpy as np
import pytest
import shapely
from planners_samples import door_arena, outlined

from planners import plan
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.holes import count_unmet, cut_off, holes_csv, small_reach_warning, unmet
from planners.planning import Plan
from planners.reach import reach
from planners.vehicle import Limits, Vehicle


@pytest.fixture(scope="module")
def cut_short() -> Plan:
    """A Dubins car that has a quarter of a minute."""
    car = Vehicle(drive="dubins", limits=Limits(turning_radius=0.4))
    return plan(outlined(shapely.box(0, 0, 2.4, 2.0)), car, cell=0.5, headings=8, budget=15.0)


def test_every_bin_of_the_disc_is_met_or_has_one_reason(cut_short: Plan) -> None:
    grid, free = cut_short.coverage, cut_short.reach
    parts = [grid.covered, *unmet(grid, free, cut_short.lost).values()]
    told = np.sum(parts, axis=0)
    np.testing.assert_array_equal(told, np.repeat(free.cells()[:, :, None], grid.headings, axis=2))
    assert [bool(part.any()) for part in parts] == [True, False, True, True]


def test_the_list_of_holes_is_what_plan_json_counts(cut_short: Plan) -> None:
    rows = [
        line.split(",")
        for line in holes_csv(cut_short.coverage, cut_short.reach, cut_short.lost).splitlines()[1:]
    ]
    unreached = cut_short.report["unreached"]
    for why in ("no_way_found", "not_driven", "no_forward_drive_there_and_back"):
        assert sum(row[3] == why for row in rows) == unreached[why]
    missed = np.array([[float(value) for value in row[:3]] for row in rows if row[3] == "not_driven"])
    grid = cut_short.coverage
    bins, inside = grid.bins(missed)
    assert inside.all()
    assert grid.reachable[tuple(bins.T)].all() and not grid.covered[tuple(bins.T)].any()
    assert len(missed) == grid.reachable.sum() - grid.covered.sum()


def test_a_lost_bin_is_lost_only_as_long_as_it_is_not_met() -> None:
    arena = door_arena(9.0)
    free = reach(arena, Barriers(arena), clearance=0.22, cell=1.0)
    lost = np.zeros((4, 3, 4), dtype=bool)
    lost[0, 0, :2] = True
    grid = Coverage.empty(origin=free.origin, cell=1.0, cells=free.cells(), headings=4)
    grid.add(np.array([[0.5, 0.5, 0.0]]))
    found = count_unmet(grid, free, lost)
    assert (found["no_way_found"], found["not_driven"]) == (1, grid.reachable.sum() - 2)


def test_what_lies_behind_a_door_too_narrow_is_the_other_room() -> None:
    """Two rooms of 1.95 x 3 m; from the left one, the disc of 0.22 m fits in the right one on 1.51 x 2.56 m."""
    arena = door_arena(0.4)
    free = reach(arena, Barriers(arena), clearance=0.22, cell=0.25, start=np.array([0.5, 0.5]))
    behind = cut_off(free)
    assert behind.sum() * free.step**2 == pytest.approx(1.51 * 2.56, rel=0.02)
    assert (free.nodes(np.nonzero(behind))[:, 0] > 2.0).all()
    assert not (behind & free.mask).any()


def test_a_start_that_reaches_little_is_told_where_more_is_in_reach() -> None:
    """A closet of 0.56 x 2.56 m beside a room of 2.36 x 2.56 m, both for the disc's centre."""
    arena = outlined(shapely.box(0, 0, 4, 3).difference(shapely.box(1, 0, 1.2, 3)))
    barriers = Barriers(arena)
    closet = reach(arena, barriers, clearance=0.22, cell=0.25, start=np.array([0.5, 0.5]))
    said = small_reach_warning(closet)
    assert "the rest lies behind walls, no-go zones or gaps narrower than 0.44 m" in said
    found = re.search(r"only (\S+) % .* from (\S+),(\S+) it would be (\S+) %", said)
    assert found is not None
    small, *better, large = (float(number) for number in found.groups())
    assert small == pytest.approx(100 * 0.56 / 2.92, abs=1.0)  # the raster of 2 cm
    assert small + large == pytest.approx(100.0, abs=0.1)
    assert "start there" not in small_reach_warning(
        reach(arena, barriers, clearance=0.22, cell=0.25, start=np.array(better))
    )
