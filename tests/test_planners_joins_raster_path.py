"""Paths over raster nodes, for joins that neither OMPL nor straight legs over cells find."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import polygon_arena

import planners.joins.paths as paths
from planners.arena import Arena
from planners.clearance import Barriers
from planners.joins.paths import raster_path
from planners.reach import Reach, reach
from planners.types import Floats

CLEARANCE = 0.22


def two_rooms() -> Arena:
    """Two rooms of 5 x 4 m; the wall between them has a door of 0.6 m that no straight line between two cells of 1 m passes."""
    left, right, wall = 5.0, 5.2, 4.0
    ring = [(0.0, 0.0), (left, 0.0), (left, 3.25), (right, 3.25), (right, 0.0), (10.2, 0.0), (10.2, wall)]
    ring += [(right, wall), (right, 3.85), (left, 3.85), (left, wall), (0.0, wall)]
    return polygon_arena(ring)


@pytest.fixture(scope="module")
def floor() -> tuple[Reach, Barriers]:
    arena = two_rooms()
    barriers = Barriers(arena)
    return reach(arena, barriers, clearance=CLEARANCE, cell=1.0, start=np.array([1.5, 1.5])), barriers


def length(path: Floats) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def test_the_path_keeps_its_clearance_and_is_little_longer_than_the_shortest(
    floor: tuple[Reach, Barriers],
) -> None:
    reached, barriers = floor
    start, end = np.array([1.0, 1.0]), np.array([9.0, 1.0])
    path = raster_path(start, end, reached)
    assert path is not None
    np.testing.assert_array_equal(path[[0, -1]], [start, end])
    assert barriers.are_clear(path[:-1], path[1:], CLEARANCE).all()
    door = np.array([[4.75, 3.5], [5.45, 3.5]])
    shortest = length(np.concatenate([start[None], door, end[None]]))
    assert shortest - 0.5 < length(path) < 1.2 * shortest  # steps are along eight directions


def test_no_path_leads_to_where_the_robot_cannot_be(floor: tuple[Reach, Barriers]) -> None:
    assert raster_path(np.array([1.0, 1.0]), np.array([5.1, 1.0]), floor[0]) is None


@pytest.mark.parametrize("end", [(9.0, 1.0), (6.0, 3.0)], ids=["far", "behind the door"])
def test_rooms_are_joined_where_ompl_finds_nothing(
    floor: tuple[Reach, Barriers], end: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A query without a result replaces OMPL, which may or may not find a narrow door."""
    reached, barriers = floor
    monkeypatch.setattr(paths, "_query", lambda starts, *_: [np.zeros((0, 2)) for _ in starts])
    (path,), joins = paths.connect(
        np.array([[1.0, 1.0]]), np.array([end]), reach=reached, barriers=barriers, seed=0
    )
    assert joins.failed == 0
    assert path is not None
    np.testing.assert_allclose(path[[0, -1]], [(1.0, 1.0), end])
    assert barriers.are_clear(path[:-1], path[1:], CLEARANCE - 0.002).all()
    assert len(path) < 12  # needless corners are left out
