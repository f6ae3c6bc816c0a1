"""Changes of a place: for a while or for good, in cells and as things, and things that have moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from localization_samples import ROOM, loop_poses, room_run
from watching_samples import believing, graph

import sensorgraph as sg
from sensorgraph.watching.place import distance_to_outline
from sensorgraph.watching.place_cells import ChangeCells, ThingCells
from sensorgraph.watching.place_changes import PlaceChange, moved_things, things_in
from sensorgraph.watching.settings import PLACE
from sensorgraph.watching.status import WatchStatus

AREA = 100.0
"""[m²] of a place."""


def after_sights(*times: float, nats: float = 3.0, n: int = 10) -> float:
    """Return the probability of a change after sights at some times [s], each of n scans within a second."""
    cells = ChangeCells(1, PLACE)
    for time in times:
        for k in range(n):
            cells.add(np.array([0]), np.array([nats]), time + k / n)
    return float(cells.p(np.array([0]))[0])


def test_one_sight_is_a_change_for_a_while_or_for_good_by_their_priors_however_many_readings_it_has() -> None:
    prior = PLACE.changed / (PLACE.changed + PLACE.for_a_while)
    assert after_sights(0.0, n=3) == pytest.approx(prior, abs=0.02)
    assert after_sights(0.0, n=1000) == pytest.approx(prior, abs=0.02)


def test_sights_count_by_the_time_between_them() -> None:
    assert after_sights(0.0, 5.0, 10.0) < 0.4 < 0.6 < after_sights(0.0, 60.0, 120.0)
    assert after_sights(0.0, 200.0, 400.0) > 0.95


def test_who_leaves_was_no_change_and_the_prior_returns() -> None:
    cells, one = ChangeCells(1, PLACE), np.array([0])
    for k in range(10):
        cells.add(one, np.array([3.0]), k / 10)
    for k in range(10):
        cells.add(one, np.array([-0.7]), 60.0 + k)
    assert cells.p(one)[0] < PLACE.changed
    assert cells.passes[0] == 1


def test_passes_on_two_sides_of_a_thing_show_it_though_they_meet_other_cells() -> None:
    shape = (20, 20)
    things = ThingCells(shape, PLACE)
    for time, x in ((0.0, 9), (200.0, 11), (400.0, 9), (600.0, 11)):
        side = np.ravel_multi_index(([x, x], [9, 10]), shape)
        things.add(side, np.full(2, 3.0), time)
    (change,) = things_in("new", things, shape, np.zeros(2), replace(PLACE, least_cells=1))[:1]
    assert change.passes >= 2


def change(kind: str, x: float, size: float = 0.3) -> PlaceChange:
    return PlaceChange(
        kind=kind, centre=np.array([x, 1.0]), size=np.full(2, size), outlines=(), first_seen=0.0, last_seen=9.0, passes=3, p=0.9
    )  # type: ignore[arg-type]  # fmt: skip


def test_a_thing_gone_here_and_new_there_of_like_size_has_moved() -> None:
    (thing,) = moved_things([change("gone", 0.0), change("new", 0.32)], AREA, PLACE)
    assert thing.distance == pytest.approx(0.32)
    assert thing.p > 0.9


@pytest.mark.parametrize(("x", "size"), [(3.0, 0.3), (1.0, 3.0)], ids=["far", "larger"])
def test_a_new_thing_that_is_far_or_much_larger_is_another(x: float, size: float) -> None:
    assert not moved_things([change("gone", 0.0), change("new", x, size)], AREA, PLACE)


def test_each_thing_moves_once_by_the_most_probable_assignment() -> None:
    changes = [change("gone", 0.0), change("gone", 0.5), change("new", 0.3), change("new", 0.8)]
    found = moved_things(changes, AREA, PLACE)
    assert [thing.distance for thing in found] == pytest.approx([0.3, 0.3])


def test_among_many_new_things_the_next_one_is_less_probably_the_same() -> None:
    near = [change("gone", 0.0), change("new", 0.5)]
    many = [*near, *(change("new", 20.0 + k) for k in range(9))]
    assert moved_things(many, AREA, PLACE)[0].p < moved_things(near, AREA, PLACE)[0].p


@pytest.mark.slow
def test_the_box_of_the_room_that_moved_is_one_change_with_its_distance() -> None:
    moved = [(a + 0.4, b, c + 0.4, d) for a, b, c, d in ROOM[-4:]]
    poses = loop_poses(480, laps=4)
    end = list(sg.watch(graph(), believing(room_run(poses, seed=19, walls=[*ROOM[:-4], *moved]), poses)))[-1]
    assert isinstance(end, WatchStatus)
    assert len(end.moved) == 1 and end.n_changes < len(end.changes)
    assert (
        0.1 < end.moved[0].distance < 0.4 + 0.95
    )  # the side that is gone and the new one are the box's width apart at most
    assert "1 moved (by 0." in end.sentences()[1]
    told = end.to_dict()["place"]["moved"][0]
    assert told["distance_m"] == pytest.approx(end.moved[0].distance, abs=1e-3)


def test_a_reading_at_grazing_incidence_is_off_the_wall_by_its_distance_to_the_wall_and_not_along_the_ray() -> (
    None
):
    bearings = np.linspace(0.05, 0.3, 20)
    wall = np.column_stack([1.0 / np.tan(bearings), np.ones(20)])
    short = 0.97 * wall  # a wall that is 3 cm nearer
    assert np.hypot(*(wall - short)[0]) > 0.5
    assert distance_to_outline(short, wall, np.ones(20, dtype=np.bool_))[:-1] == pytest.approx(0.03, abs=1e-9)
