"""Columns of the odometry channel's regression: one for each wheel effect, the clock, and the marker beside the axle.

The rows are what the reference did less what the wheels say. What a wheel effect does to them stands on the effect
(`Diagnostics.wheel_regressor`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.effects import EFFECTS, Effect
from sensorgraph.effects.interfaces import WheelMotion, WheelRegressor
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.types import Floats


@dataclass(frozen=True)
class WheelTerm:
    """An effect and its column in the regression."""

    effect: Effect
    column: int


WHEEL_REGRESSORS: tuple[tuple[Effect, WheelRegressor], ...] = tuple(
    (effect, effect.diagnostics.wheel_regressor)
    for effect in EFFECTS.values()
    if effect.diagnostics.wheel_regressor is not None
)
"""Wheel effects that act everywhere, and how they enter."""
WHEEL_TERMS: tuple[WheelTerm, ...] = tuple(
    WheelTerm(effect, k)
    for k, effect in enumerate([*(effect for effect, _ in WHEEL_REGRESSORS), POSE_CLOCK_OFFSET])
)
"""Effects that act everywhere, the clock last."""
CLOCK_COLUMN = len(WHEEL_REGRESSORS)
"""Column of the clock offset."""
N_COLUMNS = CLOCK_COLUMN + 2
"""Columns before those of patches: the last is that of the marker."""


def columns_and_rows(rows: OdometryRows, wheels: WheelIncrements, base: float) -> tuple[Floats, Floats]:
    """Return columns (2 n, N_COLUMNS) and rows (2 n,), distances first, then turns; 0 where not valid.

    Parameters
    ----------
    base : [m] wheelbase
    """
    distance, turn = rows.D_along @ wheels.distance, rows.D_yaw @ wheels.turn
    motion = WheelMotion(distance=distance, turn=turn, path=rows.D_yaw @ wheels.distance, base=base)
    columns = [np.concatenate(regressor.column(motion)) for _, regressor in WHEEL_REGRESSORS]
    columns.append(rows.slopes.T.ravel())
    columns.append(
        np.concatenate([-turn, np.zeros(rows.n)])
    )  # a marker beside the axle swings as the robot turns
    y = np.concatenate([rows.along - distance, rows.yaw - turn])
    return rows.masked(np.stack(columns, axis=1)), rows.masked(y)
