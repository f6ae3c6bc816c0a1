"""Words of Reeds and Shepp, and of Dubins: they lead to the goal, and are as short as OMPL's."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from ompl import base as ob

from planners.arena import wrap
from planners.cars.reeds_shepp import MAX_ARCS, Arcs, arc_end, empty_arcs, quickest_word, take_arcs
from planners.types import Floats

RADIUS = 0.4
POSES = np.random.default_rng(11).uniform(-1.5, 1.5, (400, 2, 3)) * [1.0, 1.0, 2.0]


def word(
    start: Floats,
    goal: Floats,
    *,
    can_reverse: bool,
    before: int = 0,
    after: int = 0,
    pause: float = 0.0,
    shortest: float = 0.0,
) -> Arcs:
    room = empty_arcs(MAX_ARCS)
    ends = tuple(start.tolist()), tuple(goal.tolist())
    n = quickest_word(*ends, RADIUS, before, after, pause, can_reverse, shortest, 0, np.empty(MAX_ARCS), room)
    assert n >= 0, "there is no such word"
    return take_arcs(room, slice(n))


def driven(start: Floats, arcs: Arcs) -> Floats:
    here = tuple(start.tolist())
    for length, bend, gear in zip(*arcs, strict=True):
        here = arc_end(here, float(length), int(bend), int(gear), RADIUS)
    return np.array(here)


def cost(arcs: Arcs, before: int, after: int, pause: float) -> float:
    gears = [gear for gear in (before, *arcs.gear.tolist(), after) if gear]
    return float(arcs.length.sum()) + pause * sum(one != other for one, other in pairwise(gears))


@pytest.mark.parametrize("can_reverse", [True, False])
def test_a_word_leads_to_the_goal(can_reverse: bool) -> None:
    for start, goal in POSES:
        end = driven(start, word(start, goal, can_reverse=can_reverse, before=1, after=1, pause=0.24))
        np.testing.assert_allclose(end[:2], goal[:2], atol=1e-12)
        assert abs(wrap(end[2] - goal[2])) < 1e-12


@pytest.mark.parametrize("can_reverse", [True, False])
def test_without_a_price_of_stopping_it_is_as_long_as_that_of_ompl(can_reverse: bool) -> None:
    kind = ob.ReedsSheppStateSpace if can_reverse else ob.DubinsStateSpace
    space = kind(RADIUS)
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(-10)
    bounds.setHigh(10)
    space.setBounds(bounds)
    one, other = space.allocState(), space.allocState()
    for start, goal in POSES:
        for state, pose in ((one, start), (other, goal)):
            state.setXY(pose[0], pose[1])
            state.setYaw(pose[2])
        length = word(start, goal, can_reverse=can_reverse).length.sum()
        assert length == pytest.approx(space.distance(one, other), abs=1e-12)


def test_a_price_of_stopping_is_worth_its_longer_way_and_never_saves_length() -> None:
    stops = []
    for start, goal in POSES:
        for before, after in ((1, 1), (-1, 1)):
            priced = word(start, goal, can_reverse=True, before=before, after=after, pause=0.5)
            short = word(start, goal, can_reverse=True)
            assert cost(priced, before, after, 0.5) <= cost(short, before, after, 0.5) + 1e-12
            assert priced.length.sum() >= short.length.sum() - 1e-12
            stops.append(cost(short, before, after, 1.0) - cost(priced, before, after, 1.0))
    assert np.mean(stops) > 0


def test_no_arc_is_shorter_than_asked() -> None:
    room, space = empty_arcs(MAX_ARCS), np.empty(MAX_ARCS)
    found = 0
    for start, goal in POSES.tolist():
        for can_reverse in (True, False):
            ends = tuple(start), tuple(goal)
            n = quickest_word(*ends, RADIUS, 0, 0, 0.0, can_reverse, 0.05, 0, space, room)
            found += n >= 0
            assert n < 0 or room.length[:n].min() >= 0.05
    assert found > 1.9 * len(POSES)


def test_straight_ahead_is_one_arc_and_where_it_stands_none() -> None:
    start = np.array([0.3, -0.2, 0.7])
    ahead = start + [0.5 * np.cos(0.7), 0.5 * np.sin(0.7), 0.0]
    (length,), (bend,), (gear,) = word(start, ahead, can_reverse=True)
    assert (length, bend, gear) == (pytest.approx(0.5), 0, 1)
    (length,), (bend,), (gear,) = word(ahead, start, can_reverse=True)
    assert (length, bend, gear) == (pytest.approx(0.5), 0, -1)
    assert len(word(start, start, can_reverse=True).length) == 0
