"""Normal behaviour of a base that is not an effect: ticks of its control loop, and jitter of the transport.

Every model that is tested for structure contains columns for these, in units of their prior standard
deviation.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.settings import DRIVE
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

WAIT_SIGMAS = 3.0
"""Standard deviations of the waiting times, within which the delays or lags of two stretches may differ."""
PERIOD_ERROR = 0.01
"""Maximum relative error of the loop period: robot.yaml may specify 33 ms for a loop at 30 Hz."""
IN_STEP = 0.7
"""Mean resultant length of the phases, above which commands are in phase with the loop."""
CHANGE = 0.1
"""Accumulated change of the commands that counts as a new command, as a share of the largest command."""


def drive_nuisances(model: DriveModel, fit: DriveFit) -> Floats:
    """Return the columns (2 n, m) of normal differences between commands and odometry."""
    rows = model.rows
    delays = delay_sigma(model.robot.tolerances.control_period, model.robot.tolerances.transport_jitter)
    n = int(np.clip(np.ptp(rows.end) / DRIVE.beat_time, 1, DRIVE.max_beats))
    piece = np.clip(n * (rows.end - rows.end[0]) / np.ptp(rows.end), 0, n - 1).astype(np.intp)
    by_delay = fit.columns[:, Column.DELAY] * delays
    return rows.masked(np.stack([by_delay * np.tile(piece == k, 2) for k in range(n)], axis=1))


def delay_sigma(control_period: float, transport_jitter: float) -> float:
    """Return the standard deviation of a command's delay [s].

        delay_sigma² = control_period² / 12 + transport_jitter²

    The wait for a tick of the base is uniform over one period.
    """
    return float(np.hypot(control_period / np.sqrt(12), transport_jitter))


def longest_wait(robot: Robot) -> float:
    """Return the maximum delay [s] of all commands beyond robot.yaml, if they are in phase with the control loop.

    Commands wait for a tick for up to a period. If `delay` contains the mean wait, the excess is half a
    period. If the period is specified and `delay` is too short to contain the mean wait, the excess is a
    whole period.
    """
    period = robot.tolerances.control_period
    is_beside = _is_period_stated(robot) and robot.actuators.delay < period / 2
    return period if is_beside else period / 2


def stated_smear(robot: Robot) -> float:
    """Return the apparent lag [s] of commands that each wait for the next tick of the specified loop.

    Waits that are uniform over a period smear a step like a lag equal to their standard deviation. The result
    is 0 if no period is specified.
    """
    return robot.tolerances.control_period / float(np.sqrt(12)) if _is_period_stated(robot) else 0.0


def _is_period_stated(robot: Robot) -> bool:
    return "tolerances.control_period" in robot.stated


def wait_between_stretches(model: DriveModel, fit: DriveFit, column: int, later: Floats) -> float:
    """Return the difference [s] of delays, or lags, of two stretches that waits for the control loop can cause.

    Each change of a command waits separately, so that a stretch with few changes has the waits of these. If
    the changes are in phase with a specified loop, all commands of a stretch may wait a period longer than
    those before. If their phase drifts slowly, neighbouring changes wait alike.

    Parameters
    ----------
    column : Of the regression, for the delay or for the lag.
    later : (2 n,) Contribution to the rates in the later stretch; 0 elsewhere.
    """
    rows, commands, tolerances = model.rows, model.simulation.commands, model.robot.tolerances
    top = np.maximum(np.abs(commands.values).max(axis=0), 1e-3)
    asked = np.cumsum(np.abs(np.diff(commands.values, axis=0) / top).max(axis=1))
    changes = commands.stamps[1:][np.diff(np.floor(asked / CHANGE), prepend=0.0) > 0]
    if _is_period_stated(model.robot) and is_in_step(changes, tolerances.control_period):
        return tolerances.control_period
    answered = np.searchsorted(changes, (rows.start + rows.end) / 2 - fit.motors.delay)
    if _is_period_stated(model.robot):
        answered = answered // n_in_step(changes, tolerances.control_period)
    by_wait, square = rows.masked(fit.columns[:, Column.DELAY]), 0.0
    for stretch in (rows.masked(fit.columns[:, column]) - later, later):
        told = np.bincount(answered, (stretch * by_wait).reshape(2, -1).sum(axis=0))
        square += float(np.square(told).sum() / max(float(np.square(stretch).sum()) ** 2, 1e-300))
    one = delay_sigma(tolerances.control_period, tolerances.transport_jitter)
    return WAIT_SIGMAS * one * float(np.sqrt(square))


def is_in_step(stamps: Floats, period: float) -> bool:
    """Tell whether stamps (n,) [s] are in phase with a loop, whose period [s] is known to one per cent.

        max over periods of |mean over n of exp(2 pi i stamps / period)| > IN_STEP

    This is the mean resultant length of the phases (Mardia and Jupp 2000, Directional Statistics, section
    2.3.1). For 20 or more random stamps it stays below 0.7.
    """
    if period == 0 or len(stamps) < 2:
        return False
    cycles = float(np.ptp(stamps)) / period
    shares = np.linspace(-PERIOD_ERROR, PERIOD_ERROR, 2 * int(np.ceil(4 * PERIOD_ERROR * cycles)) + 1)
    phases = np.exp(2j * np.pi * stamps / (period * (1 + shares))[:, None])
    return bool(np.abs(phases.mean(axis=1)).max() > IN_STEP)


def n_in_step(stamps: Floats, period: float) -> int:
    """Return the number of neighbouring stamps (n,) [s] in phase with a loop of a period [s]; a power of two."""
    phases, n = np.exp(2j * np.pi * stamps / max(period, 1e-9)), 1
    while 2 * n <= len(phases):
        whole = len(phases) // (2 * n) * 2 * n
        if np.abs(phases[:whole].reshape(-1, 2 * n).mean(axis=1)).mean() <= IN_STEP:
            break
        n *= 2
    return n
