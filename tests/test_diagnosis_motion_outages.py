"""Bases that do not do what they are told for a moment: a link that drops out, motors that cut out, commands that wait."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run, reported

from logs.run import Run
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive
from sensorgraph.diagnosis.motion.motors.model import Column
from sensorgraph.diagnosis.motion.motors.nuisances import (
    delay_sigma,
    is_in_step,
    n_in_step,
    wait_between_stretches,
)
from sensorgraph.world.robot import Robot


@pytest.mark.parametrize("seed", [3, *further(4)])
def test_a_link_that_drops_out_is_unknown_and_said_so(seed: int) -> None:
    outages = tuple((begin, begin + 0.8) for begin in range(6, 78, 6))
    result = diagnose_drive(make_run(seed, outages=outages), ROBOT)
    assert result.effects == ()
    assert result.unknown is not None and "pauses in which the base stands" in result.unknown.statement


def cut_out(run: Run, times: tuple[tuple[float, float], ...], slowest: float) -> Run:
    """Return the run of a base whose motors have no power for some times, and brake and recover by `slowest` [m/s²]."""
    v, omega = run.odom_twists.T
    share, out = 1.0, np.empty(len(v))
    for k, t in enumerate(run.odom_stamps):
        goal = 0.0 if any(begin <= t < end for begin, end in times) else 1.0
        share += float(np.clip(goal - share, -1, 1) * min(1.0, slowest * 0.05 / max(abs(v[k]), 0.05)))
        out[k] = share
    return reported(run, v * out, omega * out)


@pytest.mark.parametrize("seed", [3, *further(5)])
def test_motors_that_cut_out_for_a_moment_are_unknown_though_the_base_never_stands(seed: int) -> None:
    times = tuple((begin, begin + 0.7) for begin in range(7, 78, 9))
    result = diagnose_drive(cut_out(make_run(seed), times, 0.3), ROBOT)
    assert result.effects == ()
    assert result.unknown is not None and "a temporary loss of speed" in result.unknown.statement


def wait_between_halves(n_late: int, *, in_step: bool, robot: Robot = ROBOT) -> float:
    """Return by how much [s] the delay of a run of 20 changes may differ from that of its later half, as commands wait.

    Parameters
    ----------
    n_late : changes of the later half that tell of its delay
    in_step : changes come at multiples of the loop's period
    """
    columns = np.zeros((200, len(Column)))
    starts = np.arange(0, 200, 10)
    columns[starts, Column.DELAY] = np.where(starts >= 100 + 10 * n_late, 0.01, 1.0)
    columns = np.concatenate([columns, np.zeros_like(columns)])
    values = np.repeat(np.arange(20.0) % 2, 10)[:, None] * [1.0, 0.0]
    at = robot.tolerances.control_period * 2 * np.arange(200)
    late = np.zeros(200) if in_step else np.random.default_rng(0).uniform(0, 0.05, 200)
    rows = SimpleNamespace(start=at, end=at + at[1], masked=lambda column: column)
    simulation = SimpleNamespace(commands=SimpleNamespace(stamps=at + late, values=values))
    model: Any = SimpleNamespace(rows=rows, simulation=simulation, robot=robot)
    fit: Any = SimpleNamespace(columns=columns, motors=SimpleNamespace(delay=0.0))
    later = np.where(np.arange(400) % 200 >= 100, columns[:, Column.DELAY], 0.0)
    return wait_between_stretches(model, fit, Column.DELAY, later)


def test_a_single_command_that_waits_longer_is_no_change_of_the_motors_delay() -> None:
    """Each command waits for the base by itself: a stretch of one command has the wait of that one."""
    one = delay_sigma(ROBOT.tolerances.control_period, ROBOT.tolerances.transport_jitter)
    single, many = (wait_between_halves(n, in_step=False) for n in (1, 10))
    assert single == pytest.approx(3 * one * np.sqrt(1 + 1 / 10), rel=0.06)
    assert many == pytest.approx(3 * one * np.sqrt(2 / 10), rel=0.06)


def test_commands_in_step_with_a_stated_loop_may_all_wait_a_period_longer_after_a_while() -> None:
    stated = replace(ROBOT, stated=frozenset({"tolerances.control_period"}))
    whole = ROBOT.tolerances.control_period
    assert wait_between_halves(10, in_step=True, robot=stated) == whole
    assert wait_between_halves(10, in_step=True) < 0.5 * whole
    assert wait_between_halves(10, in_step=False, robot=stated) < 0.5 * whole


@pytest.mark.parametrize(
    ("interval", "period", "jitter", "is_so"),
    [
        (0.1, 0.05, 0.004, True),
        (0.1, 0.033, 0.0, True),
        (1 / 15, 0.02, 0.0, False),
        (0.1, 0.05, 0.03, False),
        (0.1, 0.04, 0.0, False),
    ],
)
def test_commands_are_in_step_with_a_loop_that_divides_their_interval(
    interval: float, period: float, jitter: float, is_so: bool
) -> None:
    """33 ms are said of a loop that runs 30 times a second, of which commands at 10 Hz come every third time."""
    rng = np.random.default_rng(0)
    stamps = interval * np.sort(rng.choice(1000, 60, replace=False)) + rng.normal(size=60) * jitter
    assert is_in_step(stamps, period) is is_so


def test_stamps_at_random_are_in_step_with_no_loop() -> None:
    rng = np.random.default_rng(1)
    assert not any(is_in_step(np.sort(rng.uniform(0, 100, 20)), 0.05) for _ in range(200))


def heard(run: Run, silent: float, seed: int = 0) -> Run:
    """Return the run of a base that goes on as told last while its link loses commands, for up to `silent` [s] at a time."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, run.odom_stamps[-1], 0.01)
    told = run.commands[np.searchsorted(run.cmd_stamps, fine, side="right") - 1]
    out, is_lost_until = np.zeros((len(fine), 2)), 0.0
    last = told[0]
    for k in range(1, len(fine)):
        if fine[k] > is_lost_until and silent > 0 and rng.random() < 0.004:
            is_lost_until = fine[k] + rng.uniform(0.3, 1.0) * silent
        last = last if fine[k] < is_lost_until else told[k]
        out[k] = out[k - 1] + 0.1 * (last - out[k - 1])
    v, omega = (np.interp(run.odom_stamps - 0.025, fine, c) for c in out.T)
    return reported(run, v, omega)


