"""Ray casting: closed forms, the plain method, invariance, range limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from conftest import polygon_arena
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_kernels import nearest_walls_plain

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.world.ray_intersection import nearest_after_moves, nearest_walls
from sensorgraph.world.raycast import cast, cast_rays, laser_poses
from sensorgraph.world.wall_grid import WallGrid, nearest_in_grid

FULL = RangeSensor(bearings=-np.pi + 2 * np.pi * np.arange(360) / 360, range_min=0.0, range_max=100.0)


def free_poses(arena: Arena, n: int, rng: np.random.Generator) -> np.ndarray:
    x0, y0, x1, y1 = arena.bounds
    poses = rng.uniform([x0, y0, -np.pi], [x1, y1, np.pi], (20 * n, 3))
    return poses[arena.contains(poses[:, :2])][:n]


def clutter(n_boxes: int, rng: np.random.Generator) -> Arena:
    """Make a 20 x 15 m hall with turned, overlapping boxes: far more walls than are met one by one."""
    rings = [[(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)]]
    for _ in range(n_boxes):
        centre, size, turn = rng.uniform(1, 14, 2), rng.uniform(0.05, 0.8, 2), rng.uniform(0, np.pi)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size / 2
        c, s = np.cos(turn), np.sin(turn)
        rings.append([tuple(centre + [c * x - s * y, s * x + c * y]) for x, y in corners])
    return polygon_arena(*rings)


def with_shapely(arena: Arena, pose: np.ndarray, sensor: RangeSensor) -> np.ndarray:
    walls = shapely.multilinestrings(shapely.linestrings(arena.walls))
    origin = shapely.Point(pose[:2])
    out = []
    for phi in pose[2] + sensor.bearings:
        end = pose[:2] + sensor.range_max * np.array([np.cos(phi), np.sin(phi)])
        hit = shapely.intersection(shapely.LineString([pose[:2], end]), walls)
        out.append(np.inf if hit.is_empty else shapely.distance(origin, hit))
    return np.array(out)


def test_rays_along_the_axes_return_the_exact_wall_distance(room: Arena) -> None:
    four = RangeSensor(bearings=np.array([-np.pi / 2, 0.0, np.pi / 2]), range_min=0.0)
    hits = cast(room, np.array([[1.0, 1.2, 0.0]]), four)
    np.testing.assert_allclose(hits.ranges, [[1.2, 1.5, 1.8]], rtol=1e-12)
    np.testing.assert_allclose(hits.incidence, 0.0, atol=1e-7)  # arccos near 1
    assert hits.wall.tolist() == [[0, 7, 2]]


def test_incidence_is_the_angle_to_the_normal(room: Arena) -> None:
    bearings = np.linspace(-0.5, 0.5, 11)
    sensor = RangeSensor(bearings=bearings, range_min=0.0)
    hits = cast(room, np.array([[1.0, 2.5, np.pi / 2]]), sensor)
    np.testing.assert_allclose(hits.incidence[0], np.abs(bearings), atol=1e-7)
    np.testing.assert_allclose(hits.ranges[0], 0.5 / np.cos(bearings), rtol=1e-12)


@pytest.mark.parametrize("n_boxes", [0, 10, 120])
def test_cast_agrees_with_every_ray_against_every_wall(n_boxes: int) -> None:
    rng = np.random.default_rng(n_boxes)
    arena = clutter(n_boxes, rng)
    poses = free_poses(arena, 60, rng)
    hits = cast(arena, poses, FULL)
    origins = np.repeat(poses[:, None, :2], FULL.n_rays, axis=1)
    plain = cast_rays(arena, origins, poses[:, 2:] + FULL.bearings, FULL)
    np.testing.assert_allclose(hits.ranges, plain.ranges, rtol=0, atol=1e-9)
    same = hits.wall == plain.wall
    assert same.mean() > 0.999  # at a corner either wall is right
    np.testing.assert_allclose(hits.incidence[same], plain.incidence[same], atol=1e-6)


def test_cast_agrees_with_shapely() -> None:
    rng = np.random.default_rng(1)
    arena = clutter(60, rng)
    for pose in free_poses(arena, 4, rng):
        hits = cast(arena, pose[None], FULL)
        np.testing.assert_allclose(hits.ranges[0], with_shapely(arena, pose, FULL), rtol=0, atol=1e-9)


def test_bearings_need_not_be_even(room: Arena) -> None:
    rng = np.random.default_rng(2)
    bearings = np.sort(rng.uniform(-3, 3, 200))
    sensor = replace(FULL, bearings=bearings)
    poses = free_poses(room, 30, rng)
    origins = np.repeat(poses[:, None, :2], 200, axis=1)
    plain = cast_rays(room, origins, poses[:, 2:] + bearings, sensor)
    np.testing.assert_allclose(cast(room, poses, sensor).ranges, plain.ranges, rtol=0, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    turn=st.floats(-7, 7),
    shift=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
    x=st.floats(0.3, 2.3),
    phi=st.floats(-4, 4),
)
def test_turning_robot_and_room_together_changes_nothing(
    turn: float, shift: tuple[float, float], x: float, phi: float
) -> None:
    corners = [(0, 0), (4, 0), (4, 3), (0, 3)]
    box = [(2.5, 1.0), (3.0, 1.0), (3.0, 1.5), (2.5, 1.5)]
    c, s = np.cos(turn), np.sin(turn)

    def moved(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
        return [(c * a - s * b + shift[0], s * a + c * b + shift[1]) for a, b in points]

    before = cast(polygon_arena(corners, box), np.array([[x, 0.7, phi]]), FULL)
    (there,) = moved([(x, 0.7)])
    after = cast(polygon_arena(moved(corners), moved(box)), np.array([[*there, phi + turn]]), FULL)
    same = before.wall == after.wall
    assert same.mean() > 0.97  # a ray that meets a corner may fall to either side
    np.testing.assert_allclose(after.ranges[same], before.ranges[same], rtol=0, atol=1e-7)


def test_corners_do_not_leak(room: Arena) -> None:
    """Aim every ray exactly at a corner, from many places."""
    rng = np.random.default_rng(3)
    corners = np.unique(room.walls.reshape(-1, 2), axis=0)
    for pose in free_poses(room, 200, rng):
        offset = corners - pose[:2]
        bearings = np.unique(np.arctan2(offset[:, 1], offset[:, 0]) - pose[2])
        hits = cast(room, pose[None], replace(FULL, bearings=bearings))
        assert np.isfinite(hits.ranges).all()
        assert (hits.ranges <= np.hypot(*(corners - pose[:2]).T).max() + 1e-9).all()


def test_looking_along_a_wall_stops_at_its_near_end() -> None:
    arena = polygon_arena([(0, 0), (4, 0), (4, 3), (0, 3)], [(2, 1), (3, 1), (3, 2), (2, 2)])
    ahead = replace(FULL, bearings=np.array([0.0]))
    hits = cast(arena, np.array([[1.0, 1.0, 0.0], [1.0, 2.0, 0.0]]), ahead)
    np.testing.assert_allclose(hits.ranges, 1.0, atol=1e-9)


def test_limits_follow_rep_117(room: Arena) -> None:
    sensor = RangeSensor(bearings=np.array([-np.pi / 2, 0.0, np.pi / 2]), range_min=1.3, range_max=1.6)
    hits = cast(room, np.array([[1.0, 1.2, 0.0]]), sensor)
    assert hits.ranges.tolist() == [[-np.inf, pytest.approx(1.5), np.inf]]
    assert hits.wall.tolist() == [[0, 7, -1]]
    assert np.isnan(hits.incidence[0, 2])


def test_mount_moves_and_turns_the_rays() -> None:
    mount = np.array([0.3, -0.1, 0.4])
    (laser,) = laser_poses(np.array([[1.0, 2.0, np.pi / 2]]), mount)
    np.testing.assert_allclose(laser, [1.1, 2.3, np.pi / 2 + 0.4], rtol=1e-12)


def test_one_ray_and_no_pose_have_the_right_shape(room: Arena) -> None:
    one = replace(FULL, bearings=np.array([0.2]))
    assert cast(room, np.zeros((0, 3)), one).ranges.shape == (0, 1)
    assert cast(room, np.array([[1.0, 1.0, 0.0]]), one).ranges.shape == (1, 1)
    with pytest.raises(ValueError, match=r"expected \(n_scans, 3\)"):
        cast(room, np.zeros(3), one)


def test_the_compiled_rays_are_the_plain_ones() -> None:
    """To the last bit, along walls and through corners, too."""
    rng = np.random.default_rng(5)
    walls = rng.uniform(0, 10, (30, 2, 2))
    walls[20:, 1, 0] = walls[20:, 0, 0]  # upright ones, which a ray may run along
    walls[25:, 0] = walls[24:29, 1]  # corners
    n = 4000
    ox, oy, phi = rng.uniform(0, 10, n), rng.uniform(0, 10, n), rng.uniform(-np.pi, np.pi, n)
    ux, uy = np.cos(phi), np.sin(phi)
    ox[:500], ux[:500], uy[:500] = walls[rng.integers(20, 30, 500), 0, 0], 0.0, 1.0
    aim = walls[rng.integers(0, 30, 500), 1] - np.column_stack([ox, oy])[500:1000]
    ux[500:1000], uy[500:1000] = aim.T / np.hypot(*aim.T)
    ranges, wall = nearest_walls(walls, ox, oy, ux, uy)
    there, other = nearest_walls_plain(walls, ox, oy, ux, uy)
    np.testing.assert_array_equal(ranges, there)
    np.testing.assert_array_equal(wall, other)
    assert 0.5 < np.isfinite(ranges).mean() < 1


def test_a_grid_of_walls_changes_no_bit() -> None:
    """Rays from within and from outside, along the axes, through corners; walls without length or taken away."""
    rng = np.random.default_rng(8)
    walls = clutter(120, rng).walls.copy()
    walls[7], walls[9, 1] = 1e9, walls[9, 0]
    n = 6000
    ox, oy, phi = rng.uniform(-4, 24, n), rng.uniform(-4, 19, n), rng.uniform(-np.pi, np.pi, n)
    ux, uy = np.cos(phi), np.sin(phi)
    ux[:400], uy[:400] = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])[
        rng.integers(0, 4, 400)
    ].T
    aim = walls[rng.integers(10, len(walls), 600), 1] - np.column_stack([ox, oy])[400:1000]
    ux[400:1000], uy[400:1000] = aim.T / np.hypot(*aim.T)
    ox[1000:1400], oy[1000:1400] = walls[rng.integers(10, len(walls), 400), 0].T
    ranges, wall = nearest_in_grid(walls, WallGrid.of(walls), ox, oy, ux, uy)
    there, other = nearest_walls(walls, ox, oy, ux, uy)
    np.testing.assert_array_equal(ranges, there)
    np.testing.assert_array_equal(wall, other)
    assert 0.5 < np.isfinite(ranges).mean() < 1


def test_a_grid_without_walls_stops_no_ray() -> None:
    gone = np.full((3, 2, 2), 1e9)
    ranges, wall = nearest_in_grid(gone, WallGrid.of(gone), np.zeros(2), np.zeros(2), np.ones(2), np.zeros(2))
    assert np.isinf(ranges).all() and (wall == -1).all()


def test_where_no_wall_is_no_ray_ends() -> None:
    ranges, wall = nearest_walls(np.zeros((0, 2, 2)), np.zeros(3), np.zeros(3), np.ones(3), np.zeros(3))
    assert np.isinf(ranges).all() and (wall == -1).all()


@given(st.integers(0, 10_000), st.sampled_from([0, 1, 4, 30]))
@settings(max_examples=25, deadline=None)
def test_walls_that_have_moved_are_met_where_they_stand_now(seed: int, n_moved: int) -> None:
    """To the last bit: also of rays that had stopped at one of them, and where one was taken away."""
    rng = np.random.default_rng(seed)
    walls = clutter(15, rng).walls
    moved = rng.choice(len(walls), n_moved, replace=False)
    now = walls.copy()
    now[moved] += rng.normal(0, 0.5, (n_moved, 1, 2))
    now[moved[:1]] = 1e9
    n = 500
    ox, oy, phi = rng.uniform(0, 15, n), rng.uniform(0, 15, n), rng.uniform(-np.pi, np.pi, n)
    ux, uy = np.cos(phi), np.sin(phi)
    before = nearest_walls(walls, ox, oy, ux, uy)
    found = nearest_after_moves(now, moved, ox, oy, ux, uy, *before)
    for got, there in zip(found, nearest_walls(now, ox, oy, ux, uy), strict=True):
        np.testing.assert_array_equal(got, there)
