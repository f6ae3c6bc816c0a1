"""Distances are exact, and a place is reachable only if the robot can get there."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from conftest import polygon_arena
from planners_samples import door_arena, random_arena, shipped

from planners import plan
from planners.arena import Arena
from planners.clearance import Barriers
from planners.errors import PlanError
from planners.maps import geojson
from planners.reach import DISTANCE_CAP, reach
from planners.vehicle import Limits, Vehicle


@pytest.mark.parametrize("seed", range(8))
def test_field_is_the_exact_distance_to_the_nearest_barrier(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arena = random_arena(rng)
    x, y = np.arange(-0.5, 5.0, 0.1), np.arange(-0.5, 4.0, 0.1)
    field = Barriers(arena).field(x, y, 0.7)
    points = shapely.points(*np.meshgrid(x, y, indexing="ij"))
    walls = shapely.multilinestrings(list(arena.walls))
    exact = np.minimum(
        shapely.distance(points, shapely.boundary(arena.free)), shapely.distance(points, walls)
    )
    np.testing.assert_allclose(field, np.minimum(exact, 0.7), atol=1e-9)  # float64 at a few metres


@pytest.mark.parametrize("seed", range(4))
def test_clear_moves_are_those_whose_swept_disc_touches_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arena = random_arena(rng)
    starts, ends = rng.uniform(0, 4, (2, 300, 2))
    barriers = Barriers(arena)
    lines = shapely.linestrings(np.stack([starts, ends], axis=1))
    walls = shapely.union(shapely.multilinestrings(list(arena.walls)), shapely.boundary(arena.free))
    exact = shapely.distance(lines, walls)
    np.testing.assert_array_equal(barriers.are_clear(starts, ends, 0.2), exact >= 0.2 - 1e-9)
    np.testing.assert_allclose(barriers.distances(starts), shapely.distance(shapely.points(starts), walls))


def test_walls_that_bound_nothing_still_stop_the_robot() -> None:
    """A glass pane across a room, drawn as a line."""
    pane = np.array([[[2.0, 0.0], [2.0, 3.0]]])
    arena = Arena(free=shapely.box(0, 0, 4, 3), walls=pane, names=("pane/edge_0",), surfaces=("glass",))
    found = reach(arena, Barriers(arena), clearance=0.2, cell=0.25, start=np.array([1.0, 1.0, 0.0]))
    x = found.nodes(np.nonzero(found.mask))[:, 0]
    assert x.max() <= 1.8 + 1e-9
    assert found.share == pytest.approx(0.5, abs=0.01)


def test_a_closed_door_parts_two_rooms() -> None:
    start = np.array([0.5, 0.5, 0.0])
    for width, share in ((0.0, 0.5), (0.42, 0.5), (0.9, 1.0)):
        arena = door_arena(width)
        found = reach(arena, Barriers(arena), clearance=0.22, cell=0.25, start=start)
        assert found.share == pytest.approx(share, abs=0.02)


def test_reachable_area_of_an_empty_room_is_the_room_shrunk_by_the_clearance() -> None:
    arena = geojson.loads(geojson.dumps(door_arena(9.0)))  # the door is as wide as the room: one 4 x 3 m room
    found = reach(arena, Barriers(arena), clearance=0.22, cell=0.25)
    area = (found.areas() * found.cell**2).sum()
    assert area == pytest.approx((4 - 0.44) * (3 - 0.44), rel=2e-3)  # of a raster of 2 cm with parts of nodes
    assert found.cells().sum() == 16 * 12 - 4  # the corners hold 3 x 3 of 25 x 25 cm, 1.4 %


def test_mask_keeps_clear_and_field_is_cut_off() -> None:
    arena = shipped("office")
    found = reach(arena, Barriers(arena), clearance=0.22, cell=0.25)
    nodes = found.nodes(np.nonzero(found.mask))
    assert Barriers(arena).distances(nodes[::50]).min() >= 0.22 - 1e-9
    assert found.distance.max() == pytest.approx(0.22 + DISTANCE_CAP)
    assert found.step <= 0.02


@pytest.mark.parametrize(
    ("start", "clearance", "says"),
    [
        ([1.0, 2.9, 0.0], 0.2, r"0\.100 m from a wall"),
        (
            [1.0, 2.801, 0.0],
            0.2,
            r"0\.199 m from a wall, less than the robot's radius and margin of 0\.200 m",
        ),
        ([9.0, 9.0, 0.0], 0.2, r"inside a wall or outside"),
        ([2.0, 0.5, 0.0], 0.2, r"inside a wall"),
        (None, 1.6, "does not fit"),
    ],
)
def test_impossible_starts_say_how_far_they_are_off(
    start: list[float] | None, clearance: float, says: str
) -> None:
    arena = door_arena(0.9)
    with pytest.raises(PlanError, match=says):
        reach(
            arena,
            Barriers(arena),
            clearance=clearance,
            cell=0.25,
            start=None if start is None else np.array(start),
        )


def test_a_cell_far_too_small_is_refused() -> None:
    arena = shipped("office")
    with pytest.raises(PlanError, match="choose a larger cell"):
        reach(arena, Barriers(arena), clearance=0.22, cell=0.001)


@pytest.mark.parametrize("seed", range(6))
def test_a_grid_is_inside_where_its_nodes_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arena = random_arena(rng)
    x0, y0, x1, y1 = arena.bounds
    x = np.sort(np.append(rng.uniform(x0 - 1, x1 + 1, 180), arena.walls[:5, 0, 0]))  # some nodes on edges
    y = np.sort(np.append(rng.uniform(y0 - 1, y1 + 1, 150), arena.walls[:5, 0, 1]))
    nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    assert (arena.contains_grid(x, y) == arena.contains(nodes)).all()


def test_nodes_on_the_edges_of_pixels_are_outside() -> None:
    pixels = np.random.default_rng(3).random((12, 9)) < 0.6
    free = shapely.unary_union([shapely.box(i, j, i + 1, j + 1) for i, j in np.argwhere(pixels)])
    arena = Arena(free=free, walls=np.zeros((0, 2, 2)), names=(), surfaces=())
    x, y = np.arange(-1.0, 14.0, 0.5), np.arange(-1.0, 11.0, 0.5)
    nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    assert (arena.contains_grid(x, y) == arena.contains(nodes)).all()


def test_without_a_margin_the_robot_touches_no_wall() -> None:
    """Distances between nodes are interpolated, which makes the distance to a corner up to 0.5 mm too large."""
    pillar = [(1.2, 1.0), (1.8, 1.2), (1.4, 1.6)]
    room = polygon_arena([(0.0, 0.0), (3.0, 0.0), (3.0, 2.5), (0.0, 2.5)], pillar)
    car = Vehicle(drive="dubins", footprint_radius=0.15, limits=Limits(turning_radius=0.3))
    made = plan(room, car, margin=0.0, cell=0.25, headings=8)
    assert made.report["violations"]["clearance"] == 0
    assert made.report["min_clearance_m"] >= car.footprint_radius
    assert made.report["margin_m"] == 0.002
