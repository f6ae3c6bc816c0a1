"""Drive channel: commands against odometry, for lag, dead time and saturation of the motors.

Each set of effects is a small simulation of the motors (dead time, first-order lag, limited acceleration). It
is fitted to the motion that the wheels report.
"""

from __future__ import annotations

from collections.abc import Sequence

from logs.run import Run
from sensorgraph.diagnosis.motion.increments import ChannelSkippedError, wheel_increments
from sensorgraph.diagnosis.motion.motors.constant_gain import select_under_any_gain, with_constant_gain
from sensorgraph.diagnosis.motion.motors.model import DriveModel
from sensorgraph.diagnosis.motion.motors.report import drive_result
from sensorgraph.diagnosis.motion.motors.rows import commands_of, drive_rows
from sensorgraph.diagnosis.motion.motors.selection import MotorSelection, with_structure
from sensorgraph.diagnosis.motion.odometry_channel import odometry_clock_offset
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.result import ChannelResult, MotionDifference
from sensorgraph.effects import Amendment
from sensorgraph.world.robot import Robot


def diagnose_drive(
    run: Run,
    robot: Robot,
    *,
    use_clock: bool = True,
    wheels: MotionDifference | None = None,
    named_wheels: Sequence[Amendment] = (),
) -> ChannelResult:
    """Name the effects that make commands and odometry differ.

    A run without odometry or commands is skipped, with the reason in `ChannelResult.skipped`.

    Parameters
    ----------
    use_clock : Use the reference poses to correct the clock offset of the odometry.
    wheels : Motion that the odometry channel has explained by slip or structure.
    named_wheels : Effects that the odometry channel has named.
    """
    try:
        increments = wheel_increments(run)
        commands = commands_of(run)
        clock = odometry_clock_offset(run, robot) if use_clock else None
        rows = drive_rows(increments, commands, robot, clock)
    except ChannelSkippedError as exc:
        return ChannelResult(channel="drive", skipped=str(exc))
    model, selected = _explain(DriveModel(commands, rows, robot, wheels), named_wheels)
    if selected.terms or selected.structure is not None:
        ramped, other = _explain(model.with_ramped_set_point(), named_wheels)
        if other.log_likelihood(ramped) > selected.log_likelihood(model) + EVIDENCE.threshold:
            model, selected = ramped, other
    return drive_result(model, selected)


def _explain(model: DriveModel, named_wheels: Sequence[Amendment]) -> tuple[DriveModel, MotorSelection]:
    """Select effects and structure under the acceleration limits of the model, with a separate noise fit.

    Returns the model, with its gains bounded or free, and the selection.
    """
    model, selected = select_under_any_gain(model)
    return model, with_constant_gain(model, with_structure(model, selected), named_wheels)
