"""Drive channel: silent on nothing and on wheel effects, right on lag, dead time and saturation."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import BASE, ROBOT, make_run, without_commands, without_odometry

from logs.run import Run
from planners.types import Floats
from sensorgraph.diagnosis.diagnose import diagnose_motion
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.increments import commands_of, drive_rows, wheel_increments
from sensorgraph.diagnosis.motion.motor_model import DriveModel
from sensorgraph.diagnosis.motion.odometry_channel import diagnose_odometry

PLANTED: list[tuple[str, dict[str, Any], str, float]] = [
    ("dead_time", {"dead": 0.08}, "L", 0.08),
    ("actuator_lag", {"lag": 0.06}, "tau", 0.06),
    ("speed_saturation", {"v_max": 0.30}, "v_max", 0.30),
]


@pytest.mark.parametrize("seed", [1, *further(2)])
def test_nothing_planted_nothing_named(seed: int) -> None:
    result = diagnose_drive(make_run(seed), ROBOT)
    assert result.effects == () and result.unknown is None and result.skipped == ""


@pytest.mark.parametrize(
    ("name", "effect", "key", "value"), [PLANTED[0], *further(*PLANTED[1:])], ids=[p[0] for p in PLANTED]
)
def test_planted_effect_is_named_with_its_size(
    name: str, effect: dict[str, Any], key: str, value: float
) -> None:
    result = diagnose_drive(make_run(3, **effect), ROBOT)
    assert [a.name for a in result.effects] == [name] and result.unknown is None
    assert abs(result.effects[0][key] - value) < 3 * result.effects[0].stderr[key]


@pytest.mark.parametrize(
    ("lag", "period", "named"),
    [(0.025, 0.1, []), (0.025, None, ["actuator_lag"]), *further((0.06, 0.1, ["actuator_lag"]))],
)
def test_a_lag_that_waits_for_the_stated_loop_make_has_no_name(
    lag: float, period: float | None, named: list[str]
) -> None:
    """Waits spread evenly over 0.1 s smear a step as a lag of 0.029 s does."""
    tolerances = ROBOT.tolerances if period is None else replace(ROBOT.tolerances, control_period=period)
    stated = frozenset[str]() if period is None else frozenset({"tolerances.control_period"})
    robot = replace(ROBOT, tolerances=tolerances, stated=stated)
    result = diagnose_drive(make_run(3, lag=lag), robot)
    assert [a.name for a in result.effects] == named


@pytest.mark.parametrize(
    ("period", "is_stated", "told", "named"),
    [
        (0.02, True, 0.0, ["dead_time"]),
        (0.04, True, 0.0, []),
        *further(
            (0.04, False, 0.0, ["dead_time"]),
            (0.058, True, 0.03, []),
            (0.04, True, 0.02, ["dead_time"]),
            (0.08, False, 0.0, []),
        ),
    ],
)
def test_a_base_that_keeps_step_with_commands_may_make_them_wait(
    period: float, is_stated: bool, told: float, named: list[str]
) -> None:
    """Up to a period, or half of one more than a delay that holds the mean wait; a millisecond beyond is error."""
    robot = replace(
        ROBOT,
        tolerances=replace(ROBOT.tolerances, control_period=period),
        stated=frozenset({"tolerances.control_period"} if is_stated else ()),
        actuators=replace(ROBOT.actuators, delay=told),
    )
    result = diagnose_drive(make_run(3, dead=told + 0.03), robot)
    assert [a.name for a in result.effects] == named and result.unknown is None
    assert [a.name for a in (*result.effects, *result.within_tolerance)] == ["dead_time"]


@pytest.mark.parametrize(("lag", "since"), [(0.06, 50.0), *further((0.12, 30.0))])
def test_a_lag_that_comes_during_the_run_is_no_lag_of_the_robot(lag: float, since: float) -> None:
    """A load put on half-way: over the whole run it looks like a smaller lag that was always there."""
    result = diagnose_drive(make_run(3, lag=lag, since=since), ROBOT)
    assert result.effects == () and result.unknown is not None


@pytest.mark.parametrize(
    "effect", [{"radius": 0.03}, *further({"clock": 0.06}, {"diff": 0.02}, {"base": 0.04})], ids=str
)
def test_wheel_effects_are_no_drive_effects(effect: dict[str, float]) -> None:
    assert diagnose_drive(make_run(4, **effect), ROBOT).effects == ()


@pytest.mark.parametrize("seed", [5, *further(6)])
@pytest.mark.parametrize(
    ("column", "least"), [(1, 0.3), *further((0, 0.2), (0, 0.4))], ids=["turns", "ways", "most ways"]
)
@pytest.mark.slow
def test_motors_that_ignore_small_commands_are_unknown(column: int, least: float, seed: int) -> None:
    """The run is driven by what the motors obey; the log shows what they were told beside it: 0.6 of `least`."""
    run = make_run(seed)
    told, still = run.commands.copy(), np.abs(run.commands[:, column]) < 1e-9
    shift = np.sign(np.sin(run.cmd_stamps / 3.0))
    told[still, column] = 0.6 * least * shift[still]
    result = diagnose_drive(replace(run, commands=told), ROBOT)
    assert result.unknown is not None and "small" in result.unknown.statement and result.effects == ()


@pytest.mark.parametrize("gains", [(1.15, 1.2), *further(((1.0, 0.8),), ((0.85, 1.0),))], ids=str)
def test_a_constant_gain_beyond_tolerance_is_unknown(gains: tuple[float, float]) -> None:
    run = make_run(8)
    result = diagnose_drive(replace(run, commands=run.commands / gains), ROBOT)
    assert result.effects == () and result.unknown is not None
    for gain, verb in zip(gains, ("drives", "turns"), strict=True):
        told = re.search(rf"{verb} (\d\.\d\d) times", result.unknown.statement)
        assert (told is None) == (gain == 1.0)
        assert told is None or float(told[1]) == pytest.approx(gain, abs=0.015)
    off = np.hypot(*((np.array(gains) - 1) * [0.3, 0.4 * BASE / 2]))
    assert result.unknown.size["speed_m_s"] == pytest.approx(off, rel=0.5)


@pytest.mark.parametrize(("per_metre", "is_told"), [(0.15, True), (0.03, False), *further((-0.15, True))])
def test_a_base_that_turns_as_it_drives_is_unknown(per_metre: float, is_told: bool) -> None:
    """What it was told to turn is what it did, less so many radians per metre of its way."""
    run = make_run(8, duration=80.0)
    told = run.commands - np.outer(run.commands[:, 0], [0.0, per_metre])
    result = diagnose_drive(replace(run, commands=told), ROBOT)
    assert result.effects == () and (result.unknown is not None) == is_told
    if result.unknown is not None:
        found = re.search(r"turns ([+-][\d.]+)° per metre", result.unknown.statement)
        assert found is not None and float(found[1]) == pytest.approx(np.degrees(per_metre), abs=0.2)


@pytest.mark.parametrize("obeys", ["odometry", *further("reference")])
def test_wheels_of_two_sizes_under_a_base_that_obeys_its_odometry_are_no_turn_of_the_base(obeys: str) -> None:
    run = make_run(8, diff=0.06)
    turns = np.outer(run.commands[:, 0], [0.0, 0.06 / BASE])
    told = run.commands + turns if obeys == "odometry" else run.commands
    odometry, drive = diagnose_motion(replace(run, commands=told), ROBOT, ())
    assert [a.name for a in odometry.effects] == ["wheel_radius_diff"]
    assert drive.effects == () and drive.unknown is None


@pytest.mark.parametrize("effect", [{"v_max": 0.30}, *further({}, {"lag": 0.08}, {"dead": 0.08})], ids=str)
def test_effects_of_the_motors_are_named_beside_a_constant_gain(effect: dict[str, float]) -> None:
    name = {"lag": "actuator_lag", "dead": "dead_time", "v_max": "speed_saturation"}
    run = make_run(9, **effect)
    result = diagnose_drive(replace(run, commands=run.commands / 0.88), ROBOT)
    assert [a.name for a in result.effects] == [name[key] for key in effect]
    assert result.unknown is not None and "0.88 times the commanded speed" in result.unknown.statement


@pytest.mark.parametrize("gain", [0.95, *further(1.06)])
def test_a_constant_gain_within_tolerance_is_silent(gain: float) -> None:
    run = make_run(8)
    result = diagnose_drive(replace(run, commands=run.commands / gain), ROBOT)
    assert result.effects == () and result.unknown is None


@pytest.mark.parametrize("obeys", ["reference", *further("odometry")])
def test_a_gain_that_wheels_make_which_are_counted_wrongly_is_no_gain_of_the_base(obeys: str) -> None:
    """Either the base does what it is told by its odometry, or the odometry alone is wrong."""
    run = make_run(8, radius=0.12)
    told = run.commands * 1.12 if obeys == "odometry" else run.commands
    odometry, drive = diagnose_motion(replace(run, commands=told), ROBOT, ())
    assert [a.name for a in odometry.effects] == ["wheel_radius"]
    assert drive.effects == () and drive.unknown is None


def with_speeds(run: Run, v: Floats) -> Run:
    """Return the run with other speeds (n,) in its odometry."""
    twists = np.column_stack([v, run.odom_twists[:, 1]])
    phi = run.odometry[:, 2]
    way = np.cumsum(
        (v * np.gradient(run.odom_stamps))[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0
    )
    return replace(run, odom_twists=twists, odometry=np.column_stack([way, phi]))


def test_a_floor_that_slopes_is_unknown_by_its_own_look() -> None:
    run = make_run(7)
    faster = run.odom_twists[:, 0] + 0.03 * np.cos(run.odometry[:, 2] - 1.0)
    result = diagnose_drive(with_speeds(run, faster), ROBOT)
    assert result.unknown is not None and "slopes" in result.unknown.statement and result.effects == ()
    assert result.unknown.size["speed_m_s"] == pytest.approx(0.03 / np.sqrt(2), rel=0.4)


def ringing(run: Run, hz: float = 1.2, damping: float = 0.2) -> Floats:
    """Return the rates (n, 2) of a badly tuned base."""
    fine = np.arange(0.0, run.odom_stamps[-1], 0.005)
    w, out = 2 * np.pi * hz, np.zeros((len(fine), 2))
    told = run.commands[np.searchsorted(run.cmd_stamps, fine, side="right") - 1]
    rate = np.zeros(2)
    for k in range(1, len(fine)):
        rate = rate + 0.005 * (w**2 * (told[k] - out[k - 1]) - 2 * damping * w * rate)
        out[k] = out[k - 1] + 0.005 * rate
    return np.stack([np.interp(run.odom_stamps - 0.025, fine, c) for c in out.T], axis=1)


def sharing_power(run: Run) -> Floats:
    """Return the rates (n, 2) of a base that drives up to 40 % slower where it turns."""
    v, omega = run.odom_twists.T
    return np.column_stack([v * (1 - 0.4 * np.minimum(1.0, np.abs(omega) / 0.9)), omega])


def slow_to_gain_speed(run: Run, most: tuple[float, float] = (0.15, 0.6)) -> Floats:
    """Return the rates (n, 2) of a base that brings commands to its motors at 0.15 m/s² and 0.6 rad/s², or other ramps."""
    fine = np.arange(0.0, run.odom_stamps[-1], 0.005)
    told = run.commands[np.searchsorted(run.cmd_stamps, fine, side="right") - 1]
    out = np.zeros((len(fine), 2))
    for k in range(1, len(fine)):
        step = 0.005 * np.array(most)
        out[k] = out[k - 1] + np.clip((told[k] - out[k - 1]) * 0.05, -step, step)
    return np.stack([np.interp(run.odom_stamps - 0.025, fine, c) for c in out.T], axis=1)


def coasting(run: Run) -> Floats:
    """Return the rates (n, 2) of motors that speed up with a lag of 0.06 s, and slow down with one of 0.35 s."""
    fine = np.arange(0.0, run.odom_stamps[-1], 0.005)
    told = run.commands[np.searchsorted(run.cmd_stamps, fine, side="right") - 1]
    out = np.zeros((len(fine), 2))
    for k in range(1, len(fine)):
        tau = np.where(np.abs(told[k]) > np.abs(out[k - 1]), 0.06, 0.35)
        out[k] = out[k - 1] + 0.005 / tau * (told[k] - out[k - 1])
    return np.stack([np.interp(run.odom_stamps - 0.025, fine, c) for c in out.T], axis=1)


@pytest.mark.parametrize(
    ("rates", "said"),
    [
        (ringing, "rings"),
        *further(
            (partial(slow_to_gain_speed, most=(0.05, 0.2)), "the base accelerates at about 9 %"),
            (
                partial(ringing, hz=3.0, damping=0.3),
                "rings",
            ),  # the likeliest lag is 0.28 s below what is told
            (partial(ringing, hz=1.7, damping=0.5), "rings"),
            (coasting, ""),
            (sharing_power, "a speed that depends on the turn rate"),
            (slow_to_gain_speed, "the base accelerates at about"),
        ),
    ],
    ids=["rings", "ramps slowly", "rings fast", "overshoots", "coasts", "shares", "ramps"],
)
def test_a_base_with_a_manner_of_its_own_is_unknown(rates: Callable[[Run], Floats], said: str) -> None:
    run = make_run(6)
    noise = np.random.default_rng(0).normal(size=run.odom_twists.shape) * [0.004, 0.006]
    v, omega = (rates(run) + noise).T
    phi = np.cumsum(omega * 0.05)
    way = np.cumsum((v * 0.05)[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), axis=0)
    other = replace(run, odom_twists=np.column_stack([v, omega]), odometry=np.column_stack([way, phi]))
    result = diagnose_drive(other, ROBOT, use_clock=False)
    assert result.unknown is not None and said in result.unknown.statement
    assert result.effects == ()


@pytest.mark.slow
def test_wheels_that_misread_at_speed_are_no_saturation() -> None:
    run = make_run(8)
    v = run.odom_twists[:, 0]
    misread = with_speeds(run, np.where(np.abs(v) > 0.3, 0.85 * v, v))
    wheels = diagnose_odometry(misread, ROBOT)
    assert wheels.unknown is not None and wheels.motion is not None
    alone = diagnose_drive(misread, ROBOT, use_clock=False)  # it looks like one, with nothing known of wheels
    assert alone.effects or alone.withdrawn
    _, drive = diagnose_motion(misread, ROBOT, ())
    assert drive.effects == () and "speed_saturation" in drive.not_observable


def test_noise_of_coarse_ticks_is_not_cut() -> None:
    """Nine readings in ten are 0 and so is the robust scale, while robot.yaml states the noise: it is taken whole."""
    run, sigma = make_run(1, duration=30.0), ROBOT.wheels.sigma_v
    commands = commands_of(run)
    model = DriveModel(commands, drive_rows(wheel_increments(run), commands, ROBOT, None), ROBOT)
    rng = np.random.default_rng(1)
    ticks = rng.choice([-1.0, 1.0], 20_000) * (rng.random(20_000) < 0.1) * sigma * np.sqrt(10)
    noise = model.fitted_noise(0, ticks, np.ones(len(ticks), dtype=np.bool_))
    assert noise.sigma == pytest.approx(sigma, rel=0.03)
    outliers = model.fitted_noise(0, 30 * ticks, np.ones(len(ticks), dtype=np.bool_))
    assert outliers.sigma < 2 * sigma


def test_run_without_commands_or_odometry_is_skipped_with_reason() -> None:
    run = make_run(1, duration=10.0)
    assert "commands" in diagnose_drive(without_commands(run), ROBOT).skipped
    assert "odometry" in diagnose_drive(without_odometry(run), ROBOT).skipped
