"""Columns of the regression of the odometry channel: wheel effects, the clock, and the marker offset.

A row is the motion of the reference minus that of the wheels. The column of a wheel effect is defined by the
effect (`Diagnostics.wheel_regressor`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.regression import Term
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.effects import EFFECTS, Effect
from sensorgraph.effects.interfaces import WheelMotion, WheelRegressor
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.types import Floats


@dataclass(frozen=True, kw_only=True)
class WheelColumns:
    """Order of the columns: wheel effects in the order of the library, the clock, the marker; patches follow."""

    regressors: tuple[tuple[Effect, WheelRegressor], ...]
    """Wheel effects that act everywhere, and their columns."""

    @classmethod
    def of_library(cls) -> WheelColumns:
        """Return the columns of the effects in the library."""
        found = [(effect, effect.diagnostics.wheel_regressor) for effect in EFFECTS.values()]
        return cls(
            regressors=tuple((effect, regressor) for effect, regressor in found if regressor is not None)
        )

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects that act everywhere, the clock last."""
        effects = [*(effect for effect, _ in self.regressors), POSE_CLOCK_OFFSET]
        return tuple(Term(effect, k) for k, effect in enumerate(effects))

    @property
    def clock(self) -> int:
        """Column of the clock offset."""
        return len(self.regressors)

    @property
    def n(self) -> int:
        """Number of columns before those of patches; the last is that of the marker."""
        return self.clock + 2

    def evaluate(self, rows: OdometryRows, motion: WheelIncrements, base: float) -> Floats:
        """Return the columns (2 n_rows, n), distances first, then turns; 0 where not valid.

        Parameters
        ----------
        motion : Motion of the wheels; for structure tests, without noise (`fused_motion`).
        base : [m] Wheelbase.
        """
        distance, turn = rows.D_along @ motion.distance, rows.D_yaw @ motion.turn
        moved = WheelMotion(distance=distance, turn=turn, path=rows.D_yaw @ motion.distance, base=base)
        columns = [np.concatenate(regressor.column(moved)) for _, regressor in self.regressors]
        columns.append(rows.slopes.T.ravel())
        columns.append(
            np.concatenate([-turn, np.zeros(rows.n)])
        )  # a marker off the axle swings as the robot turns
        return rows.masked(np.stack(columns, axis=1))


def wheel_rows(rows: OdometryRows, wheels: WheelIncrements) -> Floats:
    """Return reference minus wheels (2 n,), distances first, then turns; 0 where not valid."""
    return rows.masked(
        np.concatenate([rows.along - rows.D_along @ wheels.distance, rows.yaw - rows.D_yaw @ wheels.turn])
    )
