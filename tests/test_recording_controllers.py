"""A wall follower comes to a wall from anywhere, keeps its distance, and goes round a room instead of in circles."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further

from planners.types import Floats
from sensorgraph.recording.controllers import FOLLOW_DISTANCE, Controller, WallFollowing
from sensorgraph.world.robot import Robot, default_robot

SIDE = 6.0


def seen(pose: Floats, bearings: Floats) -> Floats:
    """Return the distance to the walls of an empty square, bearing by bearing."""
    c, s = np.cos(pose[2] + bearings), np.sin(pose[2] + bearings)
    with np.errstate(divide="ignore"):
        along_x = np.where(c > 0, SIDE - pose[0], -pose[0]) / c
        along_y = np.where(s > 0, SIDE - pose[1], -pose[1]) / s
    return np.asarray(np.minimum(along_x, along_y))


def driven(controller: Controller, robot: Robot, start: Floats, seconds: float) -> Floats:
    """Return the poses (n, 3) of a robot that does at once what it is told."""
    period, pose, poses = 1.0 / robot.sensor.rate, start.copy(), list[Floats]()
    for _ in range(int(seconds / period)):
        v, omega = controller(seen(pose, robot.sensor.bearings))
        pose = pose + period * np.array([v * np.cos(pose[2]), v * np.sin(pose[2]), omega])
        poses.append(pose)
    return np.array(poses)


@pytest.mark.parametrize("phi", [0.0, 2.9, *further(1.1, -1.6)])
@pytest.mark.parametrize("place", [(3.0, 3.0), (5.4, 1.0), *further(((1.5, 4.0),))])
def test_it_follows_the_walls_wherever_it_starts(place: tuple[float, float], phi: float) -> None:
    robot = default_robot()
    poses = driven(WallFollowing(robot, 0), robot, np.array([*place, phi]), 240.0)
    assert ((poses[:, :2] > robot.footprint_radius) & (poses[:, :2] < SIDE - 0.2)).all()
    late = poses[len(poses) // 2 :]
    depth = np.minimum(late[:, :2], SIDE - late[:, :2]).min(axis=1)
    assert np.median(depth) == pytest.approx(robot.footprint_radius + FOLLOW_DISTANCE, abs=0.1)
    assert np.quantile(depth, 0.95) < 0.8
    assert (np.ptp(late[:, :2], axis=0) > SIDE - 1.6).all()  # all four walls
