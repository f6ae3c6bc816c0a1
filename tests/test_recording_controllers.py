"""A wall follower comes to a wall from anywhere and keeps its distance; an identified controller drives as its model runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further

from planners.types import Floats
from robotmodic_ident import Narmax, Terms
from sensorgraph.recording.controllers import FOLLOW_DISTANCE, Controller, PolynomialController, WallFollowing
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


@pytest.mark.parametrize(
    "terms, theta, others",
    [
        (("1", "L60_120(k)"), (1.0, -0.8), {"limits": (-0.3, 0.5)}),
        (
            ("L60_120(k-1)", "cmd_omega(k-1)", "tanh((cmd_omega(k-1)-cmd_omega(k-3))/0.1)"),
            (-0.2, 0.6, 0.3),
            {},
        ),
        (("1", "L60_120(k)", "cmd_omega(k-2)"), (1.0, -0.8, 0.2), {"is_magnitude": True}),
        (("1", "L60_120(k)"), (1.0, -0.8), {"denominator": Terms.parse("L60_120(k-1)^2")}),
        (("1", "L60_120(k-1)"), (1.0, -0.8), {"noise_terms": Terms.parse("e(k-2)*L60_120(k-2)")}),
    ],
    ids=["limits", "friction", "magnitude", "ratio", "noise"],
)
def test_an_identified_controller_commands_what_its_model_predicts_in_free_run(
    terms: tuple[str, ...], theta: tuple[float, ...], others: dict
) -> None:
    several = {"denominator": "denominator_theta", "noise_terms": "noise_theta"}
    others |= {several[name]: np.array([0.4]) for name in set(others) & set(several)}
    n = len(theta) + len(others) // 2
    model = Narmax(
        output="cmd_omega", terms=Terms.parse(*terms), theta=np.array(theta), covariance=np.zeros((n, n)),
        err=np.zeros(len(theta)), sigma=0.1, n_samples=100, **others,
    )  # fmt: skip
    robot = default_robot()
    steer = PolynomialController(model, {"signals": {"L60_120": "L60-120"}}, robot, name="model")
    ahead = np.random.default_rng(3).uniform(0.2, 3.0, 40)
    driven = [steer(np.full(robot.sensor.n_rays, value))[1] for value in ahead]
    back = model.recursion().look_back  # [samples] before the start, with constant readings and no command
    whole = {"L60_120": np.r_[np.full(back, ahead[0]), ahead], "cmd_omega": np.zeros(back + len(ahead))}
    expected = replace(model, is_magnitude=False).predict_mpo(whole)[back:]
    np.testing.assert_allclose(driven, np.abs(expected) if model.is_magnitude else expected, atol=1e-12)
    assert np.ptp(driven) > 0.1


def test_a_command_kept_for_lack_of_a_return_is_a_past_command() -> None:
    model = Narmax(
        output="cmd_omega", terms=Terms.parse("L60_120(k-1)", "cmd_omega(k-2)"), theta=np.array([1.0, 0.5]),
        covariance=np.zeros((2, 2)), err=np.zeros(2), sigma=0.1, n_samples=100,
    )  # fmt: skip
    robot = default_robot()
    steer = PolynomialController(model, {"signals": {"L60_120": "L60-120"}}, robot, name="model")
    driven = [steer(np.full(robot.sensor.n_rays, value))[1] for value in (0.2, 0.4, np.inf, 0.8)]
    assert driven == pytest.approx([0.2, 0.2, 0.2, 0.4 + 0.5 * 0.2])
    driven = [steer(np.full(robot.sensor.n_rays, value))[1] for value in (np.inf, 0.3)]
    assert driven == pytest.approx([0.5, 0.8 + 0.5 * 0.5])
