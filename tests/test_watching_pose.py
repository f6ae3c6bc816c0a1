"""Watching the pose of a robot in a room that a ray caster of the tests draws: ok, off, lost, and outside the graph."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from localization_samples import loop_poses, room_run, seen
from watching_samples import believing, graph

import sensorgraph as sg
from logs.run import RangeSensor, Run
from logs.transforms import compose
from sensorgraph.watching.kept_scans import KeptScans
from sensorgraph.watching.modes import Mode
from sensorgraph.watching.observation import Observation, observations
from sensorgraph.watching.pose import PoseJudge
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.scan_input import at_stamp, changed_share, view_of
from sensorgraph.watching.settings import TRACKING
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.tracker import PoseTracker
from sensorgraph.watching.watcher import Watcher

CARRIED = np.array([6.5, 1.5, 1.0])
"""[m, m, rad] Another place in the room."""


def last(run: Run) -> WatchStatus:
    return list(sg.watch(graph(), run))[-1]


@pytest.mark.parametrize("model", ["faces", *further("cells")])
def test_a_robot_that_is_right_is_ok_and_followed_within_centimetres(model: str) -> None:
    poses = loop_poses(60, laps=0.5)
    said = list(sg.watch(graph(model), believing(room_run(poses, seed=2), poses)))
    assert {status.pose.status for status in said} == {"ok"}
    at = said[-1].pose.pose
    assert at is not None
    assert np.hypot(*(at - poses[round(5 * said[-1].t)])[:2]) < 0.05  # cells of 5 cm
    assert len(said) == pytest.approx(12, abs=2)  # one a second


def test_a_robot_without_odometry_that_swings_is_ok() -> None:
    """Between two tracked scans nothing tells its motion: a statement takes the scan at its time."""
    poses = loop_poses(150, laps=1.2)
    poses[:, 2] += 0.7 * np.sin(2 * np.pi * np.arange(150) / 13)  # turns at up to 1.7 rad/s
    run = believing(room_run(poses, seed=12), poses)
    silent = replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))
    said = list(sg.watch(graph(), silent))
    assert len(said) > 25
    assert {status.pose.status for status in said} == {"ok"}


def test_a_belief_put_off_by_half_a_metre_is_off_within_five_seconds() -> None:
    poses = loop_poses(120)
    believed = poses.copy()
    believed[60:, 0] += 0.5
    said = list(sg.watch(graph(), believing(room_run(poses, seed=3), believed)))
    assert all(status.pose.status == "ok" for status in said if status.t < 11.9)
    first = next(status for status in said if status.pose.status != "ok")
    assert first.pose.status == "off"
    assert first.t - 12.0 < 5.0
    assert first.pose.offset[0] == pytest.approx(0.5, abs=0.06)
    assert first.pose.since == first.t


def test_a_robot_that_was_carried_is_found_where_it_is() -> None:
    poses = loop_poses(60)
    there = np.column_stack(
        [CARRIED[0] + np.zeros(60), np.full(60, CARRIED[1]), CARRIED[2] + np.linspace(0.0, 2.0, 60)]
    )
    before, after = room_run(poses, seed=4), room_run(there, seed=5)
    run = replace(
        room_run(np.concatenate([poses, there]), seed=4), ranges=np.concatenate([before.ranges, after.ranges]),
        odometry=np.concatenate([before.odometry, before.odometry[-1] + after.odometry * [0, 0, 1]]),
    )  # fmt: skip
    believed = np.concatenate([poses, poses[-1] + after.odometry * [0, 0, 1]])
    said = list(sg.watch(graph(), believing(run, believed)))
    wrong = [status for status in said if status.pose.status in ("off", "lost")]
    assert wrong
    assert wrong[0].t - 12.0 < 5.0
    end = said[-1].pose
    assert end.status == "off"
    assert end.pose is not None
    assert np.hypot(*(end.pose - there[-1])[:2]) < 0.1


@pytest.mark.parametrize("turned", [0.0, 0.04])
def test_a_carried_robot_is_said_within_two_seconds_whether_it_stands_or_turns(turned: float) -> None:
    poses = loop_poses(60)
    there = np.column_stack(
        [np.full(30, CARRIED[0]), np.full(30, CARRIED[1]), CARRIED[2] + turned * np.arange(30)]
    )
    before, after = room_run(poses, seed=9), room_run(there, seed=10)
    moved = np.column_stack([np.zeros((30, 2)), turned * np.arange(30)])
    run = replace(
        room_run(np.concatenate([poses, there]), seed=9), ranges=np.concatenate([before.ranges, after.ranges]),
        odometry=np.concatenate([before.odometry, before.odometry[-1] + moved]),
    )  # fmt: skip
    said = list(sg.watch(graph(), believing(run, np.concatenate([poses, poses[-1] + moved]))))
    wrong = [status.t for status in said if status.pose.status in ("off", "lost")]
    assert wrong and 12.0 <= wrong[0] < 14.2


def test_a_search_leaves_out_the_scans_from_before_the_tracking_failed() -> None:
    poses = loop_poses(60)[:3]
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    first, second, third = (
        replace(tracker.update(one), drift=np.array([k, 0.0, 0.0]))
        for k, one in enumerate(observations(believing(room_run(poses), poses)))
    )
    kept = KeptScans(TRACKING)
    kept.add(first, fits=True)
    kept.add(second, fits=False)
    assert np.array_equal(kept.view().points, view_of([second]).points)
    kept.add(third, fits=True)
    assert np.array_equal(kept.view().points, view_of([first, second, third]).points)


def test_what_changed_since_the_last_scan_is_counted_over_the_readings_of_both() -> None:
    before = np.array([1.0, 2.0, np.inf, np.inf, np.nan, 3.0])
    now = np.array([1.1, 2.5, np.inf, 4.0, 1.0, np.nan])
    assert changed_share(before, now, 0.15) == 2 / 4
    assert changed_share(before[4:], now[4:], 0.15) == 0.0


def test_without_a_belief_the_robot_is_found() -> None:
    poses = loop_poses(60)
    end = last(room_run(poses, seed=6))
    assert (end.pose.status, end.pose.is_believed) == ("ok", False)
    assert end.pose.pose is not None
    assert np.hypot(*(end.pose.pose - poses[round(5 * end.t)])[:2]) < 0.05


SLANTED = [(-1.0, -9.0, 15.0, -9.0), (15.0, -9.0, 9.0, 7.0), (9.0, 7.0, -4.0, 4.0), (-4.0, 4.0, -1.0, -9.0)]
OFFICE = [
    (0.0, 0.0, 6.6, 0.0), (6.6, 0.0, 6.6, 5.4), (6.6, 5.4, 0.0, 5.4), (0.0, 5.4, 0.0, 0.0), (0.4, 4.4, 1.6, 4.4), (1.6, 4.4, 1.6, 5.0),
]  # fmt: skip
"""Rooms other than that of the graph; the second has right angles as well, and about its size."""


@pytest.mark.parametrize(
    ("walls", "is_believed", "seed"),
    [
        (SLANTED, False, 7), (OFFICE, True, 7),
        *further((SLANTED, True, 7), (OFFICE, False, 7), (SLANTED, False, 10), (SLANTED, True, 15)),
    ],
)  # fmt: skip
def test_a_robot_in_another_room_is_lost_whatever_it_believes(
    walls: list[tuple[float, float, float, float]], is_believed: bool, seed: int
) -> None:
    t = np.linspace(0.0, 5.0, 100)
    poses = np.column_stack([3.2 + 1.5 * np.cos(t), 2.6 + 1.5 * np.sin(t), t + np.pi / 2])
    run = room_run(poses, seed=seed, walls=walls)
    said = list(sg.watch(graph(), believing(run, poses) if is_believed else run))
    assert {status.pose.status for status in said if status.t > 5.0} == {"lost"}


@pytest.mark.parametrize("offset", [0.05, *further(-0.05)])
def test_a_laser_whose_ranges_are_off_by_centimetres_is_followed(offset: float) -> None:
    poses = loop_poses(60, laps=0.5)
    run = room_run(poses, seed=2)
    said = list(sg.watch(graph(), believing(replace(run, ranges=run.ranges + offset), poses)))
    assert {status.pose.status for status in said if status.t > 5.0} == {"ok"}


def test_a_robot_that_starts_with_a_wrong_belief_is_off_from_where_it_is() -> None:
    poses = loop_poses(60)
    said = list(sg.watch(graph(), believing(room_run(poses, seed=6), np.roll(poses, 20, axis=0))))
    assert {status.pose.status for status in said if status.t > 2.0} == {"off"}
    assert said[-1].pose.offset[0] == pytest.approx(2.6, abs=0.3)  # a third of a lap is 120°: sqrt(3) * 1.5 m


def test_a_robot_that_was_surrounded_by_people_is_ok_soon_after() -> None:
    poses = loop_poses(150, laps=1.5)
    run = room_run(poses, seed=6)
    ranges = run.ranges.copy()
    ranges[40:90] = np.minimum(
        ranges[40:90], np.random.default_rng(0).uniform(0.5, 1.5, (50, run.sensor.n_rays))
    )
    said = list(sg.watch(graph(), believing(replace(run, ranges=ranges), poses)))
    assert any(status.pose.status == "lost" for status in said if 8.0 < status.t < 18.0)
    assert {status.pose.status for status in said if status.t > 18.0 + 4.0} == {"ok"}


def test_a_stopped_pose_a_clock_that_goes_back_and_a_foreign_scan_are_noted_and_it_goes_on() -> None:
    poses = loop_poses(60)
    each = list(observations(believing(room_run(poses, seed=8), poses)))
    watcher = Watcher(graph())
    each[20:] = [replace(one, believed=None) for one in each[20:]]
    each.insert(30, replace(each[30], stamp=each[30].stamp - 1.0))
    each.insert(40, Observation(stamp=each[40].stamp, ranges=np.ones(3)))
    each[50:] = [replace(one, stamp=one.stamp - 1000.0) for one in each[50:]]
    said = [status for one in each if (status := watcher.add(one)) is not None]
    notes = " ".join(note for status in said for note in status.notes)
    for words in ("states no pose", "went back by", "3 rays, expected 120", "jumped from"):
        assert words in notes
    assert said[-1].t < 0
    assert said[-1].pose.status == "ok"


def test_a_laser_with_other_rays_is_refused_in_one_line() -> None:
    with pytest.raises(sg.errors.SensorgraphError, match="built with this laser"):
        next(iter(sg.watch(graph(), room_run(loop_poses(5), n_rays=60))))


def test_where_the_graph_knows_nothing_disagreement_is_no_evidence_but_agreement_is() -> None:
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    judge = PoseJudge(tracker)
    for _ in range(20):
        unknown = judge.p_off(1e-6, known=0.0)
    assert unknown == pytest.approx(judge.p_off(0.5), abs=1e-9) and unknown < 0.05
    for _ in range(3):
        known = judge.p_off(1e-6)
    assert known > 0.9
    assert (
        PoseJudge(tracker).p_off(1e-9, offset=(2.0, 0.0)) > 0.9
    )  # no error of a stamp reaches 2 m: said at once
    assert judge.p_off(1.0, known=0.0) < known


@pytest.mark.parametrize(("handicap", "status"), [(-math.log(TRACKING.belief), "ok"), (0.0, "off")])
def test_the_small_prior_of_a_belief_that_contradicts_the_tracking_is_no_evidence(
    handicap: float, status: str
) -> None:
    """But a pose that was tracked, and is now improbable by as much, is wrong: its readings say so."""
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    believed = np.array([5.0, 2.0, 0.0])
    scan = Observation(stamp=1.0, ranges=np.full(graph().sensor.n_rays, 2.0), believed=believed)
    there = Mode(
        pose=np.array([3.0, 2.0, 0.0]), covariance=1e-4 * np.eye(3), score=math.log(0.99), number=1, is_matched=True, answered=1.0
    )  # fmt: skip
    tracker.elsewhere = -math.inf
    tracker.modes = [
        there,
        replace(there, pose=believed, score=math.log(TRACKING.belief), number=2, handicap=handicap),
    ]
    assert PoseJudge(tracker).state(scan).status == status


def test_a_lost_robot_is_not_ok_because_nothing_known_is_in_sight() -> None:
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    nothing = Observation(
        stamp=1.0, ranges=np.full(graph().sensor.n_rays, np.inf), believed=np.array([9.0, 9.0, 0.0])
    )
    tracker.elsewhere = math.log(0.2)
    words = {}
    for deviation in (0.05, 3.0):  # [m]
        covariance = np.diag([deviation**2, deviation**2, 0.01])
        tracker.modes = [
            Mode(pose=np.array([9.0, 9.5, 0.0]), covariance=covariance, score=math.log(0.8), number=1)
        ]
        for before in ("ok", "lost"):
            judge = PoseJudge(tracker)
            judge.before = before
            words[before, deviation] = judge.state(nothing).status
    assert words == {("ok", 0.05): "ok", ("lost", 0.05): "ok", ("ok", 3.0): "ok", ("lost", 3.0): "lost"}


@pytest.mark.parametrize("jump", [0.0, 1.0])
def test_outside_the_graph_a_belief_is_not_judged(jump: float) -> None:
    poses = np.column_stack([40.0 + 0.05 * np.arange(60), np.full(60, 40.0), np.zeros(60)])
    run = room_run(poses, seed=7, walls=[(39.0, 39.0, 45.0, 39.0), (39.0, 41.5, 45.0, 41.5)])
    believed = poses.copy()
    believed[30:, 1] += jump
    said = [status.pose for status in sg.watch(graph(), believing(run, believed))]
    assert not any(pose.is_known_place for pose in said)
    assert {pose.status for pose in said} == {"ok"}
    assert all(pose.sentence().endswith("is not judged") for pose in said)


def test_a_robot_that_is_pushed_and_believes_it_is_not_said_to_be_off() -> None:
    t = 0.1 * np.arange(120)
    x, y = 3.2 + 1.5 * np.cos(0.5 * t), 2.6 + 1.5 * np.sin(0.5 * t)
    poses = np.column_stack([x, y, 0.5 * t + np.pi / 2 + np.sin(0.9 * t)])
    run = room_run(poses, rate=10.0, seed=6)
    odometry = run.odometry.copy()
    odometry[40:] = odometry[40]
    said = list(sg.watch(graph(), believing(replace(run, odometry=odometry), poses)))
    assert {status.pose.status for status in said} == {"ok"}


def test_a_laser_all_of_whose_rays_count_as_covered_is_still_watched() -> None:
    poses = loop_poses(4)
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    for observation in observations(believing(room_run(poses), poses)):
        tracker.update(observation)
        tracker.usable[:] = False
    assert tracker.main is not None and np.hypot(*(tracker.main.pose - poses[-1])[:2]) < 0.05


def test_the_readings_of_a_sweep_are_those_at_the_stamp_of_its_scan() -> None:
    bearings = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    sensor = RangeSensor(bearings=bearings, range_max=20.0, sigma=0.01, rate=10.0, sweep_time=0.1)
    velocity = np.array([0.4, 0.0, 1.0])
    pose = np.array([2.0, 1.2, 0.3])
    rays = compose(pose, sensor.ray_delays[:, None] * velocity)
    swept = np.array([seen(ray[None], bearings[k : k + 1])[0, 0] for k, ray in enumerate(rays)])
    still = seen(pose[None], bearings)[0]
    found = at_stamp(sensor, Observation(stamp=0.0, ranges=swept), velocity).ranges
    assert np.median(np.abs(swept - still)) > 0.02
    both = np.isfinite(found)  # no ray looked into the angle by which the robot turned during the sweep
    assert both.mean() > 0.95
    assert np.quantile(np.abs(found - still)[both], 0.9) < 0.01


@pytest.mark.parametrize(("believed", "status"), [((4.0, 3.0, 1.0), "off"), ((5.0, 2.0, 0.0), "ambiguous")])
def test_a_belief_at_none_of_several_possible_poses_is_off(
    believed: tuple[float, float, float], status: str
) -> None:
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    scan = Observation(stamp=1.0, ranges=np.full(graph().sensor.n_rays, 2.0), believed=np.array(believed))
    first = Mode(
        pose=np.array([5.0, 2.0, 0.0]), covariance=1e-4 * np.eye(3), score=math.log(0.5), number=1, is_matched=True, answered=1.0
    )  # fmt: skip
    tracker.elsewhere = -math.inf
    tracker.modes = [first, replace(first, pose=np.array([1.0, 3.0, 0.5]), number=2)]
    judge = PoseJudge(tracker)
    said = [judge.state(scan) for _ in range(5)][-1]
    assert said.status == status
    assert "(5.00, 2.00) m" in said.sentence() and "(1.0, 3.0) m" in said.sentence()


def test_a_robot_that_is_lost_or_off_is_not_ok_because_neither_is_the_more_probable_half() -> None:
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    believed = np.array([4.0, 3.0, 1.0])
    scan = Observation(stamp=1.0, ranges=np.full(graph().sensor.n_rays, 2.0), believed=believed)
    there = Mode(
        pose=np.array([5.0, 2.0, 0.0]), covariance=1e-4 * np.eye(3), score=math.log(0.505), number=1, is_matched=True, answered=1.0
    )  # fmt: skip
    tracker.elsewhere = math.log(0.495)
    tracker.modes = [there]
    judge = PoseJudge(tracker)
    said = [judge.state(scan) for _ in range(5)][-1]
    assert said.p_wrong > 0.9 and said.p < 0.5
    assert said.status in ("off", "lost")
