"""Locating a run in an arena: only the free side of a wall is matched, and cells are matched as straight walls."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
from localization_samples import ROOM, room_run, timed

from planners.arena import Arena
from planners.maps import geojson, ros_map
from sensorgraph.localization.arena_walls import drawn_walls, straight_walls
from sensorgraph.localization.in_map import locate_in_map
from sensorgraph.localization.known_map import MapWalls
from sensorgraph.localization.locate import walls_of_place
from sensorgraph.types import Floats
from sensorgraph.world.wall_sides import STEP

THIN = [(4.95, 0.0), (5.05, 0.0), (5.05, 2.2), (4.95, 2.2)]
"""A partition of 10 cm with a free end."""
CELL = 0.05  # [m]


def polygon(name: str, kind: str, ring: list[tuple[float, float]]) -> dict[str, object]:
    corners = [[list(p) for p in [*ring, ring[0]]]]
    return {
        "type": "Feature",
        "properties": {"name": name, "kind": kind},
        "geometry": {"type": "Polygon", "coordinates": corners},
    }


def arena_text(thin: list[tuple[float, float]] = THIN) -> str:
    """Return the room with its box and a partition."""
    outline, box = [wall[:2] for wall in ROOM[:10]], [wall[:2] for wall in ROOM[10:]]
    features = [
        polygon("room", "arena", outline),
        polygon("box", "obstacle", box),
        polygon("thin", "obstacle", thin),
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


@cache
def office() -> Arena:
    return geojson.loads(arena_text())


@cache
def cells() -> Arena:
    """Return a turned occupancy grid of the room: cells that a wall passes through are occupied, those in the room free."""
    low, yaw = np.array([2.0, -2.0]), 0.4
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    x, y = np.meshgrid(np.arange(0.0, 9.6, CELL), np.arange(0.0, 10.0, CELL))
    corners = np.stack([x, y], axis=-1)[:, :, None] + CELL * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    squares = shapely.polygons(corners @ turn + low)
    walls = shapely.MultiLineString(list(office().walls))
    shapely.prepare(walls)
    data = np.where(shapely.contains(office().free, shapely.centroid(squares)), 0, -1).astype(np.int8)
    data[shapely.intersects(walls, squares)] = 100
    return ros_map.of_grid(data, CELL, (*low, yaw), "room")


LEGS = np.array([[1.0, 1.2], [4.4, 1.2], [4.4, 2.6], [5.6, 2.6], [7.0, 1.2]])
TRUTH = np.column_stack(
    [
        *(np.interp(np.linspace(0, 4, 97), np.arange(5), LEGS[:, k]) for k in (0, 1)),
        np.linspace(0.0, -0.8, 97),
    ]
)
"""Drive (97, 3) around the partition."""
POSE_ERROR = 0.01 / np.sqrt(180 / 2)
"""[m] Standard deviation of a coordinate that half of the 180 returns determine, with a noise of 1 cm."""


def errors(given: MapWalls) -> Floats:
    """Return the distances (97,) [m] of located from true poses."""
    run = room_run(TRUTH, walls=[tuple(wall.ravel()) for wall in office().walls], n_rays=180)
    found = locate_in_map(timed(run), **given._asdict())
    assert set(found.status) == {"ok"}
    return np.hypot(*(found.poses - TRUTH)[:, :2].T)


@pytest.mark.parametrize(
    "shift", [0.0, 1.0, 1.03], ids=["partition", "in the middle of the floor", "off the pieces"]
)
def test_walls_with_their_free_sides_are_the_border_of_free_space(shift: float) -> None:
    arena = geojson.loads(arena_text(thin=[(x - shift, y) for x, y in THIN]))
    walls, normals = drawn_walls(arena)
    ahead = np.diff(walls, axis=1)[:, 0]
    covered = 2  # borders between a covered part of the floor and a free one
    assert np.hypot(*ahead.T).sum() == pytest.approx(arena.free.length, abs=covered * STEP)
    assert np.hypot(*normals.T) == pytest.approx(1.0)
    assert np.abs((normals * ahead).sum(axis=1)).max() < 1e-12  # across the wall
    assert arena.contains(walls.mean(axis=1) + 0.02 * normals).all()
    assert not arena.contains(walls.mean(axis=1) - 0.02 * normals).any()


def test_wall_in_the_middle_of_free_space_has_no_side() -> None:
    arena = office()
    line = np.array([[[1.0, 4.0], [2.0, 4.0]]])
    both = replace(arena, walls=np.concatenate([arena.walls, line]), names=(*arena.names, "glass/edge_0"),
                   surfaces=(*arena.surfaces, "wall"))  # fmt: skip
    walls, normals = drawn_walls(both)
    assert walls[-1].tolist() == line[0].tolist() and normals[-1].tolist() == [0.0, 0.0]


def test_gap_between_two_walls_shows_none_of_its_sides() -> None:
    beside = [(x + 0.12, y) for x, y in THIN]  # 2 cm from the partition
    data = json.loads(arena_text())
    data["features"].append(polygon("second", "obstacle", beside))
    walls, normals = drawn_walls(geojson.loads(json.dumps(data)))
    between = (walls[..., 0].min(axis=1) > 5.04) & (walls[..., 0].max(axis=1) < 5.08)
    assert not between.any() and normals.any(axis=1).all()


def test_robot_is_not_drawn_into_a_thin_wall_of_a_drawn_arena() -> None:
    given = walls_of_place(office())
    assert given.straight is None
    assert np.median(errors(given)) < 3 * POSE_ERROR
    assert np.median(errors(MapWalls(given.walls))) > 5 * POSE_ERROR  # both sides of the partition match


def test_straight_walls_of_cells_run_along_the_drawn_ones() -> None:
    assert straight_walls(office()) is None
    found = straight_walls(cells())
    assert found is not None
    walls, normals = found.walls, found.normals
    true = shapely.MultiLineString(list(office().walls))
    length = np.hypot(*np.diff(walls, axis=1)[:, 0].T)
    long = length > 6 * CELL
    assert length[long].sum() > 0.9 * office().free.length
    assert shapely.distance(shapely.points(walls[long].mean(axis=1)), true).max() < CELL / 2
    sided = long & normals.any(axis=1)
    assert length[sided].sum() > 0.8 * office().free.length
    assert office().contains(walls[sided].mean(axis=1) + CELL * normals[sided]).all()


def test_cells_locate_better_by_straight_walls() -> None:
    assert np.median(errors(walls_of_place(cells()))) < 3 * POSE_ERROR
    assert np.median(errors(MapWalls(cells().walls))) > 10 * POSE_ERROR
