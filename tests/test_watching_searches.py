"""A search looks near the most probable pose and in the whole place, in parallel, for poses from which the graph has seen something."""

from __future__ import annotations

from dataclasses import replace
from threading import Event, Timer
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import further
from localization_samples import loop_poses, room_run
from watching_samples import believing, graph

import sensorgraph as sg
from sensorgraph.localization.global_search import GlobalPlaces, find_places
from sensorgraph.types import Floats
from sensorgraph.watching import search as search_module
from sensorgraph.watching.observation import Observation, observations
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.scan_input import ScanInput, odometry_step, points_of
from sensorgraph.watching.search import PlaceSearch
from sensorgraph.watching.settings import TRACKING
from sensorgraph.watching.tracker import PoseTracker


@pytest.mark.parametrize("disturbed", [1, *further(2, 3)])
def test_a_robot_that_is_carried_and_stands_is_found_whatever_was_searched_before(disturbed: int) -> None:
    """Scans of people around the robot lead to searches long before it is carried."""
    poses, there = loop_poses(60), np.tile([6.5, 1.5, 1.0], (30, 1))
    before, after = room_run(poses, seed=9), room_run(there, seed=10)
    ranges = before.ranges.copy()
    ranges[20 : 20 + disturbed] = np.random.default_rng(0).uniform(0.5, 1.5, ranges[:disturbed].shape)
    run = replace(
        room_run(np.concatenate([poses, there]), seed=9), ranges=np.concatenate([ranges, after.ranges]),
        odometry=np.concatenate([before.odometry, np.tile(before.odometry[-1], (30, 1))]),
    )  # fmt: skip
    said = list(sg.watch(graph(), believing(run, np.concatenate([poses, np.tile(poses[-1], (30, 1))]))))
    wrong = [status.t for status in said if status.pose.status in ("off", "lost")]
    assert wrong and 12.0 <= wrong[0] < 14.2


def test_a_search_finds_no_pose_from_which_the_graph_has_seen_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is no place among those that can be told apart: a robot there is elsewhere."""
    inside, outside = np.array([6.5, 1.5, 1.0]), np.array([-158.0, -153.0, -1.0])
    tracker, scans, _ = following(10)
    assert tracker.readings.sees(np.array([inside, outside])).tolist() == [True, False]
    places = SimpleNamespace(poses=np.array([outside, inside]))
    monkeypatch.setattr(search_module, "find_places", lambda *_, **__: places)
    search = search_of(tracker)
    search.follow(np.zeros(3), np.full(3, 0.1), input_at(tracker, scans[0], 2.0))
    assert [np.hypot(*(mode.pose - inside)[:2]) < 0.5 for mode in search.ready] == [True]


def test_the_poses_that_a_search_finds_follow_a_robot_that_drives_on_meanwhile() -> None:
    """They are used some time later, when the robot is elsewhere."""
    tracker, scans, poses = following(10)
    search, n = search_of(tracker), 0
    while not search.ready:
        step, deviations = odometry_step(tracker._last, scans[n], np.zeros(3), TRACKING)[1:3]
        search.follow(step, deviations, tracker.update(replace(scans[n], believed=None)))
        n += 1
    assert scans[n - 2].stamp - scans[0].stamp < TRACKING.search_time + 0.2
    off = [np.hypot(*(mode.pose - poses[9 + n])[:2]) for mode in search.ready]
    assert off[-1] < 0.05 < 0.3 < np.hypot(*(poses[9 + n] - poses[9])[:2])
    assert not search.is_done
    search.ready.clear()
    n_kept = len(search._since)
    search.follow(np.zeros(3), np.full(3, 0.01), input_at(tracker, scans[n], 0.0))
    assert search.is_done and len(search._since) == n_kept  # its memory does not grow


def test_a_live_robot_does_not_wait_for_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scans of a log do: its results are used at the same scan on each machine."""
    may_end, (tracker, scans, _) = Event(), following(10)
    places = find_places(tracker.kept.view(), tracker.place)

    def slow(*_: Any, **__: Any) -> GlobalPlaces:
        assert may_end.wait(60.0)
        return places

    monkeypatch.setattr(search_module, "find_places", slow)
    search = search_of(tracker, waits=False)
    still = np.zeros(3), np.full(3, 0.01)
    search.follow(*still, input_at(tracker, scans[0], 5.0))
    assert not search.ready and not search.is_done
    may_end.set()
    search._parts[0][1].result()
    search.follow(*still, input_at(tracker, scans[0], 5.1))
    assert search.ready
    may_end.clear()
    waiting = search_of(tracker)
    Timer(0.2, may_end.set).start()
    waiting.follow(*still, input_at(tracker, scans[0], 5.0))
    assert waiting.ready


def following(n: int) -> tuple[PoseTracker, list[Observation], Floats]:
    """Return a tracker that has followed n of 60 scans, the other scans, and the poses (60, 3)."""
    poses = loop_poses(60)
    scans = list(observations(believing(room_run(poses, seed=2), poses)))
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    for one in scans[:n]:
        tracker.update(one)
    return tracker, scans[n:], poses


def input_at(tracker: PoseTracker, scan: Observation, seconds: float) -> ScanInput:
    """Return a scan as the tracker takes it, some seconds later."""
    late = replace(scan, stamp=scan.stamp + seconds)
    points = points_of(tracker.readings.sensor, late, np.zeros(3))
    return ScanInput(observation=late, scan=points, drift=tracker.drift, weight=1.0)


def search_of(tracker: PoseTracker, *, waits: bool = True) -> PlaceSearch:
    """Return a search of the whole place for the scans that a tracker has kept."""
    assert tracker._last is not None
    return PlaceSearch(
        tracker.kept, None, tracker.place, tracker.readings.sees, TRACKING, input_at(tracker, tracker._last, 0.0),
        waits=waits,
    )  # fmt: skip
