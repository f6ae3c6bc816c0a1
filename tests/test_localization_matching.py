"""Scans as points, lines of a map, and one scan against a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from localization_samples import CORRIDOR, ROOM, loop_poses, room_run, seen

from logs.run import RangeSensor, Run
from sensorgraph.localization.line_map import LineMap, line_map
from sensorgraph.localization.matching import match
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.scans import ScanPoints, scan_points

HERE = np.array([3.0, 1.0, 0.4])


def moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def turned(normals: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return moved(normals, np.array([0.0, 0.0, pose[2]]))


def map_of(run: Run, poses: np.ndarray) -> LineMap:
    scans = scan_points(run)
    points = [moved(scans.points[scans.of(k)], pose) for k, pose in enumerate(poses)]
    normals = [turned(scans.normals[scans.of(k)], pose) for k, pose in enumerate(poses)]
    return line_map(np.concatenate(points), np.concatenate(normals))


@pytest.fixture(scope="module")
def surfaces() -> LineMap:
    poses = loop_poses(20)
    return map_of(room_run(poses, seed=3), poses)


def one_scan(pose: np.ndarray, *, seed: int = 1, **options: object) -> ScanPoints:
    return scan_points(room_run(pose[None], seed=seed, **options))  # type: ignore[arg-type]


def test_points_lie_on_the_walls_and_normals_look_at_the_laser() -> None:
    scan = one_scan(np.array([2.0, 1.0, 0.0]), sigma=0.0)
    on_floor_wall = np.abs(scan.points[:, 1] + 1.0) < 1e-9  # the wall y = 0, away from its corners
    middle = on_floor_wall & (np.abs(scan.points[:, 0]) < 1.5)
    assert middle.sum() > 10
    np.testing.assert_allclose(scan.normals[middle], [[0.0, 1.0]] * int(middle.sum()), atol=1e-9)
    known = (scan.normals != 0).any(axis=1)
    assert (np.einsum("ij,ij->i", scan.normals[known], scan.points[known]) < 0).all()


def test_returns_beyond_the_limits_are_no_points() -> None:
    sensor = RangeSensor(bearings=np.linspace(-1, 1, 5), range_min=0.1, range_max=10.0)
    ranges = np.array([[np.inf, -np.inf, np.nan, 5.0, 10.0], [3.0] * 5])
    scans = scan_points(Run(sensor=sensor, stamps=np.arange(2.0), ranges=ranges))
    assert scans.first.tolist() == [0, 1, 6]


def test_sweep_is_undone_by_the_odometry() -> None:
    bearings = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    sensor = RangeSensor(bearings=bearings, range_max=20.0, sweep_time=0.2)
    odometry = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 1.2]])  # in 0.4 s, the robot turns on its way
    at_rays = np.stack([np.interp(sensor.ray_delays, [0.0, 0.4], column) for column in odometry.T], axis=-1)
    start = np.array([2.0, 1.0, 0.0])
    ranges = np.array(
        [seen((start + pose)[None], bearings[k : k + 1])[0, 0] for k, pose in enumerate(at_rays)]
    )
    run = Run(
        sensor=sensor,
        stamps=np.zeros(1),
        ranges=ranges[None],
        odom_stamps=np.array([0.0, 0.4]),
        odometry=odometry,
        odom_twists=np.zeros((2, 2)),
    )
    points = moved(scan_points(run, odometry_of(run)).points, start)
    walls = np.array(ROOM)
    d = walls[:, 2:] - walls[:, :2]
    n = np.column_stack([-d[:, 1], d[:, 0]]) / np.hypot(*d.T)[:, None]
    off = np.abs(((points[:, None] - walls[:, :2]) * n).sum(axis=2)).min(axis=1)
    assert off.max() < 1e-9
    assert np.hypot(*(scan_points(run).points - scan_points(run, odometry_of(run)).points).T).max() > 0.3


@pytest.mark.parametrize("off", [(0.1, 0.0, 0.0), (-0.08, 0.1, 0.06), (0.05, -0.12, -0.08)])
def test_match_finds_the_pose(surfaces: LineMap, off: tuple[float, float, float]) -> None:
    scan = one_scan(HERE)
    found = match(scan.points, scan.normals, surfaces, HERE + off)
    np.testing.assert_allclose(found.pose, HERE, atol=6e-3)  # 3 sd of 120 returns of 1 cm, and of the map
    assert found.overlap > 0.95
    assert found.inliers > 0.95
    assert 0.005 < found.noise < 0.02


def test_match_turns_with_the_world(surfaces: LineMap) -> None:
    turn = np.array([40.0, -25.0, 2.0])
    there = line_map(moved(surfaces.points, turn), turned(surfaces.normals, turn))
    scan = one_scan(HERE)
    start = HERE + [0.05, 0.02, 0.03]
    start_there = np.append(moved(start[None, :2], turn)[0], start[2] + turn[2])
    a = match(scan.points, scan.normals, surfaces, start)
    b = match(scan.points, scan.normals, there, start_there)
    np.testing.assert_allclose(moved(a.pose[None, :2], turn)[0], b.pose[:2], atol=1e-6)


def test_information_of_a_match_is_the_scatter_of_its_poses() -> None:
    """The map is without noise, so that the scan's is all there is."""
    poses = loop_poses(40)
    surfaces = map_of(room_run(poses, sigma=0.0, n_rays=240), poses)
    found = [
        match(s.points, s.normals, surfaces, HERE) for s in (one_scan(HERE, seed=seed) for seed in range(60))
    ]
    z = [
        (f.pose - HERE) @ f.information @ (f.pose - HERE) for f in found
    ]  # chi² of 3 degrees of freedom: mean 3, sd 2.45 / sqrt(60)
    assert 1.5 < np.mean(z) < 5.0


