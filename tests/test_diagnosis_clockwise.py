"""A laser that sweeps clockwise: its log, brought to counter-clockwise bearings, is diagnosed as if it were not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from scan_samples import hall_arena

from logs.run import Run
from planners.arena import wrap
from planners.types import Floats
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import parse_robot

N_RAYS, SWEEP = 61, 0.1
ROBOT = parse_robot(
    f"sensor: {{n_rays: {N_RAYS}, fov: 270 deg, sweep_time: {SWEEP}, sigma: 0.01, rate: 4, mount: [0.1, 0, 0]}}"
)


def path(t: Floats) -> Floats:
    """Return poses (..., 3) of a robot that turns to both sides."""
    return np.stack([3 + 1.5 * np.cos(0.3 * t), 2.2 + np.sin(0.3 * t), 2.0 * np.sin(0.6 * t)], axis=-1)


def clockwise(*, skew: float, said: float) -> Run:
    """Return a run whose laser takes its rays from left to right, in 0.1 s and `skew`, as a reader brings it to our order.

    Parameters
    ----------
    said : [s] that the log says a sweep takes
    """
    rng, hall = np.random.default_rng(3), hall_arena()
    t, fine = np.arange(1.0, 60.0, 0.25), np.arange(0.0, 62.0, 0.02)
    ranges = np.empty((len(t), N_RAYS))
    bearings = ROBOT.sensor.bearings
    for k in range(N_RAYS):
        taken = t + (SWEEP + skew) * (N_RAYS - 1 - k) / N_RAYS
        ranges[:, k] = cast_laser(
            hall.walls, laser_poses(path(taken), ROBOT.sensor.mount), bearings[k : k + 1], 50.0
        )[0][:, 0]
    ranges += 0.01 * rng.normal(size=ranges.shape)
    poses = path(fine) + rng.normal(size=(len(fine), 3)) * [0.002, 0.002, 0.001]
    return Run(
        sensor=replace(ROBOT.sensor, sweep_time=-said),
        stamps=t + said * (N_RAYS - 1) / N_RAYS,
        ranges=ranges,
        pose_stamps=fine,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
    )


@pytest.mark.parametrize(
    ("skew", "said"),
    [(0.03, SWEEP), (0.0, 0.03), *further((0.03, 0.0), (0.0, SWEEP), (0.0, 0.0), (0.03, 0.03))],
)
def test_a_clockwise_sweep_is_silent_and_its_skew_is_told_in_its_own_order(skew: float, said: float) -> None:
    found = diagnose(clockwise(skew=skew, said=said), hall_arena(), ROBOT, plan_next=False).channels["scan"]
    assert [a.name for a in found.effects] == ["scan_skew"] * (skew > 0) and found.unknown is None
    if skew:
        (effect,) = found.effects
        assert effect["T"] == pytest.approx(skew, abs=3 * effect.stderr["T"])
