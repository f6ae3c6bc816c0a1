"""A search adds the poses at which the scans fit, from which the graph has seen something."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from localization_samples import loop_poses, room_run
from watching_samples import believing, graph

from sensorgraph.watching import tracker as tracker_module
from sensorgraph.watching.observation import observations
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.tracker import PoseTracker


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
