"""Effects in a simulated run: same seed same bytes, blocks like the whole, people as many as said; drive and wheels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from effects_samples import SENSOR, TURN, arena, motion, strong

from logs.run import RangeSensor
from planners.arena import wrap
from planners.trajectory import Trajectory
from planners.types import Floats
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.walkers import CLEARANCE, RADIUS
from sensorgraph.world import simulate as simulation
from sensorgraph.world.drive import TRUTH_STEP, ExecutedDrive, follow, odometry, replay
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import PoseReference, Robot, Wheels, default_robot
from sensorgraph.world.scene import DISC_WALL, Scene
from sensorgraph.world.simulate import simulate

ROOM = arena()


def robot(sensor: RangeSensor = SENSOR, *, sigma: float = 0.01) -> Robot:
    return replace(
        default_robot(),
        sensor=replace(sensor, sigma=sigma),
        pose=PoseReference(sigma_xy=0.0, sigma_yaw=0.0),
        wheels=Wheels(sigma_v=0.0, sigma_omega=0.0),
    )


def looping(seconds: float) -> ExecutedDrive:
    t = np.arange(0, seconds + 1e-9, TRUTH_STEP)
    return ExecutedDrive(
        stamps=t, poses=motion(t), twists=np.zeros((len(t), 2)),
        cmd_stamps=np.zeros(0), commands=np.zeros((0, 2)), contacts=0,
    )  # fmt: skip


def ranges(effects: list[Amendment], seed: int = 0, sigma: float = 0.01, seconds: float = 20.0) -> Floats:
    run = simulate(
        looping(seconds), ROOM, robot(sigma=sigma), rng=np.random.default_rng(7), effects=effects, seed=seed
    )
    return run.ranges


MANY = [strong(n) for n in ("people", "latency", "range_drift", "glass", "black_surface", "random_outliers")]


def test_the_same_seed_gives_the_same_run_and_another_other_people() -> None:
    np.testing.assert_array_equal(ranges(MANY), ranges(MANY))
    assert (ranges([strong("people")], seed=1) != ranges([strong("people")], seed=2)).any()


def test_blocks_give_what_the_whole_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    some = [strong(n) for n in ("people", "latency", "range_drift", "moved_wall", "mixed_pixels", "tilt")]
    whole = ranges(some, sigma=0.0)
    monkeypatch.setattr(simulation, "SCANS_PER_STEP", 23)
    np.testing.assert_array_equal(ranges(some, sigma=0.0), whole)


@pytest.mark.parametrize("name", sorted(n for n, e in EFFECTS.items() if e.channel == "scan"))
def test_every_effect_of_the_scan_channel_shows_in_a_run(name: str) -> None:
    assert (ranges([strong(name)], seconds=5.0) != ranges([], seconds=5.0)).any()


@pytest.mark.parametrize("p", [0.005, 0.03, 0.15])
@pytest.mark.parametrize("sensor", [SENSOR, TURN], ids=["part", "full turn"])
@pytest.mark.parametrize("seed", [1, *further(2)])
def test_people_take_their_share_of_rays_and_keep_clear(p: float, sensor: RangeSensor, seed: int) -> None:
    stamps = np.arange(0.0, 300.0, 0.1)
    there = Scene(arena=ROOM, sensor=sensor, stamps=stamps, motion=motion, span=stamps[-1], seed=seed)
    beams = there.run([EFFECTS["people"](p=p)])
    share = (beams.wall == DISC_WALL - 1).mean()
    assert p / 1.5 < share < 1.5 * p
    apart = np.linalg.norm(there.movers[..., :2] - motion(stamps)[:, None, :2], axis=-1)
    assert apart.min() > CLEARANCE + RADIUS - 1e-9
    assert beams.ranges.min() > 0.1


def drive(
    commands: list[tuple[float, float, float]], *effects: Amendment
) -> tuple[ExecutedDrive, Drivetrain]:
    """Drive (stamp, v, omega) commands from (0, 0, 0) with an amended drivetrain."""
    table, car = np.array(commands), robot()
    drivetrain = Drivetrain.of(car, effects)
    return replay(
        table[:, 0], table[:, 1:], np.zeros(3), car, clearance=lambda x, y: np.inf, drivetrain=drivetrain
    ), drivetrain


def read_wheels(driven: ExecutedDrive, drivetrain: Drivetrain) -> tuple[Floats, Floats, Floats]:
    return odometry(driven, robot(), np.random.default_rng(0), drivetrain=drivetrain)


CURVE = [(0.0, 0.3, 0.2), (6.0, 0.2, -0.4), (10.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("name", "values", "matrix"),
    [
        ("wheel_radius", {"s": 0.03}, [[1.03, 0.0], [0.0, 1.03]]),
        ("wheel_base", {"s": 0.05}, [[1.0, 0.0], [0.0, 1 / 1.05]]),
        ("wheel_radius_diff", {"s": 0.02}, [[1.0, 0.0], [0.02 / 0.4, 1.0]]),
    ],
)
def test_wheels_measure_way_and_turn_as_said(
    name: str, values: dict[str, float], matrix: list[list[float]]
) -> None:
    driven, plain = drive(CURVE)
    _, amended = drive(CURVE, EFFECTS[name](**values))
    (stamps, _, true), (_, poses, read) = read_wheels(driven, plain), read_wheels(driven, amended)
    np.testing.assert_allclose(read, true @ np.array(matrix).T, atol=1e-12)
    turned = np.cumsum(read[1:, 1]) / 20.0
    np.testing.assert_allclose(wrap(poses[1:, 2] - turned), 0.0, atol=1e-9)
    assert len(stamps) == len(poses)


def test_effects_of_the_wheels_compose_in_any_order() -> None:
    three = [EFFECTS[n](s=0.03) for n in ("wheel_radius", "wheel_base", "wheel_radius_diff")]
    first, second = Drivetrain.of(robot(), three), Drivetrain.of(robot(), three[::-1])
    np.testing.assert_array_equal(first.measured, second.measured)


def test_late_odometry_is_that_of_an_earlier_time() -> None:
    driven, plain = drive(CURVE)
    _, late = drive(CURVE, EFFECTS["pose_clock_offset"](tau=0.1))  # two periods of 50 ms
    (_, poses, _), (_, shifted, _) = read_wheels(driven, plain), read_wheels(driven, late)
    np.testing.assert_allclose(shifted[2:], poses[:-2], atol=1e-9)


def test_a_slippery_patch_takes_its_share_of_the_way_but_not_of_the_wheels() -> None:
    straight = [(0.0, 0.4, 0.0), (10.0, 0.0, 0.0)]
    plain, _ = drive(straight)
    slipped, drivetrain = drive(straight, EFFECTS["wheel_slip"](s=0.25, x=1.5, y=0.0, r=0.5))
    np.testing.assert_array_equal(plain.twists, slipped.twists)
    chord = 2 * np.sqrt(0.5**2 - (drivetrain.base / 2) ** 2)  # of each wheel, beside the middle of the patch
    lost = chord * (1.0 / 0.75 - 1.0)  # 1 m of patch takes 1.333 m of wheel
    assert plain.poses[-1, 0] - slipped.poses[-1, 0] == pytest.approx(lost, abs=2 * 0.4 * TRUTH_STEP)
    assert read_wheels(slipped, drivetrain)[1][-1, 0] == pytest.approx(plain.poses[-1, 0], abs=1e-3)
    turning, _ = drive([(0.0, 0.0, 0.5), (4.0, 0.0, 0.0)], EFFECTS["wheel_slip"](s=0.25, x=0.0, y=0.0, r=0.5))
    free, _ = drive([(0.0, 0.0, 0.5), (4.0, 0.0, 0.0)])
    assert turning.poses[-1, 2] == pytest.approx(0.75 * free.poses[-1, 2], abs=1e-9)


def test_a_patch_under_one_wheel_turns_the_body() -> None:
    straight = [(0.0, 0.4, 0.0), (10.0, 0.0, 0.0)]
    base = Drivetrain.of(robot()).base
    left, _ = drive(straight, EFFECTS["wheel_slip"](s=0.25, x=1.5, y=base / 2, r=0.1))
    right, _ = drive(straight, EFFECTS["wheel_slip"](s=0.25, x=1.5, y=-base / 2, r=0.1))
    lost = 0.25 * 0.2  # [m] of that wheel, over 0.2 m of patch, and a little more as it slips
    assert lost / base < left.poses[-1, 2] < 1.4 * lost / base
    assert right.poses[-1, 2] == pytest.approx(-left.poses[-1, 2], abs=1e-9)


def test_lag_and_dead_time_bend_and_shift_a_step() -> None:
    step = [(0.0, 0.0, 0.1), (5.0, 0.0, 0.1)]  # so small that alpha does not limit it
    for effects, tau, delay in (
        ([EFFECTS["actuator_lag"](tau=0.2)], 0.3, 0.0),
        ([EFFECTS["dead_time"](L=0.15)], 0.1, 0.15),
        ([EFFECTS["dead_time"](L=0.15), EFFECTS["actuator_lag"](tau=0.2)], 0.3, 0.15),
    ):
        driven, _ = drive(step, *effects)
        t = driven.stamps
        expected = np.where(t > delay, 0.1 * (1 - np.exp(-(t - delay) / tau)), 0.0)
        np.testing.assert_allclose(driven.twists[t < 4.9, 1], expected[t < 4.9], atol=1e-9)


def test_saturation_caps_speed_but_not_commands() -> None:
    there_and_back = [(0.0, 0.4, 0.3), (5.0, -0.4, 0.3), (10.0, 0.0, 0.0)]
    plain, _ = drive(there_and_back)
    capped, _ = drive(there_and_back, EFFECTS["speed_saturation"](v_max=0.25))
    np.testing.assert_array_equal(plain.commands, capped.commands)
    assert capped.twists[:, 0].max() == pytest.approx(0.25, abs=1e-6)
    assert capped.twists[:, 0].min() == pytest.approx(-0.25, abs=1e-6)
    np.testing.assert_array_equal(plain.twists[:, 1], capped.twists[:, 1])


def test_the_controller_does_not_know_of_the_lag() -> None:
    """A plan driven with 0.3 s more of lag runs behind; had the feed-forward known, it would not."""
    t = np.arange(0, 10.0, 0.02)
    v = 0.3 * np.sin(np.pi * t / t[-1]) ** 2
    x = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2 * 0.02)])
    plan = Trajectory(
        stamps=t, poses=np.column_stack([x, 0 * t, 0 * t]), twists=np.column_stack([v, 0 * t]),
        primitives=np.full(len(t), "move"),
    )  # fmt: skip
    car = robot()
    known = replace(car, actuators=replace(car.actuators, tau=0.4))
    behind = []
    for driver, drivetrain in (
        (car, Drivetrain.of(car, [EFFECTS["actuator_lag"](tau=0.3)])),
        (known, Drivetrain.of(known)),
    ):
        driven = follow(
            plan, driver, clearance=lambda x, y: np.inf, rng=np.random.default_rng(0), drivetrain=drivetrain
        )
        behind.append(float((plan.at(driven.stamps)[0][:, 0] - driven.poses[:, 0]).max()))
    assert behind[0] > 3 * behind[1]
