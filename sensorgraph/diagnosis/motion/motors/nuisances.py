"""What every base does that no effect is: control ticks, and jitter of transport.

Columns of these are part of every model that structure is tested in, each in units of its standard deviation a priori.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.settings import DRIVE
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

WAIT_SIGMAS = 3.0
"""Standard deviations of the waits of commands, by which delays, or lags, of two stretches must differ to be no matter of these."""
PERIOD_ERROR = 0.01
"""Share of its period by which a base's loop may be off: robot.yaml says 33 ms of one that runs 30 times a second."""
IN_STEP = 0.7
"""Mean resultant length of phases, above which commands are in step with the loop."""
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
    is_beside = _is_period_stated(robot) and robot.actuators.delay < period / 2
    return period if is_beside else period / 2


def stated_smear(robot: Robot) -> float:
    """Return the lag [s] that commands seem to have because each waits for the next tick of the stated loop.

    Waits that are spread evenly over a period smear a step as a lag of their standard deviation does. 0: no period is stated.
    """
    return robot.tolerances.control_period / float(np.sqrt(12)) if _is_period_stated(robot) else 0.0


def _is_period_stated(robot: Robot) -> bool:
    return "tolerances.control_period" in robot.stated


def wait_between_stretches(model: DriveModel, fit: DriveFit, column: int, later: Floats) -> float:
    """Return by how much [s] delays, or lags, before and in a later stretch may differ, as commands wait for the base's loop.

    Each change of a command waits by itself, so that a stretch in which the base answers to few of them has the wait of these.
    Where the changes are in step with a stated loop, all of a stretch may wait a period longer than those before; where they
    come nearly in step, so that their phase wanders, neighbours wait alike.

    Parameters
    ----------
    column : of the regression, that of the delay or of the lag
    later : (2 n,) what it does to the rates in the later stretch; 0 elsewhere
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
    """Tell whether stamps (n,) [s] keep about one phase of a loop of a period [s], which is known to a per cent.

    The mean resultant length of their phases (Mardia and Jupp 2000, Directional Statistics, section 2.3.1), at the period
    where it is largest; of 20 stamps or more at random it stays below 0.7.
    """
    if period == 0 or len(stamps) < 2:
        return False
    cycles = float(np.ptp(stamps)) / period
    shares = np.linspace(-PERIOD_ERROR, PERIOD_ERROR, 2 * int(np.ceil(4 * PERIOD_ERROR * cycles)) + 1)
    phases = np.exp(2j * np.pi * stamps / (period * (1 + shares))[:, None])
    return bool(np.abs(phases.mean(axis=1)).max() > IN_STEP)


def n_in_step(stamps: Floats, period: float) -> int:
    """Return how many neighbours of stamps (n,) [s] keep about one phase of a loop of a period [s]; a power of two."""
    phases, n = np.exp(2j * np.pi * stamps / max(period, 1e-9)), 1
    while 2 * n <= len(phases):
        whole = len(phases) // (2 * n) * 2 * n
        if np.abs(phases[:whole].reshape(-1, 2 * n).mean(axis=1)).mean() <= IN_STEP:
            break
        n *= 2
    return n
