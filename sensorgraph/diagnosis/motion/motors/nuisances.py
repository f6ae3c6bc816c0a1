"""Normal behaviour of a base that is not an effect: ticks of its control loop, and jitter of the transport.

Every model that is tested for structure contains columns for these, in units of their prior standard
deviation.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel
from sensorgraph.effects import Amendment
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

BEAT_TIME = 5.0
"""[s] over which the control loop of the base and the stamps of the commands keep their phase."""
MAX_BEATS = 24
"""Maximum number of pieces of the run with separate delays; in a longer run they are longer."""


def drive_nuisances(model: DriveModel, fit: DriveFit) -> Floats:
    """Return the columns (2 n, m) of normal differences between commands and odometry."""
    rows = model.rows
    delays = delay_sigma(model.robot.tolerances.control_period, model.robot.tolerances.transport_jitter)
    n = int(np.clip(np.ptp(rows.end) / BEAT_TIME, 1, MAX_BEATS))
    piece = np.clip(n * (rows.end - rows.end[0]) / np.ptp(rows.end), 0, n - 1).astype(np.intp)
    by_delay = fit.columns[:, Column.DELAY] * delays
    return rows.masked(np.stack([by_delay * np.tile(piece == k, 2) for k in range(n)], axis=1))


def delay_sigma(control_period: float, transport_jitter: float) -> float:
    """Return the standard deviation of a command's delay [s].

        delay_sigma² = control_period² / 12 + transport_jitter²

    The wait for a tick of the base is uniform over one period.
    """
    return float(np.hypot(control_period / np.sqrt(12), transport_jitter))


def due_to_loop(robot: Robot, a: Amendment) -> float:
    """Return the part of a delay or a lag [s] that the control loop of the base may cause; 0 for other effects."""
    if a.effect is DEAD_TIME:
        return longest_wait(robot)
    return stated_smear(robot) if a.effect is ACTUATOR_LAG and a["tau"] > 0 else 0.0


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
