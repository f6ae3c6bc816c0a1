"""Runs in a place that nobody has mapped: tracking, loops, wheels, and how well the poses are known."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from localization_samples import ROOM, any_times, loop_poses, room_run, timed, untimed

from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.errors import SensorgraphError
from sensorgraph.localization.front_end import Tracker, track
from sensorgraph.localization.locate import locate
from sensorgraph.localization.loop_closures import LoopCloser
from sensorgraph.localization.mapping import map_run
from sensorgraph.localization.matching import Match
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.pose_graph import PoseEdges, PoseGraph, _gtsam
from sensorgraph.localization.result import Localization
from sensorgraph.localization.scans import scan_points
from sensorgraph.localization.settings import CLOSURES
from sensorgraph.localization.submaps import cut_submaps
from sensorgraph.localization.wheels import corrected_steps, identify_wheels
from sensorgraph.types import no_progress


def aligned(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (n, 3) after the best rigid motion of all places, and its turn (3, 3)."""
    a, b = found[:, :2] - found[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    heading = (found[:, 2] + angle - truth[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return np.column_stack([a @ turn[:2, :2].T - b, heading]), turn


def rms(found: Localization, truth: np.ndarray) -> float:
    errors, _ = aligned(found.poses, truth)
    return float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))


def carried(one: Run, two: Run) -> Run:
    """Return two runs as one whose wheels did not notice that the robot was carried in between."""
    odometry = compose(one.odometry[-1], two.odometry)
    stamps = np.concatenate([one.stamps, two.stamps + one.stamps[-1] + 0.2])
    odometry = np.concatenate([one.odometry, odometry])
    return replace(
        one, stamps=stamps, ranges=np.concatenate([one.ranges, two.ranges]), odom_stamps=stamps, odometry=odometry,
        odom_twists=np.zeros((len(stamps), 2)),
    )  # fmt: skip


def no_ticks(done: int, total: int) -> None:
    """Show nothing."""


TRUTH = loop_poses(160, laps=2)


@pytest.fixture(scope="module", params=[timed, *further(untimed)])
def located(request: pytest.FixtureRequest) -> Localization:
    return map_run(request.param(room_run(TRUTH, way_scale=0.97, heading_bias=0.05)))


def test_two_laps_come_out_within_half_a_centimetre(located: Localization) -> None:
    assert set(located.status) == {"ok"}
    assert rms(located, TRUTH) < 0.005  # 120 returns of 1 cm a scan
    assert located.kept


def test_first_pose_is_the_odometrys(located: Localization) -> None:
    np.testing.assert_allclose(located.poses[0], 0.0, atol=1e-9)


def test_stated_covariances_cover_the_truth(located: Localization) -> None:
    errors, turn = aligned(located.poses, TRUTH)
    sd = np.sqrt(np.einsum("fii->fi", turn @ located.covariances @ turn.T))
    inside = (np.abs(errors) < 2 * sd).mean(axis=0)
    assert (
        inside > 0.85
    ).all()  # of one run, whose errors hang together; benchmarks/locate.py has the mean of many
    assert (np.sqrt((errors / sd) ** 2).mean(axis=0) > 0.3).all()


def test_reference_poses_are_not_looked_at() -> None:
    run = room_run(TRUTH[:20])
    other = map_run(replace(run, pose_stamps=run.stamps, poses=TRUTH[:20] * 2))
    np.testing.assert_array_equal(other.poses, map_run(run).poses)


@any_times
def test_without_odometry_scans_alone_do_and_it_is_said(times: Callable[[Run], Run]) -> None:
    run = room_run(TRUTH[:90])
    none = Run(sensor=run.sensor, stamps=run.stamps, ranges=run.ranges)
    found = map_run(times(none))
    assert rms(found, TRUTH[:90]) < 0.01
    assert any("scan matching alone" in note for note in found.notes)


@any_times
def test_odometry_that_jumps_is_survived_and_said(times: Callable[[Run], Run]) -> None:
    run = room_run(TRUTH[:80])
    odometry = run.odometry.copy()
    odometry[40:, :2] += [3.0, -2.0]
    found = map_run(times(replace(run, odometry=odometry)))
    assert rms(found, TRUTH[:80]) < 0.01
    assert any("jumps 1 times, first at 8.0 s" in note for note in found.notes)


def test_one_scan_has_the_pose_of_the_odometry() -> None:
    run = room_run(TRUTH[:1])
    found = map_run(run)
    np.testing.assert_allclose(found.poses, np.zeros((1, 3)), atol=1e-12)


@pytest.mark.slow
def test_scan_of_few_returns_lies_where_the_scans_beside_it_have_it() -> None:
    run, few = room_run(TRUTH), np.arange(7, len(TRUTH), 7)
    ranges = run.ranges.copy()
    ranges[few[:, None], np.arange(14, 120)] = np.inf  # something leaves the laser a ninth
    found = map_run(replace(run, ranges=ranges))
    off, _ = aligned(found.poses, TRUTH)
    assert set(found.status) == {"ok"}
    assert np.hypot(off[few, 0], off[few, 1]).max() < 0.012  # 0.014 m and 0.28 deg by these scans alone
    assert np.abs(off[few, 2]).max() < np.radians(0.2)


@any_times
def test_scan_that_tracking_misses_while_the_wheels_slip_is_matched_from_the_scans_around_it(
    times: Callable[[Run], Run],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses, matched = loop_poses(60), Tracker._match
    run, missed = room_run(poses), 37
    odometry = run.odometry.copy()
    slip = compose(compose(odometry[missed], np.array([-0.1, 0.06, 0.05])), invert(odometry[missed]))
    odometry[missed:] = compose(slip, odometry[missed:])
    slipped = replace(run, odometry=odometry)
    monkeypatch.setattr(
        Tracker, "_match", lambda self, k, *of: matched(self, k, *of) if k != missed else None
    )
    found = map_run(times(slipped))
    off, _ = aligned(found.poses, poses)
    assert set(found.status) == {"ok"}
    assert np.hypot(*off[missed - 2 : missed + 3, :2].T).max() < 0.01  # 0.1 m by the odometry


def test_scans_that_see_nothing_are_lost_and_said() -> None:
    run = room_run(TRUTH[:5])
    found = map_run(replace(run, ranges=np.full_like(run.ranges, np.inf)))
    assert set(found.status) == {"lost"}
    assert "no pose can be estimated" in found.notes[0]


def test_wheels_are_told_apart_by_steps_that_differ() -> None:
    rng = np.random.default_rng(0)
    steps = np.column_stack([rng.uniform(-0.3, 0.3, 200), np.zeros(200), rng.uniform(-0.3, 0.3, 200)])
    moved = corrected_steps(steps, 0.96, 0.97, 0.055) + 0.002 * rng.normal(size=(200, 3))
    moved[:10] += 0.5  # slip
    found = identify_wheels(steps, moved)
    for value, sd, true in (
        (found.way_scale, found.way_scale_sd, 0.96),
        (found.turn_scale, found.turn_scale_sd, 0.97),
        (found.heading_bias, found.heading_bias_sd, 0.055),
    ):
        assert abs(value - true) < 4 * sd + 1e-3  # the sides of a curved step differ by a little
        assert sd < 0.01


def test_view_goes_on_while_a_robot_drives_and_breaks_where_it_is_carried() -> None:
    one, two = room_run(TRUTH[:60]), room_run(TRUTH[60:] + [2.0, -1.0, 1.0], seed=1)
    odometry = np.concatenate([one.odometry, compose(one.odometry[-1], two.odometry)])
    carried = replace(room_run(TRUTH), ranges=np.concatenate([one.ranges, two.ranges]), odometry=odometry)
    for run, first in ((room_run(TRUTH), []), (carried, [60])):
        tracked = track(scan_points(run), run.stamps, run.odometry, no_progress)
        assert np.flatnonzero(~tracked.is_continuous)[:1].tolist() == first


@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_robot_that_is_pushed_while_its_wheels_stand_is_followed_by_its_scans(speed: float) -> None:
    box = [(-2, -1.2, 9, -1.2), (-2, 1.2, 9, 1.2), (-2, -1.2, -2, 1.2), (9, -1.2, 9, 1.2)]
    posts = [(x, 1.2, x, 0.8) for x in (-1, 0.7, 1.9, 3.2, 5.0, 6.1, 7.5)]
    posts += [(x, -1.2, x, -0.7) for x in (-0.4, 1.3, 2.6, 4.4, 5.6, 7.0)]
    x = np.concatenate([np.arange(0, 3, 0.05), np.arange(3, 6, speed / 5)])
    run = room_run(np.column_stack([x, np.zeros((len(x), 2))]), walls=[*box, *posts], n_rays=180)
    odometry = run.odometry.copy()
    odometry[60:] = odometry[60]
    tracked = track(scan_points(run), run.stamps, odometry, no_progress)
    assert (
        np.abs(tracked.poses[:, 0] - x).max() < 0.5 * speed
    )  # what it moves until a standing robot is looked at again


@pytest.mark.parametrize("times", [0.5, 2.0, 3.0])
def test_odometry_far_from_what_is_believed_is_told_by_its_factor_after_few_steps(times: float) -> None:
    rng = np.random.default_rng(1)
    moved = np.column_stack([rng.normal(0.3, 0.05, 20), np.zeros(20), rng.normal(0, 0.1, 20)])
    found = identify_wheels(moved * [times, times, 1.0] * (1 + 0.02 * rng.normal(size=(20, 1))), moved)
    assert found.way_scale == pytest.approx(1 / times, abs=4 * found.way_scale_sd)
    assert found.way_scale_sd < 0.02 / times and found.turn_scale == pytest.approx(1.0, abs=0.02)


def test_slip_of_the_wheels_does_not_make_their_scales_small() -> None:
    rng = np.random.default_rng(2)
    moved = np.column_stack([rng.normal(0.2, 0.05, 600), np.zeros(600), rng.normal(0, 0.05, 600)])
    steps = moved / [0.98, 1.0, 1.0]
    steps[:, 2] = (moved[:, 2] - 0.04 * steps[:, 0]) / 1.02
    steps += rng.normal(size=(600, 3)) * [0.01, 0.0, 0.02]  # the wheels' own noise, of a third of the turns
    found = identify_wheels(steps, moved)
    assert found.way_scale == pytest.approx(0.98, abs=0.01)
    assert found.turn_scale == pytest.approx(1.02, abs=4 * found.turn_scale_sd) and found.turn_scale_sd < 0.03
    assert found.heading_bias == pytest.approx(0.04, abs=4 * found.heading_bias_sd)


def test_false_closures_are_told_from_true_ones() -> None:
    n = 40
    angle = np.linspace(0, 4 * np.pi, n, endpoint=False)
    truth = np.column_stack([3 * np.cos(angle), 3 * np.sin(angle), angle + np.pi / 2])
    rng = np.random.default_rng(1)

    def relative(a: int, b: int) -> np.ndarray:
        d, (c, s) = truth[b] - truth[a], (np.cos(truth[a, 2]), np.sin(truth[a, 2]))
        return np.array([c * d[0] + s * d[1], -s * d[0] + c * d[1], d[2]])

    tight = np.diag([1e4, 1e4, 1e5])
    noisy = [relative(k, k + 1) + rng.normal(size=3) * [0.01, 0.01, 0.003] for k in range(n - 1)]
    steps = PoseEdges.of([(k, k + 1, noisy[k], tight) for k in range(n - 1)])
    start = np.zeros((n, 3))
    for k in range(n - 1):
        c, s = np.cos(start[k, 2]), np.sin(start[k, 2])
        x, y, turn = noisy[k]
        start[k + 1] = start[k] + [c * x - s * y, s * x + c * y, turn]
    true = [(k, k + 20, relative(k, k + 20), tight) for k in range(0, 20, 2)]
    false = [(k, k + 15, relative(k, k + 15) + [1.5, -1.0, 0.4], tight) for k in range(0, 20, 3)]
    poses, kept = PoseGraph(start, steps).solve_robustly(PoseEdges.of(true + false))
    assert kept.tolist() == [True] * len(true) + [False] * len(false)
    errors, _ = aligned(poses, truth)
    assert np.abs(errors[:, :2]).max() < 0.05


def test_without_gtsam_one_line_tells_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gtsam", None)
    monkeypatch.setattr("sensorgraph.localization.pose_graph._gtsam", _gtsam.__wrapped__)
    with pytest.raises(SensorgraphError, match="pip install gtsam"):
        PoseGraph(np.zeros((1, 3)), PoseEdges.of([]))


def test_closure_that_puts_walls_where_rays_went_through_is_told() -> None:
    poses = loop_poses(80, laps=2)
    run = room_run(poses)
    scans = scan_points(run)
    tracked = track(scans, run.stamps, odometry_at_scans(run, odometry_of(run)), no_progress)
    older, newer = cut_submaps(scans, tracked)[0], cut_submaps(scans, tracked)[-1]
    true = compose(
        invert(poses[older.frames[older.key_frames == older.middle][0]]),
        poses[newer.frames[newer.key_frames == newer.middle][0]],
    )

    def through(off: tuple[float, float]) -> float:
        moved = true + [*off, 0.0]
        there = newer.sees_through(older, invert(moved), CLOSURES.margin)
        return max(there, older.sees_through(newer, moved, CLOSURES.margin))

    assert through((0.0, 0.0)) < 0.03
    assert (
        min(through(off) for off in ((0.4, 0.0), (-0.4, 0.0), (0.0, 0.4), (0.0, -0.4))) > CLOSURES.see_through
    )


def test_match_that_does_not_tell_the_heading_is_no_closure() -> None:
    run = room_run(loop_poses(80, laps=2))
    scans = scan_points(run)
    tracked = track(scans, run.stamps, odometry_at_scans(run, odometry_of(run)), no_progress)
    closer = LoopCloser(scans, tracked)
    one, pose = closer.submaps[0], np.zeros(3)
    for turn_sd, word in ((0.001, ""), (1.0, "heading")):
        information = np.diag([1e6, 1e6, turn_sd**-2.0])
        found = Match(pose=pose, information=information, overlap=1.0, inliers=1.0, noise=0.01)
        assert word in closer.objection(one, one, found, pose, 1.0, 0.0)
        assert bool(word) == bool(closer.objection(one, one, found, pose, 1.0, 0.0))


def test_closures_do_not_depend_on_how_many_fields_are_kept_in_memory() -> None:
    run = room_run(TRUTH)
    scans = scan_points(run)
    tracked = track(scans, run.stamps, odometry_at_scans(run, odometry_of(run)), no_progress)
    few, many = (LoopCloser(scans, tracked, size=8, kept_fields=n) for n in (2, 128))
    kept = [[(one.first, one.second) for one in closer.run(no_ticks).kept] for closer in (few, many)]
    assert kept[0] == kept[1] and kept[0]
    held = [sum("pyramid" in vars(submap) for submap in closer.submaps) for closer in (few, many)]
    assert held[0] <= 2 < held[1]


@any_times
def test_stamps_that_repeat_are_said_and_the_order_of_the_log_holds(times: Callable[[Run], Run]) -> None:
    poses = loop_poses(40, laps=0.5)
    run = room_run(poses)
    run = replace(run, stamps=10 * run.stamps, odom_stamps=10 * run.odom_stamps)
    stamps = run.stamps.copy()
    stamps[10:12] = stamps[9]
    found = map_run(times(replace(run, stamps=stamps, odom_stamps=stamps)))
    assert found.notes == ("2 scans repeat the previous stamp: used in the order of the log",)
    assert rms(found, poses) < 0.01


@any_times
def test_scans_of_a_clock_that_is_too_coarse_are_spread_over_its_steps(times: Callable[[Run], Run]) -> None:
    poses = loop_poses(80, laps=0.5)
    run = room_run(poses)
    run = replace(run, odom_stamps=run.stamps + 1e-3)  # odometry of its own
    step = 4 * float(np.median(np.diff(run.stamps)))
    coarse = replace(run, stamps=step * np.floor(run.stamps / step + 1e-6))
    found = locate(times(coarse))
    assert found.notes == ("60 scans repeat the previous stamp: spread evenly up to the next stamp",)
    assert rms(found, poses) < 0.01 and set(found.status) == {"ok"}
    assert (found.t == coarse.stamps).all()


def test_covered_laser_is_lost_not_standing_and_odometry_carries_its_pose() -> None:
    poses = loop_poses(80, laps=0.5)
    run = room_run(poses)
    ranges = run.ranges.copy()
    ranges[30:] = 0.06  # a hand in front of it, to the end
    covered = replace(run, ranges=ranges)
    found = map_run(
        replace(covered, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))
    )
    assert set(found.status[:30]) == {"ok"} and "ok" not in found.status[31:]
    found = map_run(covered)
    sd = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert set(found.status) == {"ok"} and sd[-1, 0] > 10 * sd[29, 0]
    assert (np.abs(aligned(found.poses, poses)[0])[30:] < 3 * sd[30:]).all()
    assert any("only the odometry determines the pose" in note for note in found.notes)


@any_times
@pytest.mark.parametrize("reading", [0.06, *further(np.inf)], ids=["covered", "nothing in reach"])
def test_odometry_places_the_scans_before_the_first_that_sees_something(
    reading: float, times: Callable[[Run], Run]
) -> None:
    poses = loop_poses(80, laps=0.5)
    run = room_run(poses)
    ranges = run.ranges.copy()
    ranges[:30] = reading
    found = map_run(times(replace(run, ranges=ranges)))
    sd = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert set(found.status) == {"ok"} and sd[0, 0] > 5 * sd[40, 0]
    off = found.poses - compose(found.poses[40], compose(invert(poses[40]), poses))
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    assert (np.abs(off[:30]) < 3 * sd[:30]).all()


def test_nothing_is_said_of_a_good_log(located: Localization) -> None:
    assert located.notes == ()


@any_times
def test_robot_that_was_carried_is_found_again_or_said_to_be_lost(times: Callable[[Run], Run]) -> None:
    """Carried across the room between two scans, turned, and the wheels noticed nothing."""
    truth = np.concatenate([TRUTH[:60], TRUTH[15:50]])
    found = map_run(times(carried(room_run(truth[:60]), room_run(truth[60:], seed=1))))
    ok = np.array(found.status) == "ok"
    errors, _ = aligned(found.poses[ok], truth[ok])
    assert ok[:60].all()
    assert np.hypot(*errors[:, :2].T).max() < 0.05
    assert any("interrupted" in note for note in found.notes) or ok.all()
    assert not found.rivals


@pytest.mark.slow
def test_room_that_is_there_twice_is_ambiguous_and_names_both() -> None:
    """Through one room into its twin, then carried back into the first: nothing tells which of the two it is."""
    apart = 12.0
    doors = [wall for wall in ROOM if wall not in ((8.0, 0.0, 8.0, 3.0), (0.0, 6.0, 0.0, 0.0))]
    doors += [(x, y, x, z) for x, y, z in ((8, 0, 0.5), (8, 2.5, 3), (0, 0, 0.5), (0, 2.5, 6))]
    doors += [(8, 0.5, 12, 0.5), (8, 2.5, 12, 2.5), (-4, 0.5, 0, 0.5), (-4, 2.5, 0, 2.5)]
    walls = doors + [(a + apart, b, c + apart, d) for a, b, c, d in doors]
    walls += [(-4, 0.5, -4, 2.5), (20 + 4, 0.5, 20 + 4, 2.5)]
    t = np.linspace(-np.pi / 2, 3 * np.pi / 2, 32)
    lap = np.column_stack([3.2 + 1.5 * np.cos(t), 2.6 + 1.5 * np.sin(t), t + np.pi / 2])
    x = np.linspace(3.5, 3.2 + apart, 40)
    straight = np.column_stack([x, np.full(40, 1.1), np.full(40, 2 * np.pi)])
    before = np.concatenate([lap, straight, lap + [apart, 0.0, 2 * np.pi]])
    run = carried(room_run(before, walls=walls), room_run(lap[6:26], walls=walls, seed=1))
    found = map_run(run)
    states = np.array(found.status)
    n = len(before)
    assert (
        (states[:n] == "ok").all() and (states[n:] != "ok").all() and (states[n + 6 :] == "ambiguous").all()
    )
    for scan, places in found.rivals.items():
        truth = lap[6 + scan - n] - before[0] * [1, 1, 0]
        near = np.hypot(*(places[:, :2] - truth[:2]).T)
        assert near.min() < 0.1 and np.abs(near - apart).min() < 0.2
    assert found.rivals and any(note.startswith("ambiguous from") for note in found.notes)
