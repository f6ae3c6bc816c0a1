"""What every base does that no effect is: control ticks, and jitter of transport.

Columns of these are part of every model that structure is tested in, each in units of its standard deviation a priori.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.settings import DRIVE
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

WAIT_SIGMAS = 3.0
"""Standard deviations of the waits of commands, by which delays of two stretches must differ to be no matter of these."""
LOOP_ERROR = 0.01
"""Share of its period by which a base's loop may be off: robot.yaml says 33 ms of one that runs 30 times a second."""
LEAST_DRIFT = 1e-5
"""The same of two crystals, by which the phases of loop and commands drift at least: a millisecond in a run."""
BEAT_PHASES, BEAT_PERIODS = 20, 20
"""Phases, and periods above and below the stated one, that are tried."""
CHANGE = 0.1
"""Of the largest command, by which commands have changed in all when they count as another one."""


def drive_nuisances(model: DriveModel, fit: DriveFit) -> Floats:
    """Return the columns (2 n, m) of what commands and odometry may differ by without an effect."""
    rows = model.rows
    delays = delay_sigma(model.robot.tolerances.control_period, model.robot.tolerances.transport_jitter)
    n = int(np.clip(np.ptp(rows.end) / DRIVE.beat_time, 1, DRIVE.max_beats))
    piece = np.clip(n * (rows.end - rows.end[0]) / np.ptp(rows.end), 0, n - 1).astype(np.intp)
    by_delay = fit.columns[:, Column.DELAY] * delays
    return rows.masked(np.stack([by_delay * np.tile(piece == k, 2) for k in range(n)], axis=1))


def delay_sigma(control_period: float, transport_jitter: float) -> float:
    """Return the standard deviation of a command's delay [s]: uniform over one tick of the base, and the transport's."""
    return float(np.hypot(control_period / np.sqrt(12), transport_jitter))


def longest_wait(robot: Robot) -> float:
    """Return by how much [s] all commands may act later than robot.yaml says, if the base's loop keeps step with them.

    They wait for its tick up to a period. That is half a period more than the mean wait, if `delay` holds that; where the
    period is stated beside a delay that is too short to hold it, it does not.
    """
    period = robot.tolerances.control_period
    is_beside = "tolerances.control_period" in robot.stated and robot.actuators.delay < period / 2
    return period if is_beside else period / 2


def stated_smear(robot: Robot) -> float:
    """Return the lag [s] that commands seem to have because each waits for the next tick of the stated loop.

    Waits that are spread evenly over a period smear a step as a lag of their standard deviation does. 0: no period is stated.
    """
    is_stated = "tolerances.control_period" in robot.stated
    return robot.tolerances.control_period / float(np.sqrt(12)) if is_stated else 0.0


@dataclass(frozen=True, kw_only=True)
class _AnsweredCommands:
    """How much each change of a command tells of a delay, or lag, in two stretches of a run."""

    stamps: Floats
    """(n,) [s] of the changes."""
    weights: Floats
    """(2, n) what a wait of each adds to the number told of the stretch before, and of the later one; of a delay, shares."""


def wait_between_stretches(model: DriveModel, fit: DriveFit, column: int, later: Floats) -> float:
    """Return by how much [s] delays, or lags, before and in a later stretch may differ, as commands wait for the base's loop.

    Each change of a command waits for the next tick: by itself, so that a stretch in which the base answers to few of them
    has the wait of these; or in step with the loop, where commands come at about a multiple of its period and the two beat.

    Parameters
    ----------
    column : of the regression, that of the delay or of the lag
    later : (2 n,) what it does to the rates in the later stretch; 0 elsewhere
    """
    answered = _answered_commands(model, fit, column, later)
    tolerances = model.robot.tolerances
    by_itself = delay_sigma(tolerances.control_period, tolerances.transport_jitter) * np.linalg.norm(
        answered.weights
    )
    return max(WAIT_SIGMAS * float(by_itself), _beat(answered, tolerances.control_period))


def _answered_commands(model: DriveModel, fit: DriveFit, column: int, later: Floats) -> _AnsweredCommands:
    rows, commands = model.rows, model.simulation.commands
    top = np.maximum(np.abs(commands.values).max(axis=0), 1e-3)
    asked = np.cumsum(np.abs(np.diff(commands.values, axis=0) / top).max(axis=1))
    changes = commands.stamps[1:][np.diff(np.floor(asked / CHANGE), prepend=0.0) > 0]
    answered = np.searchsorted(changes, (rows.start + rows.end) / 2 - fit.motors.delay)
    by_wait = fit.columns[:, Column.DELAY]
    weights = []
    for one in (fit.columns[:, column] - later, later):
        told = np.bincount(answered, (one * by_wait).reshape(2, -1).sum(axis=0), minlength=len(changes) + 1)
        weights.append(told[1:] / max(float((one**2).sum()), 1e-300))
    return _AnsweredCommands(stamps=changes, weights=np.stack(weights))


def _beat(answered: _AnsweredCommands, period: float) -> float:
    """Return by how much [s] two stretches differ at the worst phase of a loop that keeps its period to a per cent."""
    if period == 0 or not len(answered.stamps):
        return 0.0
    before, later = answered.weights / np.maximum(answered.weights.sum(axis=1, keepdims=True), 1e-9)
    scale = float(answered.weights.sum(axis=1).max())
    phases = np.arange(BEAT_PHASES) / BEAT_PHASES
    worst, drifts = 0.0, np.geomspace(LEAST_DRIFT, LOOP_ERROR, BEAT_PERIODS)
    for true in period * (1 + np.concatenate([-drifts, drifts])):
        waits = true * ((phases[:, None] - answered.stamps / true) % 1.0)
        worst = max(worst, float(np.abs(waits @ (later - before)).max()))
    return worst * scale