@pytest.mark.parametrize("silent", [1.2, *further(0.0)])
@pytest.mark.slow
def test_a_link_that_loses_commands_is_no_lag(silent: float) -> None:
    result = diagnose_drive(heard(make_run(3), silent), ROBOT)
    assert result.effects == () and (result.unknown is not None) == (silent > 0)


@pytest.mark.parametrize(("share", "is_told"), [(0.08, True), (0.004, False)])
def test_a_speed_that_is_off_for_seconds_at_a_time_is_unknown_though_it_looks_like_noise(
    share: float, is_told: bool
) -> None:
    run = make_run(5)
    t = run.odom_stamps
    wander = np.sqrt(2 / 3) * sum(np.sin(2 * np.pi * t / period + period) for period in (5.3, 7.9, 11.7))
    v, omega = run.odom_twists.T
    result = diagnose_drive(reported(run, v * (1 + share * wander), omega), ROBOT)
    assert result.effects == () and (result.unknown is not None) == is_told
    if result.unknown is not None:
        assert result.unknown.size is not None and result.unknown.size["speed_m_s"] > 0.005


@pytest.mark.parametrize(
    ("step", "jitter", "least", "most"),
    [(0.1, 0.0, 256, 256), (0.1, 0.004, 4, 64), (0.0667, 0.0, 1, 1), (0.0667, 0.02, 1, 1)],
    ids=["in step", "nearly in step", "through all phases", "at random"],
)
def test_neighbours_that_keep_a_phase_are_counted(step: float, jitter: float, least: int, most: int) -> None:
    """Of a clock whose errors add up, as that of a program which sleeps between commands."""
    rng = np.random.default_rng(2)
    stamps = np.cumsum(step + jitter * rng.normal(size=256))
    assert least <= n_in_step(stamps, 0.05) <= most
