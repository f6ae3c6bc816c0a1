"""Motion that the odometry does not show is one more hypothesis, with a prior and the volume of an unknown motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from localization_samples import loop_poses, room_run
from watching_samples import believing, graph

from sensorgraph.localization.known_map import KnownMap
from sensorgraph.localization.matching import Match
from sensorgraph.types import Floats
from sensorgraph.watching import modes
from sensorgraph.watching import tracker as tracker_module
from sensorgraph.watching.observation import Observation, observations
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.scan_input import ScanInput
from sensorgraph.watching.settings import TRACKING
from sensorgraph.watching.tracker import PoseTracker

BACK = 0.45
"""[m]"""


def following(n: int) -> tuple[PoseTracker, list[Observation], Floats]:
    """Return a tracker that has followed n of 60 scans, the other scans, and the poses (60, 3)."""
    poses = loop_poses(60, laps=0.5)
    scans = list(observations(believing(room_run(poses, seed=2), poses)))
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    for one in scans[:n]:
        tracker.update(one)
    return tracker, [replace(one, believed=None) for one in scans[n:]], poses


def test_a_surface_that_contradicts_the_odometry_does_not_move_the_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As at the end of the graph of a corridor: too few points fit at the right pose, and walls fit further back."""
    tracker, scans, poses = following(30)

    def back(place: KnownMap, pose: Floats, covariance: Floats, now: ScanInput) -> Match | None:
        if covariance[0, 0] < 0.05**2:
            return None
        off = BACK * np.array([math.cos(pose[2]), math.sin(pose[2]), 0.0])
        return Match(pose=pose - off, information=1e4 * np.eye(3), overlap=1.0, inliers=1.0, noise=0.01)

    for module in (modes, tracker_module):
        monkeypatch.setattr(module, "matched", back)
    for k, one in enumerate(scans[:5]):
        tracker.update(one)
        main = tracker.main
        assert main is not None and not main.slips
        assert np.hypot(*(main.pose - poses[30 + k])[:2]) < 0.1
        slipped = [mode for mode in tracker.modes if mode.slips]
        assert all(mode.score < math.log(TRACKING.carried) for mode in slipped)


def test_a_robot_whose_odometry_stands_while_it_drives_fast_is_followed() -> None:
    """Between two scans it moves by more than the match of a mode reaches."""
    poses = loop_poses(60, laps=2.0)  # 0.32 m and 12° from scan to scan
    scans = list(observations(believing(room_run(poses, seed=2), poses)))
    tracker = PoseTracker(graph(), GraphReadings(graph(), graph().sensor))
    for k, one in enumerate(scans[:45]):
        stands = scans[20].odometry if k > 20 else one.odometry
        tracker.update(replace(one, odometry=stands, believed=one.believed if k == 0 else None))
    main = tracker.main
    assert main is not None and np.hypot(*(main.pose - poses[44])[:2]) < 0.1
