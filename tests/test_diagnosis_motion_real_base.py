"""Bases as real ones are: ticks of their own loop, a transport that jitters, two lags in series, motors that ignore trifles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run, profile
from scipy.signal import lfilter

from logs.run import Run
from planners.types import Floats
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive


def real_base(
    seed: int,
    *,
    tick: float = 0.0,
    jitter: float = 0.0,
    second: float = 0.0,
    sigma: float = 1.0,
    drag: tuple[float, float] = (0.0, 0.0),
    ramp: tuple[float, float] | None = None,
    late: float = 0.0,
) -> Run:
    """Return a run whose base acts at ticks of its own loop, through two lags in series; commands come at 20 Hz.

    Parameters
    ----------
    tick, jitter, second : [s] of the base, of the transport of commands, of the second lag
    sigma : times the nominal noise of the encoders
    drag : share of the speed that is lost, and the command [m/s] below which it is
    ramp : [m/s², rad/s²] by which the base brings commands to its motors
    late : [s] that the transport takes
    """
    rng, fine = np.random.default_rng(seed), 0.005
    run = make_run(seed, duration=1.0)
    commands = profile(rng, 90.0)
    stamps = 0.05 * np.arange(len(commands))
    t = fine * np.arange(len(commands) * 10)
    arrival = stamps + late + np.abs(rng.normal(size=len(stamps))) * jitter
    if tick:
        arrival = np.ceil(arrival / tick) * tick - tick / 2  # robot.yaml's delay holds the mean
    held = commands[np.maximum(np.searchsorted(np.maximum.accumulate(arrival), t, side="right") - 1, 0)]
    share, below = drag
    held = np.where(np.abs(held) < below, held * (1 - share), held)
    if ramp is not None:
        held = np.stack([ramped(c, a * fine) for c, a in zip(held.T, ramp, strict=True)], axis=1)
    for tau in (0.10 - second, second):
        if tau > 0:
            keep = np.exp(-fine / tau)
            held = lfilter([1 - keep], [1, -keep], held, axis=0)
    moved = np.cumsum(held * fine, axis=0)
    way = np.stack([np.interp(stamps, t + fine, c) for c in moved.T], axis=1)
    twists = np.diff(way, axis=0, prepend=way[:1]) / 0.05
    twists += rng.normal(size=twists.shape) * [0.004, 0.006] * sigma
    return replace(
        run,
        odom_stamps=stamps,
        odometry=np.zeros((len(stamps), 3)),
        odom_twists=twists,
        cmd_stamps=stamps,
        commands=commands,
    )


def ramped(asked: Floats, most: float) -> Floats:
    """Return set points (n,) that follow what is asked by at most so much a step."""
    out, last = np.empty_like(asked), 0.0
    for k, value in enumerate(asked):
        out[k] = last = min(max(value, last - most), last + most)
    return out


@pytest.mark.parametrize(
    "base",
    [
        {"tick": 0.02, "jitter": 0.005},
        {"second": 0.03, "tick": 0.0495, "sigma": 0.01},
        *further({"tick": 0.0495}, {"tick": 0.0333}, {"second": 0.03}),
    ],
    ids=str,
)
def test_what_every_base_does_is_no_reason_to_doubt(base: dict[str, float]) -> None:
    result = diagnose_drive(real_base(1, **base), ROBOT)
    assert result.effects == () and result.unknown is None


@pytest.mark.parametrize("late", [0.06, *further(0.0)])
def test_a_base_that_brings_commands_to_its_motors_by_a_ramp_is_not_late_for_that(late: float) -> None:
    """The ramp keeps the limits of robot.yaml, the lag follows it; a dead time beside it is found as it is."""
    limits = replace(ROBOT.limits, a=0.5, alpha=1.5)
    result = diagnose_drive(real_base(3, ramp=(0.5, 1.5), late=late), replace(ROBOT, limits=limits))
    assert result.unknown is None
    found = {a.name: a.parameters for a in result.effects}
    assert found == ({"dead_time": {"L": pytest.approx(late, abs=0.012)}} if late else {})


def test_error_of_a_lag_holds_a_second_one_in_series() -> None:
    """Whether robot.yaml's time constant of 20 ms is that of the first lag or of both is nobody's to know."""
    stated = replace(ROBOT, actuators=replace(ROBOT.actuators, tau=0.02))
    errors = []
    for second in (0.0, 0.025):
        (lag,) = diagnose_drive(real_base(1, second=second), stated).effects
        assert lag.name == "actuator_lag"
        for truth in (0.08, 0.08 - second):
            assert abs(lag["tau"] - truth) < 2 * lag.stderr["tau"]
        errors.append(lag.stderr["tau"])
    assert errors[1] ** 2 - errors[0] ** 2 == pytest.approx(0.025**2 / 3, rel=0.3)


def test_a_second_lag_in_series_does_not_hide_a_lag_that_is_longer_than_the_smear() -> None:
    """35 ms beside a smear of 14 ms: the fit is sure by 2 ms, though the ± with a second lag of 25 ms is 15 ms."""
    stated = replace(
        ROBOT,
        actuators=replace(ROBOT.actuators, tau=0.065),
        tolerances=replace(ROBOT.tolerances, control_period=0.05),
        stated=frozenset({"tolerances.control_period"}),
    )
    assert [a.name for a in diagnose_drive(real_base(1, second=0.025), stated).effects] == ["actuator_lag"]


@pytest.mark.slow
def test_better_encoders_do_not_make_a_trifle_material() -> None:
    """That motors ignore 1 cm/s is proven by fine encoders and matters to nobody; that they ignore 8 cm/s does."""
    trifle, real = (
        diagnose_drive(real_base(1, sigma=0.02, drag=(1.0, below)), ROBOT) for below in (0.01, 0.08)
    )
    assert trifle.unknown is None
    assert real.unknown is not None and real.unknown.size["speed_m_s"] > 0.005
    assert "off by" in real.unknown.statement and len(real.unknown.families) >= 1
