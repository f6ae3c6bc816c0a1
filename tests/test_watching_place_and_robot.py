"""Watching place and robot in a room of the tests: a box that came, a wall that is gone, people, laser and wheels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from localization_samples import ROOM, loop_poses, room_run, seen
from watching_samples import believing, graph

import sensorgraph as sg
from logs.run import Run
from logs.transforms import compose
from sensorgraph.watching.evidence import Baseline, FaultDoubt, doubt_of
from sensorgraph.watching.laser_errors import MissingReturns, in_a_block
from sensorgraph.watching.odometry_errors import OdometryErrors
from sensorgraph.watching.page import _size
from sensorgraph.watching.policy import healthy
from sensorgraph.watching.settings import DISTANCE_FAULTS, LASER_FAULTS
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.summary import WatchSummary

BOX = [(6.3, 1.2, 6.7, 1.2), (6.7, 1.2, 6.7, 1.6), (6.7, 1.6, 6.3, 1.6), (6.3, 1.6, 6.3, 1.2)]


def laps(
    n_laps: int, *, seed: int, walls: list[tuple[float, float, float, float]] = ROOM, **options: float
) -> Run:
    poses = loop_poses(120 * n_laps, laps=n_laps)
    return believing(room_run(poses, seed=seed, walls=walls, **options), poses)  # type: ignore[arg-type]


def last(run: Run) -> WatchStatus:
    return list(sg.watch(graph(), run))[-1]


def names(status: WatchStatus) -> set[str]:
    return {fault.name for fault in status.faults}


def test_a_box_that_came_is_outlined_by_the_third_pass_and_nothing_else_is() -> None:
    end = last(laps(3, seed=10, walls=[*ROOM, *BOX]))
    (change,) = end.changes
    assert change.kind == "new"
    assert change.passes in (2, 3)
    assert np.abs(change.centre - (6.4, 1.4)).max() < 0.2  # the sides that the robot sees
    assert change.first_seen < 24.0 < change.last_seen


@pytest.mark.slow
def test_the_box_of_the_room_that_was_taken_away_is_gone() -> None:
    end = last(laps(3, seed=11, walls=ROOM[:-4]))
    assert {change.kind for change in end.changes} == {"gone"}
    at = np.array([change.centre for change in end.changes])
    assert (np.abs(at - (3.45, 2.55)) < 0.6).all()  # the box that stood in the middle of the loop


@pytest.mark.slow
def test_a_box_that_is_some_centimetres_smaller_than_in_the_graph_is_not_gone() -> None:
    """Its sides are 4 cm and its corners 5 cm further in: rays that pass them now end at the walls of the room."""
    middle = np.array([3.45, 2.55, 3.45, 2.55])
    smaller = [tuple(middle + 0.9 * (np.array(wall) - middle)) for wall in ROOM[-4:]]
    assert not last(laps(4, seed=11, walls=[*ROOM[:-4], *smaller])).changes  # type: ignore[list-item]


@pytest.mark.slow
def test_people_who_pass_are_no_change_of_the_place() -> None:
    run = laps(2, seed=12)
    rng, ranges = np.random.default_rng(0), run.ranges.copy()
    for k in range(0, run.n_scans, 6):  # one after the other, in any direction, for a second each
        first = int(rng.integers(0, 110))
        near = ranges[k : k + 5, first : first + 8]
        ranges[k : k + 5, first : first + 8] = np.minimum(near, 0.6 + rng.uniform(0.0, 1.0))
    assert not last(replace(run, ranges=ranges)).changes


def test_a_healthy_robot_has_no_named_fault() -> None:
    assert not names(last(laps(2, seed=13)))


def test_a_covered_sector_is_named_and_the_pose_stays_ok() -> None:
    run = laps(1, seed=14)
    ranges = run.ranges.copy()
    ranges[40:, 50:55] = 0.06  # a thumb on 15 degrees, from 8 s
    ranges[40:, 20:25] = 0.06  # another one, far from it
    said = list(sg.watch(graph(), replace(run, ranges=ranges)))
    first = next(status for status in said if names(status))
    assert names(first) == {"blocked_sector"}
    assert 8.0 <= first.t < 13.0
    sector = said[-1].faults[0].parameters
    assert sector["to_rad"] - sector["from_rad"] < np.radians(31)  # one of the two, not all between them
    assert {status.pose.status for status in said} == {"ok"}


def test_a_thing_that_is_gone_before_open_space_blocks_no_sector() -> None:
    """The box in the middle of the loop was taken away, and behind it nothing is within reach."""
    run = laps(2, seed=14)
    without = seen(run.poses, run.sensor.bearings, ROOM[:-4])
    ranges = np.where(without > run.ranges + 0.2, np.inf, run.ranges)
    assert np.isposinf(ranges).mean() > 0.1
    said = list(sg.watch(graph(), replace(run, ranges=ranges)))
    assert not any(names(status) for status in said)


def test_a_sector_that_returns_nothing_any_more_is_named() -> None:
    run = laps(2, seed=14)
    ranges = run.ranges.copy()
    ranges[120:, 50:55] = np.inf  # from 24 s
    first = next(status for status in sg.watch(graph(), replace(run, ranges=ranges)) if names(status))
    assert names(first) == {"blocked_sector"}
    assert 24.0 <= first.t < 29.0


def laps_and_turns() -> np.ndarray:
    """Return poses (n, 3) of laps, a turn on the spot, and laps: on a circle alone, wheels, mount and clock look alike."""
    spin = np.column_stack([np.zeros((60, 2)), np.linspace(0.1, 2 * np.pi, 60)])
    return np.concatenate([loop_poses(240, laps=2), loop_poses(1) + spin, loop_poses(240, laps=2)])


@pytest.mark.slow
def test_wheels_that_measure_too_much_are_named_with_their_size() -> None:
    poses = laps_and_turns()
    (fault,) = last(believing(room_run(poses, seed=15, way_scale=1.05), poses)).faults
    assert fault.name == "wheel_radius"
    assert abs(fault.parameters["scale"] - (1 / 1.05 - 1)) < 3 * fault.stderr["scale"]


@pytest.mark.slow
def test_unequal_wheels_are_named_after_turns_of_several_radii() -> None:
    """On a circle alone, they cannot be told from a turn that is measured wrongly."""
    spin = np.column_stack([np.zeros((60, 2)), np.linspace(0.1, 2 * np.pi, 60)])
    poses = np.concatenate([loop_poses(240, laps=2), loop_poses(1) + spin])
    end = last(believing(room_run(poses, seed=15, heading_bias=0.06), poses))
    assert names(end) == {"wheel_radius_diff"}
    assert abs(end.faults[0].parameters["rad_per_m"] - 0.06) < 3 * end.faults[0].stderr["rad_per_m"]
    assert not names(last(laps(2, seed=15, heading_bias=0.06)))


@pytest.mark.slow
def test_a_turned_mount_is_named_with_its_angle() -> None:
    poses = laps_and_turns()
    run = room_run(poses, seed=16)
    turned = seen(poses + [0.0, 0.0, 0.05], run.sensor.bearings)
    end = last(believing(replace(run, ranges=turned), poses + [0.0, 0.0, 0.05]))
    assert "mount_yaw" in names(end)
    fault = next(fault for fault in end.faults if fault.name == "mount_yaw")
    assert fault.parameters["rad"] == pytest.approx(0.05, abs=3 * fault.stderr["rad"])


@pytest.mark.slow
def test_a_laser_away_from_its_stated_place_is_named_with_its_offset() -> None:
    poses = laps_and_turns()
    run = room_run(poses, seed=16)
    at = poses.copy()
    at[:, 0] += 0.2 * np.cos(poses[:, 2])
    at[:, 1] += 0.2 * np.sin(poses[:, 2])
    end = last(believing(replace(run, ranges=seen(at, run.sensor.bearings)), at))
    assert "mount_x" in names(end) and "mount_y" not in names(end)
    fault = next(fault for fault in end.faults if fault.name == "mount_x")
    assert fault.parameters["m"] == pytest.approx(0.2, abs=3 * fault.stderr["m"])


@pytest.mark.slow
def test_missing_returns_are_named() -> None:
    run = laps(3, seed=17)
    lost = np.random.default_rng(1).uniform(size=run.ranges.shape) < 0.1
    end = last(replace(run, ranges=np.where(lost, np.inf, run.ranges)))
    assert names(end) == {"missing_returns"}
    assert end.faults[0].parameters["share"] == pytest.approx(0.1, abs=0.02)


def test_missing_returns_of_a_robot_that_stands_for_a_day_need_no_further_memory() -> None:
    found, rng = MissingReturns(), np.random.default_rng(0)
    for share in np.where(rng.random(20_000) < 0.3, 0.5, 0.05):  # a door stands open in three of ten scans
        found.add(float(share), 0.125)
    (middle,), (error,) = found.estimates()
    assert middle == pytest.approx(0.05) and 0.0 < error < 0.01
    assert len(found.scans) < 5_000


def test_a_block_of_missing_returns_is_no_random_loss() -> None:
    rng = np.random.default_rng(0)
    asked, lost = np.ones(20_000, dtype=bool), rng.random(20_000) < 0.1
    assert in_a_block(lost, asked).mean() < 0.01
    lost[5000:5010] = True
    assert in_a_block(lost, asked)[5000:5010].all()


@pytest.mark.slow
def test_ranges_that_are_too_long_by_an_offset_are_named() -> None:
    run = laps(3, seed=18)
    end = last(replace(run, ranges=run.ranges + 0.04))
    assert names(end) == {"range_bias"}
    assert end.faults[0].parameters["m"] == pytest.approx(0.04, abs=3 * end.faults[0].stderr["m"])


def test_an_offset_of_the_ranges_is_no_difference_of_the_place() -> None:
    run = laps(2, seed=18)
    good, late = last(run).share_predicted, last(replace(run, ranges=run.ranges + 0.04)).share_predicted
    assert good is not None and late == pytest.approx(good, abs=0.02)


def test_an_offset_of_the_ranges_moves_neither_the_tracked_pose_nor_the_mount() -> None:
    """A laser that looks ahead and reads too long seems to stand further back."""
    poses = np.concatenate(
        [loop_poses(80), loop_poses(1) + [0.0, 0.0, 1.0] * np.linspace(0.1, 2 * np.pi, 40)[:, None]]
    )
    run = room_run(poses, seed=18)
    ranges = np.where(np.abs(run.sensor.bearings) < np.pi / 2, run.ranges + 0.04, np.nan)
    end = last(believing(replace(run, ranges=ranges), poses))
    assert names(end) == {"range_bias"}
    assert end.pose.pose is not None
    assert np.hypot(*(end.pose.pose - poses[-1])[:2]) < 0.005
    mount = next(doubt for doubt in end.doubts if doubt.name == "mount_x")
    assert abs(mount.parameters["m"]) < 0.01


@pytest.mark.parametrize("fault", [*DISTANCE_FAULTS, *LASER_FAULTS], ids=lambda fault: fault.name)
def test_evidence_grows_with_the_size_and_is_against_a_fault_at_the_baseline(fault) -> None:  # type: ignore[no-untyped-def]
    base = Baseline(value=0.01, tolerance=0.0)
    nats = [doubt_of(fault, 0.01 + k * fault.size, fault.tolerance, -8.0, base).nats for k in (0.0, 0.3, 1.0)]
    assert nats[0] < 0
    assert nats == sorted(nats)


@pytest.mark.parametrize("error", [0.001, 0.006])
def test_many_good_minutes_show_what_a_robot_varies_by_and_not_the_error_of_its_measurement(
    error: float,
) -> None:
    fault, rng = DISTANCE_FAULTS[0], np.random.default_rng(0)
    sizes = 0.02 + 0.004 * rng.normal(size=400) + error * rng.normal(size=400)
    found = healthy(fault, sizes, np.full(400, error))
    assert found.value == pytest.approx(0.02, abs=0.001)
    assert found.tolerance == pytest.approx(0.004, rel=0.2)


def test_two_good_minutes_show_hardly_more_than_was_assumed() -> None:
    """The baseline itself is as uncertain as one estimate, which adds to the tolerance."""
    fault, error = DISTANCE_FAULTS[0], 0.003
    found = healthy(fault, np.array([0.02, 0.02]), np.full(2, error))
    expected = np.sqrt(2 * fault.tolerance**2 + error**2)
    assert 0.7 * expected < found.tolerance < 1.1 * expected


def test_a_standard_error_from_few_measurements_is_weaker_evidence() -> None:
    fault = DISTANCE_FAULTS[0]
    nats = [doubt_of(fault, 0.05, 0.01, -8.0, freedom=freedom).nats for freedom in (3.0, 10.0, 100.0, 1e7)]
    assert nats == sorted(nats) and nats[0] < 0.5 * nats[-1]
    assert nats[-1] == pytest.approx(doubt_of(fault, 0.05, 0.01, -8.0).nats, rel=1e-4)
    unknown = doubt_of(fault, 0.0, math.inf, -8.0)
    assert unknown.nats == 0.0 and unknown.p == pytest.approx(math.exp(-8.0), rel=1e-3)


def test_the_filter_of_the_wheels_recovers_what_a_drive_was_made_with() -> None:
    """A drive whose odometry is made here, with exact poses: every error at once."""
    rng = np.random.default_rng(2)
    truth = np.array([0.03, -0.04, 0.02, 0.03, 0.06, -0.05, 0.05])  # as DISTANCE_FAULTS
    found, pose, phi = OdometryErrors(), np.zeros(3), 0.0
    twist = np.array([0.5, 0.0])
    for k in range(800):
        if k % 20 == 0:
            twist = np.array([rng.uniform(0.0, 0.8), rng.uniform(-1.0, 1.0)])
        dt = 0.2
        step = np.array([twist[0] * dt, 0.0, twist[1] * dt])  # of the odometry
        way, turn = (1 + truth[0]) * step[0], (1 + truth[1]) * step[2] + truth[2] * step[0]
        pose = pose + [way * np.cos(phi), way * np.sin(phi), 0.0]
        phi += turn
        late = np.array([np.cos(phi), np.sin(phi), 0.0]) * twist[0] * truth[6]
        there = phi + twist[1] * truth[6] + truth[3]  # the heading that is stated
        c, s = np.cos(there), np.sin(there)
        mount = [c * truth[4] - s * truth[5], s * truth[4] + c * truth[5]]
        tracked = np.array([*((pose + late)[:2] + mount), there])
        found.add(step, twist, tracked)
    values, errors = found.estimates()
    assert (np.abs(values - truth) < np.maximum(3 * errors, 0.004)).all(), (values, errors)


@pytest.mark.parametrize(
    ("name", "parameters", "stderr", "words"),
    [
        ("latency", {"s": -0.1112}, {"s": 0.01}, "latency: scans 111 ± 10 ms older than their stamps"),
        (
            "wheel_radius_diff",
            {"rad_per_m": 0.0244},
            {"rad_per_m": 0.0043},
            "heading bias +1.40 ± 0.25°/m",
        ),
        ("blocked_sector", {"from_rad": -0.2, "to_rad": 0.1}, {}, "blocked sector from −11.5° to 5.73°"),
    ],
)
def test_sizes_have_units_of_readers(
    name: str, parameters: dict[str, float], stderr: dict[str, float], words: str
) -> None:
    doubt = FaultDoubt(name=name, p=1.0, parameters=parameters, stderr=stderr, nats=30.0)
    assert doubt.sentence() == words


def test_a_shorter_reach_covers_nothing_and_odometry_in_millimetres_is_left_out() -> None:
    run = laps(1, seed=14)
    sensor = replace(run.sensor, range_max=2.5)
    ranges = np.where(run.ranges > 2.5, np.inf, run.ranges)
    end = last(replace(run, sensor=sensor, ranges=ranges, odometry=run.odometry * [1e3, 1e3, 1.0]))
    assert not names(end)
    assert end.pose.status == "ok"


def test_a_robot_that_is_never_where_the_graph_knows_the_place_is_a_warning() -> None:
    summary = WatchSummary()
    summary.n_statements = summary.n_outside = 3
    summary.conclude()
    assert summary.level == "warning" and "in another frame than the graph" in summary.reason
    seen_once = WatchSummary()
    seen_once.n_statements, seen_once.n_outside = 3, 2
    seen_once.conclude()
    assert seen_once.level == "ok"
    assert seen_once.reason.startswith("the pose was not judged in 2 of 3 statements")


@pytest.mark.parametrize("late", [-0.2, 0.2])
def test_the_filter_that_loses_the_pose_in_turns_finds_the_time_error_all_the_same(late: float) -> None:
    rng = np.random.default_rng(3)
    found, pose, twist = OdometryErrors(), np.zeros(3), np.zeros(2)
    for k in range(300):
        if k % 20 == 0:
            twist = np.array([0.4, rng.uniform(-1.0, 1.0)])
        if k % 10 == 5:
            found.forget_pose()
        step = np.array([0.2 * twist[0], 0.0, 0.2 * twist[1]])
        pose = compose(pose, step)
        found.add(step, twist, compose(pose, late * np.array([twist[0], 0.0, twist[1]])))
    values, errors = found.estimates()
    assert abs(values[-1] - late) < 3 * errors[-1] + 0.02
    assert np.abs(values[:2]).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("late", [-0.15, 0.15])
def test_a_latency_of_either_sign_is_named_alone(late: float) -> None:
    """The speed of the robot changes; the twist at the time of a scan lies between two steps of the odometry."""
    angle = np.cumsum(0.06 + 0.04 * np.sin(0.3 * np.arange(240)))
    poses = np.column_stack([3.2 + 1.5 * np.cos(angle), 2.6 + 1.5 * np.sin(angle), angle + np.pi / 2])
    run = believing(room_run(poses, seed=19), poses)
    at = run.stamps + late
    true = np.column_stack([np.interp(at, run.stamps, column) for column in poses.T])
    end = last(replace(run, ranges=seen(true, run.sensor.bearings)))
    assert names(end) == {"latency"}
    assert end.faults[0].parameters["s"] == pytest.approx(late, abs=0.05)


@pytest.mark.slow
def test_odometry_that_neither_slip_nor_an_encoder_explains_is_unlike_the_motion() -> None:
    run = laps(2, seed=20)
    end = last(replace(run, odometry=run.odometry[:, [1, 0, 2]]))
    fault = next(fault for fault in end.faults if fault.name == "odometry_unlike_motion")
    assert 0.3 < fault.parameters["share"] <= 1.0


def test_the_page_states_no_size_that_the_drive_does_not_show() -> None:
    """A robot that only stood had wheels of −382 ± 2010 % on its page."""
    for error, shown in ((20.1, "not shown by this drive"), (0.004, "distance scale +1.2 ± 0.4 %")):
        doubt = FaultDoubt(
            name="wheel_radius", p=0.0, parameters={"scale": 0.012}, stderr={"scale": error}, nats=0.0
        )
        assert _size(doubt) == shown
