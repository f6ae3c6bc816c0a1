"""Bases that do not do what they are told for a moment: a link that drops out, motors that cut out, commands that wait."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import further
from diagnosis_samples import ROBOT, make_run, reported

from logs.run import Run
from sensorgraph.diagnosis.motion.drive_channel import diagnose_drive


@pytest.mark.parametrize("seed", [3, *further(4)])
def test_a_link_that_drops_out_is_unknown_and_said_so(seed: int) -> None:
    outages = tuple((begin, begin + 0.8) for begin in range(6, 78, 6))
    result = diagnose_drive(make_run(seed, outages=outages), ROBOT)
    assert result.effects == ()
    assert result.unknown is not None and "a link that drops out" in result.unknown.statement


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
