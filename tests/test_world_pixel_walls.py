"""Walls of a map of pixels: as near to surfaces as cells allow, round things round, jogs and names kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from conftest import polygon_arena

from planners.arena import Arena
from planners.maps.ros_map import _borders, _union
from sensorgraph.types import Floats
from sensorgraph.world.pixel_walls import OUTLINE, THING, is_near_gap, pixel_of, straightened

PIXEL = 0.05


def drawn(room: shapely.Polygon, *things: shapely.Polygon) -> Arena:
    """Draw a room and things into cells: occupied where a surface passes, free inside, else unknown."""
    low = np.array(room.bounds[:2]) - 4 * PIXEL
    shape = np.ceil((np.array(room.bounds[2:]) - low) / PIXEL).astype(int) + 4
    x, y = np.meshgrid(*(low[k] + PIXEL * (np.arange(shape[k]) + 0.5) for k in (0, 1)), indexing="ij")
    half = PIXEL / 2
    cells = shapely.box(x - half, y - half, x + half, y + half)
    surface = shapely.union_all([room.exterior, *(thing.exterior for thing in things)])
    occupied = shapely.intersects(cells, surface)
    inside = shapely.difference(room, shapely.union_all(list(things)))
    free = shapely.contains_xy(inside, x, y) & ~occupied
    walls = low + PIXEL * _borders(occupied)
    area = shapely.transform(_union(free), lambda c: low + PIXEL * c)
    n = len(walls)
    return Arena(
        free=area, walls=walls, names=tuple(f"map/edge_{i}" for i in range(n)), surfaces=("wall",) * n
    )


def turned(shape: shapely.Polygon, degrees: float) -> shapely.Polygon:
    return shapely.affinity.rotate(shape, degrees, origin=(0, 0))


def off(walls: Floats, surface: shapely.Geometry) -> Floats:
    """Return how far points along walls are from a surface [pixel]."""
    points = walls[:, :1] + np.linspace(0, 1, 9)[:, None] * (walls[:, 1:] - walls[:, :1])
    return np.asarray(shapely.distance(shapely.points(points.reshape(-1, 2)), surface) / PIXEL)


ROOM = shapely.box(0.013, 0.021, 6.02, 4.51)


@pytest.mark.parametrize("degrees", [0.0, 3.0, 17.0, 30.0, 45.0, 71.0])
def test_walls_are_half_a_pixel_from_their_surfaces_at_most_and_unbiased_where_they_slant(
    degrees: float,
) -> None:
    room = turned(ROOM, degrees)
    thing = turned(shapely.box(2.0, 2.0, 2.3, 2.6), degrees + 25)
    straight, _ = straightened(drawn(room, thing))
    around = straight.walls[[name.startswith(OUTLINE) for name in straight.names]]
    assert len(around) < 40
    length = np.hypot(*np.diff(around, axis=1)[:, 0].T)
    assert length.sum() == pytest.approx(room.exterior.length, rel=0.02)
    assert off(around[length > 0.5], room.exterior).max() < 0.75
    if degrees > 10:
        area = shapely.polygonize([shapely.union_all(shapely.linestrings(around))]).area
        assert abs(area - room.area) / room.exterior.length < 0.1 * PIXEL


@pytest.mark.parametrize("radius", [0.16, 0.27, 0.4, 1.0])
def test_round_things_are_round(radius: float) -> None:
    thing = shapely.Point(2.51, 2.03).buffer(radius, quad_segs=32)
    straight, _ = straightened(drawn(ROOM, thing))
    own = straight.walls[[name.startswith(THING) for name in straight.names]]
    away = off(own, thing.exterior)
    assert away.max() < 0.9 and np.sqrt(np.mean(away**2)) < 0.4
    assert shapely.polygonize([shapely.union_all(shapely.linestrings(own))]).area == pytest.approx(
        thing.area, rel=0.12
    )


def test_a_jog_of_one_pixel_keeps_a_corner_on_either_side() -> None:
    room = shapely.Polygon([(0, 0), (6, 0), (6, 4.03), (3.01, 4.03), (3.01, 4.06), (0, 4.06)])
    straight, _ = straightened(drawn(room))
    corners = straight.walls.reshape(-1, 2)
    at = corners[(np.abs(corners[:, 0] - 3.01) < 0.1) & (corners[:, 1] > 3.5)]
    assert len(np.unique(at.round(4), axis=0)) == 2


def test_what_stands_in_free_space_has_names_of_its_own_and_the_inside_of_walls_none() -> None:
    things = [shapely.box(1.0, 1.0, 1.4, 1.6), turned(shapely.box(3.0, -0.5, 3.8, 0.1), 35)]
    straight, _ = straightened(drawn(ROOM, *things))
    assert {name.split("/")[0] for name in straight.names} == {OUTLINE, f"{THING}1", f"{THING}2"}
    assert len(set(straight.names)) == straight.n_walls
    assert off(straight.walls, shapely.union_all([ROOM.exterior, *(t.exterior for t in things)])).max() < 1.2


def test_a_room_along_the_grid_has_hardly_more_walls_than_sides() -> None:
    arena = polygon_arena([(0, 0), (2, 0), (2, 1), (0, 1)])
    straight, _ = straightened(drawn(shapely.Polygon([(0, 0), (2, 0), (2, 1), (0, 1)])))
    assert straight.n_walls <= arena.n_walls + 4


def test_a_long_wall_stays_straight_where_something_touches_it() -> None:
    room = shapely.difference(ROOM, shapely.Point(4.1, 4.51).buffer(0.15))
    straight, _ = straightened(drawn(room))
    length = np.hypot(*np.diff(straight.walls, axis=1)[:, 0].T)
    top = straight.walls[(length > 1.5) & (straight.walls[:, :, 1].min(axis=1) > 4.3)]
    assert len(top) == 2
    assert np.abs(np.diff(top[:, :, 1], axis=1)).max() < 0.05 * PIXEL
    assert off(top, ROOM.exterior).max() < 0.6


def test_a_wall_one_cell_thin_is_one_wall() -> None:
    """Where the cells of a slanting wall touch by corners alone, its far side has the same outline in other rings."""
    room = turned(ROOM, 3.0)
    straight, _ = straightened(drawn(room))
    length = np.hypot(*np.diff(straight.walls, axis=1)[:, 0].T)
    assert length.sum() == pytest.approx(room.exterior.length, rel=0.02)
    assert len(straight.walls) < 12


def test_a_niche_one_cell_wide_stays_open() -> None:
    niche = shapely.box(3.02, 4.4, 3.13, 4.81)
    straight, _ = straightened(drawn(shapely.union_all([ROOM, niche])))
    mouth = shapely.LineString([(3.075, 4.4), (3.075, 4.7)])
    assert not shapely.intersects(shapely.multilinestrings(list(straight.walls)), mouth)


def test_a_slit_that_cells_close_may_be_open() -> None:
    slit = shapely.box(3.0, 4.4, 3.1, 5.2)
    arena = drawn(shapely.union_all([ROOM, slit]))
    near, far = is_near_gap(arena, np.array([[3.05, 4.9], [1.0, 1.0]]))
    assert not far
    parts = shapely.get_parts(arena.free)
    assert near == (len(parts) > 1)


@pytest.mark.parametrize("degrees", [0.0, 20.0])
def test_cells_in_a_row_are_a_wall_through_them(degrees: float) -> None:
    """A thin partition that stands free: each step of its two sides, a cell apart, was a wall."""
    thin = turned(shapely.box(2.0, 2.02, 3.2, 2.021), degrees)
    straight, _ = straightened(drawn(ROOM, thin))
    own = straight.walls[[name.startswith(THING) for name in straight.names]]
    assert len(own) == (3 if degrees else 1)
    assert off(own, thin.exterior).max() < 0.75
    assert np.hypot(*(own[0, 1] - own[0, 0])) == pytest.approx(1.2, abs=2 * PIXEL)


def test_a_few_cells_have_the_corners_of_their_outline() -> None:
    straight, _ = straightened(drawn(ROOM, shapely.box(2.01, 2.01, 2.02, 2.02)))
    assert sum(name.startswith(THING) for name in straight.names) == 4


def test_what_is_as_long_as_a_building_is_no_thing_and_the_outline_comes_first() -> None:
    """Effects take all names but the first wall's for things that may be moved."""
    core, table = shapely.box(1.0, 1.0, 5.2, 1.6), shapely.box(2.0, 3.0, 3.2, 3.6)
    straight, _ = straightened(drawn(ROOM, core, table))
    features = dict.fromkeys(name.rsplit("/", 1)[0] for name in straight.names)
    assert list(features) == [OUTLINE, f"{THING}1"]


