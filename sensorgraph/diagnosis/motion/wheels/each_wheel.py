"""Families of structure that each wheel causes separately: play, spinning, wheels out of round."""

from __future__ import annotations

import numpy as np

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.settings import ODOMETRY
from sensorgraph.diagnosis.motion.structure_test import StructureFamily
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.types import Floats
from sensorgraph.world.robot import Wheels

SMOOTHED = 5
"""Minimum number of increments over which a speed is averaged before its acceleration is computed."""
RAMP = 0.25
"""[s] minimum duration of that average: motors take that long, and ticks are not an acceleration."""


def reversals(rows: OdometryRows, wheels: WheelIncrements, rates: Floats, base: float) -> StructureFamily:
    """Return the family of play in a gear: the first millimetres of a wheel after a reversal are lost.

    Parameters
    ----------
    rates : (n, 2) [m/s, rad/s] Of the wheels' increments.
    base : [m] Wheelbase.
    """
    lost, by_turning = [], base / 2 * rates[:, 1]
    speeds = rates[:, 0] - by_turning, rates[:, 0] + by_turning
    for speed, signed in zip(speeds, wheels.sides(base), strict=True):
        way = np.abs(signed)
        sign = np.where(np.abs(speed) > ODOMETRY.structure.least_turning, np.sign(speed), 0.0)
        moving = np.flatnonzero(sign)
        turned_back = moving[1:][np.diff(sign[moving]) != 0]
        travelled = np.cumsum(way)
        since = np.searchsorted(turned_back, np.arange(len(way)), side="right") - 1
        # index -1, before the first reversal, gives -inf
        begin = np.append(travelled[turned_back] - way[turned_back], -np.inf)[since]
        inside = np.clip(
            (begin + ODOMETRY.structure.play - (travelled - way)) / np.maximum(way, 1e-9), 0.0, 1.0
        )
        lost.append(signed * inside)
    left, right = lost
    column = rows.of_sides(left, right, base)
    return StructureFamily(
        kind="reversal",
        columns=column[:, None],
        sigma=1.0,
        statement="a loss of motion after a wheel reverses: play",
    )


def spinning(rows: OdometryRows, wheels: WheelIncrements, base: float) -> StructureFamily:
    """Return the family of wheels that lose a share of their distance while they speed up, each separately.

    Parameters
    ----------
    base : [m] Wheelbase.
    """
    period, ways = wheels.end - wheels.start, wheels.sides(base)
    speeds = [smoothed(way / period, wheels) for way in ways]
    gained = [np.gradient(speed, wheels.middle) * np.sign(speed) for speed in speeds]
    columns = []
    for level in np.quantile(np.concatenate(gained), ODOMETRY.structure.spinning_quantiles):
        left, right = (way * (gain > max(level, 0.0)) for way, gain in zip(ways, gained, strict=True))
        columns.append(rows.of_sides(left, right, base))
    return StructureFamily(
        kind="spinning",
        columns=np.stack(columns, axis=1),
        statement="a loss of motion while wheels speed up: they spin",
    )


def turns_of_a_wheel(rows: OdometryRows, wheels: WheelIncrements, size: Wheels) -> list[StructureFamily]:
    """Return families of wheels that are out of round or misaligned: an error that repeats with every turn.

    The turns of a wheel are counted by its own distance. Over a long run, this requires a more accurate
    radius than robot.yaml specifies, so that several radii are tried.
    """
    left, right = wheels.sides(size.base)
    nothing, out = np.zeros(len(left)), list[StructureFamily]()
    for factor in ODOMETRY.structure.radius_factors:
        radius = factor * size.radius
        columns = [rows.of_sides(lost, nothing, size.base) for lost in _by_angle(left, radius)]
        columns += [rows.of_sides(nothing, lost, size.base) for lost in _by_angle(right, radius)]
        out.append(
            StructureFamily(
                kind="turns of a wheel",
                columns=np.stack(columns, axis=1),
                statement="an error that repeats with every turn of a wheel: it is out of round, or its encoder is misaligned",
                choice_price=float(np.log(len(ODOMETRY.structure.radius_factors))),
            )
        )
    return out


def _by_angle(way: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return the distance (n,) [m] of a wheel, multiplied by cosine and sine of its angle."""
    angle = (np.cumsum(way) - way / 2) / radius
    return way * np.cos(angle), way * np.sin(angle)


def smoothed(x: Floats, wheels: WheelIncrements) -> Floats:
    """Return a series (n,) averaged over several increments; their number is odd, so that there is no shift."""
    count = max(SMOOTHED, round(RAMP / float(np.median(wheels.end - wheels.start))))
    count |= 1
    return np.convolve(np.pad(x, count // 2, mode="edge"), np.ones(count) / count, mode="valid")
