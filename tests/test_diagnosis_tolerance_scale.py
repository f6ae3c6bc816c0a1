"""Stamps, heading and noise that are worse than stated are told, one from the other."""

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
from sensorgraph.diagnosis.report.summary import summarise
from sensorgraph.world.raycast import cast_laser, laser_poses
from sensorgraph.world.robot import parse_robot

ROBOT = parse_robot(
    "sensor: {n_rays: 91, fov: 270 deg, sigma: 0.01, rate: 4, mount: [0.1, 0, 0]}\n"
    "tolerances: {pose_xy: 0.004, pose_yaw: 0.002, stamp: 0.003}"
)


def path(t: Floats) -> Floats:
    """Return poses (..., 3) of a robot that turns to both sides, and stands at times."""
    return np.stack([3 + 1.5 * np.cos(0.3 * t), 2.2 + np.sin(0.3 * t), 1.5 * np.sin(0.6 * t)], axis=-1)


def driven(
    *, jitter: float = 0.5, shaken: float = 0.5, turned: float | None = None, noise: float = 1.0
) -> Run:
    """Return a run with stamps that jitter by so many tolerances, poses that are off by so many, and times the stated noise.

    Parameters
    ----------
    turned : tolerances of the heading by which it is off, where that is not as many as of the place
    """
    rng, hall, told = np.random.default_rng(4), hall_arena(), ROBOT.tolerances
    t, fine = np.arange(1.0, 60.0, 0.25), np.arange(0.0, 62.0, 0.02)
    taken = t + jitter * told.stamp * rng.normal(size=len(t))
    lasers = laser_poses(path(taken), ROBOT.sensor.mount)
    ranges = cast_laser(hall.walls, lasers, ROBOT.sensor.bearings, 50.0)[0]
    ranges = ranges + noise * 0.01 * rng.normal(size=ranges.shape)
    slow = np.repeat(rng.normal(size=(len(fine) // 10 + 1, 3)), 10, axis=0)[: len(fine)]
    heading = shaken if turned is None else turned
    poses = path(fine) + slow * [shaken * told.pose_xy, shaken * told.pose_xy, heading * told.pose_yaw]
    return Run(
        sensor=ROBOT.sensor,
        stamps=t,
        ranges=ranges,
        pose_stamps=fine,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
    )


@pytest.mark.parametrize(
    ("jitter", "shaken", "is_told"),
    [
        (3.0, 1.0, True), (1.0, 1.0, False),
        *further((0.0, 1.6, False), (3.0, 0.3, True), (1.0, 0.3, False)),
    ],
)  # fmt: skip
def test_stamps_that_jitter_more_than_stated_are_told(jitter: float, shaken: float, is_told: bool) -> None:
    finding = diagnose(driven(jitter=jitter, shaken=shaken), hall_arena(), ROBOT, plan_next=False)
    factor = finding.tolerance_factors["stamp"]
    assert finding.effects == ()
    said = " ".join(summarise(replace(finding)).details)
    assert (factor >= 1.3) == is_told == (f"the stamps are {factor:.1f} times worse" in said)
    assert not is_told or factor == pytest.approx(jitter, rel=0.35)


@pytest.mark.parametrize(("turned", "is_told"), [(2.0, True), (1.0, False)])
def test_a_heading_that_is_worse_than_stated_is_told(turned: float, is_told: bool) -> None:
    """Beside places that are as stated, of which the one scale of both hardly grows."""
    finding = diagnose(driven(jitter=0.0, shaken=0.5, turned=turned), hall_arena(), ROBOT, plan_next=False)
    factor = finding.tolerance_factors["heading"]
    assert finding.effects == () and finding.unknown is None
    said = " ".join(summarise(finding).details)
    assert (factor >= 1.3) == is_told == (f"the reference's heading is {factor:.1f} times worse" in said)
    assert not is_told or factor == pytest.approx(turned, rel=0.35)


@pytest.mark.parametrize("noise", [2.0, *further(3.0)])
def test_a_laser_that_scatters_more_than_stated_has_no_noise_that_grows_with_range(noise: float) -> None:
    finding = diagnose(driven(noise=noise), hall_arena(), ROBOT, plan_next=False)
    assert finding.effects == () and finding.unknown is not None
    said = finding.unknown.statement
    assert "times sensor.sigma in robot.yaml" in said
    assert finding.explained is not None
    assert finding.explained.final.state.noise.core == pytest.approx(noise, rel=0.05)


def test_a_laser_that_scatters_less_than_stated_is_told() -> None:
    finding = diagnose(driven(noise=0.4), hall_arena(), ROBOT, plan_next=False)
    assert finding.effects == () and finding.unknown is None
    assert "times the scatter of the laser" in " ".join(summarise(finding).details)
