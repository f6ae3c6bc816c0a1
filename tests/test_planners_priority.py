"""Bands keep what is in one piece in one piece, rooms and cells come in the order of their priority."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from planners_samples import door_arena

from planners import plan
from planners.coverage import Coverage
from planners.planning import Plan
from planners.priority import BANDS, MEDIAN_RADIUS, VALUE_RANGE, bin_values, cell_bands, mean, room_bands
from planners.types import Floats
from planners.vehicle import Drive, Limits, Vehicle

pytestmark = pytest.mark.usefixtures("narrow_search")

SHAPE = (9, 7, 3)
PRIORITIES = arrays(np.float64, SHAPE, elements=st.floats(0.0, 1.0))
TODO = arrays(np.bool_, SHAPE)


def test_without_a_priority_all_is_one() -> None:
    todo = np.ones(SHAPE, dtype=np.bool_)
    assert not cell_bands(None, todo, 0.25).any()
    assert (bin_values(None, todo) == 1.0).all()
    assert not room_bands(None, todo, [todo[:, :, 0]]).any()
    even = np.full(SHAPE, 0.3)
    assert len(np.unique(cell_bands(even, todo, 0.25))) == 1
    assert len(np.unique(bin_values(even, todo))) == 1
    assert not room_bands(even, todo, [todo[:, :, 0], todo[:, :, 0]]).any()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_straight_border_of_priority_is_one_of_bands(axis: int) -> None:
    priority, todo = np.zeros((20, 20, 4)), np.ones((20, 20, 4), dtype=np.bool_)
    high = np.moveaxis(np.broadcast_to(np.arange(20)[:, None] >= 12, (20, 20)), 0, axis)
    priority[high] = 1.0
    band = cell_bands(priority, todo, 0.25)
    assert band[high].max() < band[~high].min()


def test_single_cells_of_another_priority_do_not_part_a_band() -> None:
    priority, todo = np.zeros((20, 20, 4)), np.ones((20, 20, 4), dtype=np.bool_)
    priority[10:] = 1.0
    plain = cell_bands(priority, todo, 0.25)
    priority[3, 4], priority[15, 16] = 1.0, 0.0
    np.testing.assert_array_equal(cell_bands(priority, todo, 0.25), plain)


@given(priority=PRIORITIES, todo=TODO)
@settings(max_examples=60, deadline=None)
def test_the_band_of_a_cell_is_the_median_round_it(priority: Floats, todo: np.ndarray) -> None:
    cell = MEDIAN_RADIUS / 2
    band = cell_bands(priority, todo, cell)
    cells, score = todo.any(axis=2), mean(priority, todo)
    assert not band[~cells].any()
    if not cells.any():
        return
    marks = sorted({float(np.quantile(score[cells], k / BANDS)) for k in range(1, BANDS)})
    own = {(i, k): -sum(score[i, k] > mark for mark in marks) for i, k in np.argwhere(cells).tolist()}
    for i, k in own:
        near = sorted(
            value for (a, b), value in own.items() if np.hypot(a - i, b - k) <= MEDIAN_RADIUS / cell
        )
        assert band[i, k] == near[(len(near) - 1) // 2]


@given(priority=PRIORITIES, todo=TODO)
@settings(max_examples=60, deadline=None)
def test_a_cell_of_higher_priority_is_worth_more(priority: Floats, todo: np.ndarray) -> None:
    value, cells = bin_values(priority, todo), todo.any(axis=2)
    assert (value[~cells] == 1.0).all()
    score, own = mean(priority, todo)[cells], value[cells]
    order = np.argsort(score)
    assert (np.diff(own[order]) >= 0).all()
    if len(np.unique(score)) > 1:
        assert (own.min(), own.max()) == (1.0, 1.0 + VALUE_RANGE)


def test_rooms_come_by_what_is_wanted_in_them() -> None:
    priority, todo = np.zeros(SHAPE), np.ones(SHAPE, dtype=np.bool_)
    rooms = [np.zeros(SHAPE[:2], dtype=np.bool_) for _ in range(3)]
    for own, where in zip(rooms, (slice(0, 3), slice(3, 6), slice(6, 9)), strict=True):
        own[where] = True
    priority[3:6], priority[6:] = 1.0, 0.5
    first, second, third = room_bands(priority, todo, rooms).tolist()
    assert second < third < first
    todo[3:6] = priority[3:6] < 0.5  # nothing is left there
    first, second, third = room_bands(priority, todo, rooms).tolist()
    assert third < first == second


def early(made: Plan, priority: Floats) -> float:
    """Return the share of the wanted priority that is met within half of the reference time."""
    grid = made.coverage
    half = Coverage.empty(
        origin=grid.origin, cell=grid.cell, cells=grid.reachable.any(axis=2), headings=grid.headings
    )
    half.add(made.curve.log(10.0)[: int(5.0 * made.report["t_ref_s"])])
    return float(priority[half.covered & grid.reachable].sum() / priority[grid.reachable].sum())


@pytest.mark.parametrize(
    "drive", ["diff", *(pytest.param(car, marks=pytest.mark.slow) for car in ("reeds_shepp", "dubins"))]
)
def test_all_drives_meet_first_what_has_priority(drive: Drive) -> None:
    vehicle = Vehicle(drive=drive, limits=Limits(turning_radius=0.0 if drive == "diff" else 0.3))
    start = np.array([0.8, 0.8, 0.3])
    without = plan(door_arena(1.2), vehicle, cell=0.4, headings=8, start=start)
    left, right = np.zeros((2, *without.coverage.counts.shape))
    left[: len(left) // 2], right[len(right) // 2 :] = 1.0, 1.0
    by_left, by_right = (
        plan(door_arena(1.2), vehicle, cell=0.4, headings=8, start=start, priority=own)
        for own in (left, right)
    )
    assert early(by_left, left) > early(by_right, left) + 0.25
    assert early(by_right, right) > early(by_left, right) + 0.25
    for made in (by_left, by_right):
        assert made.report["drive_time_s"] < 1.25 * without.report["drive_time_s"]
        assert made.report["coverage"] > 0.995