def test_the_width_of_a_cell_is_known_though_no_border_is_that_short() -> None:
    drawn_with_the_grid = drawn(ROOM, shapely.box(1.0, 1.0, 5.2, 1.6))
    length = np.hypot(*np.diff(drawn_with_the_grid.walls, axis=1)[:, 0].T)
    assert length.min() > 5 * PIXEL
    assert pixel_of(drawn_with_the_grid) == pytest.approx(PIXEL)


def test_a_map_whose_origin_is_turned_has_the_same_walls() -> None:
    """map_server turns the cells of a map by the yaw of its origin."""
    plain = drawn(turned(ROOM, 12.0), turned(shapely.Point(2.5, 2.0).buffer(0.3), 12.0))
    yaw = np.radians(25.0)
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    other = replace(
        plain, walls=plain.walls @ turn, free=shapely.transform(plain.free, lambda points: points @ turn)
    )
    (straight, rms), (also, same) = straightened(plain), straightened(other)
    assert also.names == straight.names and same == pytest.approx(rms)
    np.testing.assert_allclose(also.walls, straight.walls @ turn, atol=1e-6)


@pytest.mark.parametrize("depth", [0.15, 0.2])
def test_a_long_wall_between_two_jogs_is_one_wall_and_not_round(depth: float) -> None:
    """Such a niche lies within a pixel of a large circle; its wall was cut into pieces of 10 cm."""
    room = shapely.Polygon(
        [(0, 0), (6, 0), (6, 4), (4.6, 4), (4.6, 4 + depth), (2.9, 4 + depth), (2.9, 4), (0, 4)]
    )
    straight, _ = straightened(drawn(room))
    length = np.hypot(*np.diff(straight.walls, axis=1)[:, 0].T)
    back = np.abs(straight.walls[..., 1].mean(axis=1) - 4 - depth) < PIXEL
    assert length[back].max() == pytest.approx(1.7, abs=4 * PIXEL)


def test_a_pilaster_of_a_few_pixels_keeps_its_corners() -> None:
    """12 cm wide, 15 cm deep, and a niche of 28 cm beside it: lines slanted from the foot of one to the head of the other."""
    foot = [(0, 0), (3.16, 0), (3.16, 0.145), (3.29, 0.145), (3.29, 0), (3.57, 0), (3.57, 0.12), (10.4, 0.16)]
    room = shapely.Polygon([(x, y + 0.01) for x, y in [*foot, (10.4, 3.0), (0, 3.0)]])
    straight, _ = straightened(drawn(room))
    assert off(straight.walls, room.exterior).max() < 0.9
