"""A car that starts at a round pose does not drive along the borders of bins, where rounding says which bin is logged."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import shapely
from planners_samples import outlined

from planners import plan
from planners.arena import Arena, wrap
from planners.cars.car_curve import curve_of_arcs
from planners.cars.entry import EntryArc, entry_arc, shortest_entry_arc
from planners.clearance import Barriers
from planners.coverage import Coverage
from planners.reach import reach
from planners.search.area import SearchArea, search_area
from planners.search.motion_primitives import GEARS, car_primitives
from planners.types import Floats
from planners.vehicle import Drive, Limits, Vehicle

LIMITS = Limits(turning_radius=0.4)
ROOM = outlined(shapely.box(0, 0, 3, 2.5))
CARS: tuple[Drive, ...] = ("reeds_shepp", "dubins")


def floor(arena: Arena) -> SearchArea:
    """Make the search area of a room."""
    return search_area(reach(arena, Barriers(arena), clearance=0.22, cell=0.5))


def entered(pose: Floats, drive: Drive) -> EntryArc | None:
    """Return the arc in ROOM."""
    return shortest_entry_arc(pose, floor(ROOM), car_primitives(LIMITS, 8, 10.0, GEARS[drive]), 10.0, LIMITS)


def driven(begun: EntryArc) -> Floats:
    """Return poses (n, 3) along the arc."""
    length, bend, gear = (np.array([part]) for part in (begun.length, begun.bend, begun.gear))
    curve = curve_of_arcs(begun.pose, length, bend, gear, LIMITS)
    return curve.sample(np.linspace(0.0, curve.duration, 50))[0]


@pytest.mark.parametrize("drive", CARS)
@pytest.mark.parametrize("headings", [4, 6, 7, 8, 9, 16, 36])
@pytest.mark.parametrize("radius", [0.25, 0.4, 0.9])
def test_no_straight_piece_runs_along_a_border(drive: Drive, headings: int, radius: float) -> None:
    """Neither of a heading bin nor of a cell, which lie along the axes."""
    primitives = car_primitives(Limits(turning_radius=radius), headings, 10.0, GEARS[drive])
    phi = primitives.first_heading + primitives.heading_step * np.arange(primitives.n_headings)
    borders = [*((np.arange(headings) - 0.5) * 2 * np.pi / headings), *(np.arange(4) * np.pi / 2)]
    nearest = np.abs(wrap(np.subtract.outer(phi, borders))).min()
    assert nearest > 0.12 * primitives.heading_step


@pytest.mark.parametrize("drive", CARS)
def test_from_any_heading_the_shortest_arc_comes_to_one_of_the_table(drive: Drive) -> None:
    for turn in np.random.default_rng(3).uniform(-4, 4, 12):
        begun = entered(np.array([1.5, 1.25, turn]), drive)
        assert begun is not None
        primitives = begun.primitives
        x, y, h, m = begun.state
        np.testing.assert_allclose(driven(begun)[-1, :2], [x, y], atol=1e-12)
        assert (
            abs(wrap(driven(begun)[-1, 2] - primitives.first_heading - primitives.heading_step * h)) < 1e-12
        )
        assert np.sign(primitives.speeds[int(m)]) == begun.gear
        assert begun.length <= 0.5 * primitives.heading_step * LIMITS.turning_radius + 1e-12


def test_a_heading_of_the_table_is_kept() -> None:
    primitives = car_primitives(LIMITS, 8, 10.0, GEARS["reeds_shepp"])
    begun = entered(
        np.array([1.5, 1.25, primitives.first_heading + 5 * primitives.heading_step - 2 * np.pi]),
        "reeds_shepp",
    )
    assert begun is not None
    assert begun.length == 0
    np.testing.assert_array_equal(begun.state, [1.5, 1.25, 5, 0])


def test_beside_a_wall_the_arc_leads_away_from_it() -> None:
    """Just clear of a wall along x, on the car's right: it turns left going forward, or comes back from a left arc."""
    away = {}
    for y in (0.2201, 2.2799):
        begun = entered(np.array([1.5, y, 0.0]), "reeds_shepp")
        assert begun is not None
        assert (abs(driven(begun)[:, 1] - 1.25) <= abs(y - 1.25) + 1e-12).all()
        away[y] = begun.bend * begun.gear
    assert away[0.2201] == -away[2.2799]


def test_where_a_car_can_only_run_into_a_corner_it_enters_nothing() -> None:
    pose = np.array([0.2201, 0.3, -2.4])
    assert entered(pose, "dubins") is None
    back = entered(pose, "reeds_shepp")
    assert back is not None
    assert back.gear == -1


def test_in_a_corridor_that_just_holds_it_a_car_that_cannot_back_keeps_its_heading() -> None:
    """Two rooms with a corridor 0.47 m wide between them, which only a straight drive leads through."""
    around = [shapely.box(1.6, 0, 3.5, 0.5), shapely.box(1.6, 0.97, 3.5, 1.6)]
    corridor = outlined(shapely.box(0, 0, 5, 1.6).difference(shapely.union_all(around)))
    for arena, x, kept in ((corridor, 2.5, True), (ROOM, 1.3, False)):
        begun = entry_arc(np.array([x, 0.735, 0.0]), floor(arena), LIMITS, 8, 10.0, GEARS["dubins"])
        phi = begun.primitives.first_heading + begun.primitives.heading_step * float(begun.state[2])
        assert (begun.length == 0.0) is kept
        assert bool(abs(wrap(np.float64(phi))) < 1e-12) is kept


ROUND: list[tuple[Drive, tuple[float, float, float]]] = [
    ("reeds_shepp", (1.0, 1.0, np.pi / 2)),
    ("reeds_shepp", (1.5, 1.0, np.pi / 8)),
    ("dubins", (2.0, 1.0, 0.0)),
    ("dubins", (1.5, 1.0, np.pi / 8)),
]
"""Drives, and starts on the borders of cells, along an axis or the border of a heading bin."""


def test_the_bins_of_a_round_start_do_not_hang_on_rounding() -> None:
    does_not_hang_on_rounding("reeds_shepp", (0.5, 0.5, 0.0), (2.5, 2.0))


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "start"), ROUND)
def test_the_bins_of_any_round_start_do_not_hang_on_rounding(
    drive: Drive, start: tuple[float, float, float]
) -> None:
    does_not_hang_on_rounding(drive, start, (4.0, 3.0))


def does_not_hang_on_rounding(
    drive: Drive, start: tuple[float, float, float], size: tuple[float, float]
) -> None:
    """Poses a micrometre and a microradian off count as those of the plan do."""
    room = outlined(shapely.box(0, 0, *size))
    made = plan(room, Vehicle(drive=drive, limits=LIMITS), start=np.array(start), cell=0.5, headings=8)
    assert made.report["coverage"] >= 0.99
    np.testing.assert_allclose(made.trajectory.poses[0], start, atol=1e-12)
    grid, log = made.coverage, made.curve.log(10.0)
    for shift in product((-1e-6, 0.0, 1e-6), repeat=3):
        none = np.zeros_like(grid.counts)
        again = Coverage(
            origin=grid.origin, cell=grid.cell, reachable=grid.reachable, counts=none, core=none.copy()
        )
        again.add(log + np.array(shift))
        assert again.fraction == grid.fraction
