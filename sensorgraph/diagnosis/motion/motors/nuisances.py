"""What every base does that no effect is: control ticks, and jitter of transport.

Columns of these are part of every model that structure is tested in, each in units of its standard deviation a priori.
"""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.motors.model import Column, DriveFit, DriveModel
from sensorgraph.diagnosis.motion.settings import DRIVE
from sensorgraph.types import Floats


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
