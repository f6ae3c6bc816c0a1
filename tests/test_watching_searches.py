"""A search looks near the most probable pose and in the whole place, for poses from which the graph has seen something."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import further
from localization_samples import loop_poses, room_run
from watching_samples import believing, graph

import sensorgraph as sg
from sensorgraph.watching import tracker as tracker_module
from sensorgraph.watching.observation import observations
from sensorgraph.watching.readings import GraphReadings
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


def test_a_search_adds_no_pose_from_which_the_graph_has_seen_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is no place among those that can be told apart: a robot there is elsewhere."""
    poses = loop_poses(60)[:10]
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    for one in observations(believing(room_run(poses), poses)):
        tracker.update(one)
    inside, outside = np.array([6.5, 1.5, 1.0]), np.array([-158.0, -153.0, -1.0])
    assert tracker.readings.sees(np.array([inside, outside])).tolist() == [True, False]
    monkeypatch.setattr(
        tracker_module, "find_places", lambda *_, **__: SimpleNamespace(poses=np.array([outside, inside]))
    )
    tracker._search()
    assert len(tracker.modes) == 2
    assert np.hypot(*(tracker.modes[1].pose - inside)[:2]) < 0.5
