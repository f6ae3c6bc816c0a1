"""A laser that sweeps while the robot drives: each ray is taken from its own pose, and nothing is lost by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from logs.motion import Motion, motion_of, ray_poses
from logs.run import RangeSensor, Run, pair
from planners.arena import Arena
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.show.review.contents import collect
from sensorgraph.types import Floats
from sensorgraph.world.orientation import orientation

pytestmark = pytest.mark.usefixtures("trusted_scans")

ROOM = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (2.0, 2.0), (2.0, 2.6), (0.0, 2.6)]
SWEEP_TIME, RATE, N_RAYS = 0.2, 5.0, 90
SIGMA = 0.01


def path(t: Floats) -> Floats:
    """Drive an oval and spin about: up to 0.26 m/s and 1.3 rad/s."""
    x = 1.2 + 0.6 * np.cos(0.4 * t)
    y = 1.0 + 0.4 * np.sin(0.4 * t)
    return np.stack([x, y, 0.2 + 0.7 * t + 1.2 * np.sin(0.5 * t)], axis=-1)


def distances(origins: Floats, angles: Floats) -> Floats:
    """Return the way (n,) [m] to the nearest wall of ROOM, by the plain formula."""
    best = np.full(len(angles), np.inf)
    u = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for a, b in zip(np.array(ROOM), np.roll(ROOM, -1, axis=0), strict=True):
        w, d = a - origins, b - a
        cross = u[:, 0] * d[1] - u[:, 1] * d[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            r = (w[:, 0] * d[1] - w[:, 1] * d[0]) / cross
            s = (w[:, 0] * u[:, 1] - w[:, 1] * u[:, 0]) / cross
        hit = (r > 0) & (s >= -1e-12) & (s <= 1 + 1e-12)
        best = np.where(hit & (r < best), r, best)
    return best


def run_of(
    seed: int,
    *,
    sweep_time: float = SWEEP_TIME,
    duration: float = 60.0,
    pose_rate: float = 30.0,
    odom_rate: float = 20.0,
    first: float = -np.pi,
) -> Run:
    rng = np.random.default_rng(seed)
    bearings = first + 2 * np.pi * np.arange(N_RAYS) / N_RAYS
    mount = np.array([-0.03, 0.0, 0.0])
    sensor = RangeSensor(
        bearings=bearings,
        range_min=0.12,
        range_max=3.5,
        rate=RATE,
        mount=mount,
        sigma=SIGMA,
        sweep_time=sweep_time,
    )
    stamps = np.arange(0.0, duration - 0.2, 1 / RATE)
    at = path(stamps[:, None] + sweep_time * np.arange(N_RAYS) / N_RAYS).reshape(-1, 3)
    cos, sin = np.cos(at[:, 2]), np.sin(at[:, 2])
    lasers = at[:, :2] + np.stack([cos * mount[0], sin * mount[0]], axis=-1)
    ranges = distances(lasers, at[:, 2] + np.tile(bearings, len(stamps)))
    ranges = (ranges + SIGMA * rng.normal(size=len(ranges))).reshape(len(stamps), N_RAYS)
    pose_stamps = np.arange(0.0, duration, 1 / pose_rate)
    poses = path(pose_stamps) + rng.normal(size=(len(pose_stamps), 3)) * [0.002, 0.002, 0.0015]
    odom_stamps = np.arange(0.0, duration, 1 / odom_rate)
    return Run(
        sensor=sensor,
        stamps=stamps,
        ranges=np.where(ranges > 3.5, np.inf, ranges),
        pose_stamps=pose_stamps,
        poses=poses,
        odom_stamps=odom_stamps,
        odometry=path(odom_stamps) - path(np.zeros(1)) + [0.5, 0.0, 0.0],
        odom_twists=np.zeros((len(odom_stamps), 2)),
    )


@pytest.fixture(scope="module")
def graphs() -> tuple[Sensorgraph, Sensorgraph]:
    """Built from a run with a sweep, and from the same drive without."""
    return build([run_of(0)]), build([run_of(0, sweep_time=0.0)])


@pytest.mark.slow
def test_accuracy_with_a_sweep_is_that_without(graphs: tuple[Sensorgraph, Sensorgraph]) -> None:
    swept = evaluate(graphs[0], run_of(1)).all
    still = evaluate(graphs[1], run_of(1, sweep_time=0.0)).all
    for name in ("median_m", "mae_m", "chamfer_m"):
        ours, theirs = swept[name], still[name]
        assert ours is not None and theirs is not None
        assert ours < 1.05 * theirs, name


def test_a_sweep_neither_splits_walls_nor_moves_the_mount(graphs: tuple[Sensorgraph, Sensorgraph]) -> None:
    swept, still = (graph.model for graph in graphs)
    assert isinstance(swept, Faces) and isinstance(still, Faces)
    assert still.faces.n_faces <= swept.faces.n_faces <= still.faces.n_faces + 2
    np.testing.assert_allclose(swept.mount, [-0.03, 0.0, 0.0], atol=0.002)  # the poses' own noise
    assert swept.calibration.terms.is_none


def test_graph_answers_each_ray_at_its_own_pose(graphs: tuple[Sensorgraph, Sensorgraph]) -> None:
    graph, run = graphs[0], run_of(1, duration=3.0)
    poses = path(run.stamps[:, None] + run.sensor.ray_delays)
    whole = graph.predict(poses)
    for ray in (0, 17, 89):
        alone = graph.predict(poses[:, ray], rays=[ray])
        np.testing.assert_array_equal(whole.median[:, ray], alone.median[:, 0])
    with pytest.raises(ValueError, match="expected"):
        graph.predict(poses[:, :5])


def test_review_draws_the_returns_of_a_sweep_on_the_walls() -> None:
    run = run_of(2, duration=12.0)
    review = collect(run)
    ends = np.concatenate(review.points(review.measured))
    wall = shapely.LinearRing(ROOM)
    off = shapely.distance(wall, shapely.points(ends))
    assert np.median(off) < 0.012  # 0.67 of the range's and poses' noise
    assert np.quantile(off, 0.99) < 0.05
    assert review.lasers.shape == (len(review.shown), N_RAYS, 3)


def test_orientation_of_a_sweep_is_told_by_map_and_by_itself() -> None:
    run = run_of(3, duration=30.0)
    corners = np.array(ROOM)
    arena = Arena(
        free=shapely.Polygon(ROOM),
        walls=np.stack([corners, np.roll(corners, -1, axis=0)], axis=1),
        names=tuple(f"room/edge_{i}" for i in range(len(ROOM))),
        surfaces=("wall",) * len(ROOM),
    )
    for walls in (arena, None):
        found = orientation(run, walls)
        assert found is not None and found.best == "as logged"
        if walls is not None:
            assert found.fits["as logged"] < 0.01  # [m] 0.67 of the range's noise, and the poses'


@pytest.mark.slow
def test_cells_of_a_sweep_are_as_sharp_as_without() -> None:
    off = {}
    for sweep_time in (SWEEP_TIME, 0.0):
        graph = build([run_of(0, sweep_time=sweep_time, duration=20.0)], model="cells")
        assert isinstance(graph.model, CellModel)
        off[sweep_time] = evaluate(graph, run_of(1, sweep_time=sweep_time, duration=20.0)).all["median_m"]
    assert off[SWEEP_TIME] < 1.1 * off[0.0]  # type: ignore[operator]


def test_polynomial_of_a_sweep_is_as_good_as_without() -> None:
    off = {}
    for sweep_time in (SWEEP_TIME, 0.0):
        run = run_of(0, sweep_time=sweep_time)
        graph = build([run], model="polynomial", degree=2, harmonics=1, n_terms=8)
        off[sweep_time] = evaluate(graph, run_of(1, sweep_time=sweep_time)).all["mae_m"]
    assert off[SWEEP_TIME] < 1.05 * off[0.0]  # type: ignore[operator]


def test_rays_are_where_the_robot_was_between_references() -> None:
    run = run_of(4, duration=20.0)
    exact = replace(run, poses=path(run.pose_stamps))
    pairing = pair(exact)
    found = ray_poses(exact, pairing, np.flatnonzero(pairing.paired))
    truth = path(run.stamps[pairing.paired, None] + run.sensor.ray_delays)
    # between references of 30 Hz
    np.testing.assert_allclose(found[..., :2], truth[..., :2], atol=1e-4)
    np.testing.assert_allclose(np.cos(found[..., 2] - truth[..., 2]), 1.0, atol=1e-7)


def test_odometry_fills_a_slow_reference() -> None:
    run = run_of(4, duration=20.0, pose_rate=5.0, odom_rate=50.0)
    slow = replace(run, poses=path(run.pose_stamps))
    pairing = pair(slow)
    scans = np.flatnonzero(pairing.paired)
    truth = path(run.stamps[scans, None] + run.sensor.ray_delays)

    def error(motion: Motion) -> float:
        return float(np.abs(ray_poses(slow, pairing, scans, motion=motion)[..., :2] - truth[..., :2]).max())

    with_odometry = error(motion_of(slow))
    # cubics through poses of 5 Hz are off by 0.44 mm, where straight lines were off by 1.3 mm
    assert with_odometry < 0.3 * error(motion_of(slow, use_odometry=False))
    assert with_odometry < 1.2e-4


@pytest.mark.parametrize(("tick", "pose_rate", "is_taken"), [(0.005, 30.0, False), (2e-5, 5.0, True)])
def test_coarse_encoders_tell_less_than_a_fast_reference(
    tick: float, pose_rate: float, is_taken: bool
) -> None:
    """Ticks of 5 mm at 100 Hz had bent the motion between the poses of a camera: 2 cm at the end of a ray."""
    run = run_of(4, duration=20.0, pose_rate=pose_rate, odom_rate=100.0)
    steps = tick * np.array([1.0, 1.0, 2 / 0.4])  # the wheels are 0.4 m apart
    coarse = replace(run, poses=path(run.pose_stamps), odometry=np.round(run.odometry / steps) * steps)
    times = np.linspace(1.0, 18.0, 800)
    truth = path(times)

    def error(use_odometry: bool) -> float:
        found = motion_of(coarse, use_odometry=use_odometry).at(times)
        return float(np.abs(found[:, :2] - truth[:, :2]).max())

    if is_taken:
        assert error(True) < 0.3 * error(False)
    else:
        assert error(True) == error(False) < 1e-4


def test_motion_of_laser_poses_takes_the_odometry_of_the_base() -> None:
    run = run_of(4, duration=10.0, pose_rate=5.0, odom_rate=50.0)
    at = path(run.pose_stamps)
    lasers = at + np.stack([-0.03 * np.cos(at[:, 2]), -0.03 * np.sin(at[:, 2]), np.zeros(len(at))], axis=-1)
    motion = motion_of(replace(run, poses=lasers, pose_frame="laser"))
    times = np.linspace(0.5, 9.0, 50)
    truth = path(times)
    truth[:, :2] += -0.03 * np.stack([np.cos(truth[:, 2]), np.sin(truth[:, 2])], axis=-1)
    np.testing.assert_allclose(motion.at(times)[:, :2], truth[:, :2], atol=3e-4)


def test_scan_whose_sweep_outlasts_the_poses_is_dropped_and_counted() -> None:
    run = run_of(5, duration=10.0)
    cut = replace(run, pose_stamps=run.pose_stamps[:-20], poses=run.poses[:-20])
    still = replace(cut, sensor=replace(cut.sensor, sweep_time=0.0))
    assert pair(still).paired.sum() == pair(cut).paired.sum() + 1
    assert pair(cut).dropped["sweeping beyond the poses"] == 1


def test_clockwise_sweep_takes_its_rays_before_the_stamp() -> None:
    run = run_of(5, duration=10.0)
    clockwise = replace(run, sensor=replace(run.sensor, sweep_time=-0.2))
    pairing = pair(clockwise)
    scans = np.flatnonzero(pairing.paired)
    assert not pairing.paired[0]
    first = ray_poses(clockwise, pairing, scans)
    np.testing.assert_allclose(first[:, 0, :2], pairing.poses[scans, :2], atol=1e-9)
    motion = motion_of(clockwise)
    np.testing.assert_allclose(first[:, 45, :2], motion.at(run.stamps[scans] - 0.1)[:, :2], atol=1e-9)


def test_run_without_a_sweep_has_one_pose_a_scan() -> None:
    run = run_of(6, sweep_time=0.0, duration=5.0)
    pairing = pair(run)
    found = ray_poses(run, pairing, np.arange(5))
    np.testing.assert_array_equal(found[:, 0], pairing.poses[:5])
    assert found.shape == (5, 1, 3)