def test_prior_decides_where_walls_say_nothing() -> None:
    poses = np.column_stack([np.linspace(-4, 4, 20), np.zeros(20), np.zeros(20)])
    surfaces = map_of(room_run(poses, walls=CORRIDOR), poses)
    scan = scan_points(room_run(np.zeros((1, 3)), walls=CORRIDOR, seed=5))
    start = np.array([0.3, 0.05, 0.02])
    free = match(scan.points, scan.normals, surfaces, start)
    direction, sd = free.weak_direction
    assert abs(direction[0]) > 0.999
    assert sd > 0.1
    assert abs(free.pose[1]) < 0.005
    held = match(scan.points, scan.normals, surfaces, start, prior_information=np.diag([1e6, 1.0, 1.0]))
    assert abs(held.pose[0] - start[0]) < 0.02 and abs(held.pose[1]) < 0.005  # across, the walls decide


def test_people_do_not_pull(surfaces: LineMap) -> None:
    run = room_run(HERE[None], seed=2)
    ranges = run.ranges.copy()
    ranges[0, 30:48] = np.minimum(ranges[0, 30:48], 0.8)  # 15 % of the rays
    scan = scan_points(replace(run, ranges=ranges))
    found = match(scan.points, scan.normals, surfaces, HERE + [0.05, 0.05, 0.03])
    np.testing.assert_allclose(found.pose, HERE, atol=8e-3)
    assert found.agreement < 0.9


def test_nothing_near_is_said() -> None:
    scan = one_scan(HERE)
    found = match(scan.points, scan.normals, line_map(np.full((4, 2), 100.0)), HERE)
    assert found.overlap == 0
    np.testing.assert_allclose(found.pose, HERE, atol=1e-9)
    empty = match(np.zeros((0, 2)), np.zeros((0, 2)), line_map(np.zeros((0, 2))), HERE)
    assert empty.agreement == 0


def test_odometry_that_never_moves_is_none() -> None:
    run = room_run(loop_poses(4))
    assert odometry_of(run) is not None
    assert odometry_of(replace(run, odometry=np.zeros((4, 3)))) is None


def test_two_sides_of_a_thin_wall_are_two_surfaces() -> None:
    """A wall of 6 cm, seen from the left only; a scan from the right must not be drawn to it."""
    thin = [(-4.0, 0.0, 4.0, 0.0), (-4.0, 0.06, 4.0, 0.06)]
    below = np.column_stack([np.linspace(-2, 2, 20), np.full(20, -1.5), np.full(20, np.pi / 2)])
    surfaces = map_of(room_run(below, walls=thin, n_rays=360), below)
    scan = scan_points(room_run(np.array([[0.0, 1.5, -np.pi / 2]]), walls=thin, n_rays=360))
    assert match(scan.points, scan.normals, surfaces, np.array([0.0, 1.5, -np.pi / 2])).overlap < 0.1


def test_front_of_a_wall_holds_a_return_that_met_it_almost_along_it() -> None:
    x = np.linspace(-2.0, 2.0, 101)
    wall, ahead = np.column_stack([x, np.zeros(101)]), np.tile([0.0, 1.0], (101, 1))
    along = 0.2 * np.array(
        [[np.cos(angle), np.sin(angle)] for angle in np.radians([5.0, -5.0])]
    )  # to the laser
    points = np.array([[0.5, 0.0], [0.5, 0.0]])
    for facing, expected in ((0.0, 0.5), (0.25, 0.0)):
        surfaces = line_map(wall, ahead, facing=facing)
        assert match(points, along, surfaces, np.zeros(3)).overlap == expected
