"""Select a ray by its index or by its bearing from the robot."""

from __future__ import annotations

import math

import numpy as np

from logs.run import RangeSensor
from sensorgraph.errors import SensorgraphError


def ray_at(sensor: RangeSensor, bearing_deg: float) -> int:
    """Return the index of the ray nearest to a bearing.

    Parameters
    ----------
    bearing_deg : [deg] Bearing from straight ahead of the robot, counter-clockwise; it includes the yaw of the mount.

    Raises
    ------
    SensorgraphError : The nearest ray is farther away than the widest step between rays.
    """
    looks = np.degrees(sensor.bearings + sensor.mount[2])
    turn = bearing_deg if math.isfinite(bearing_deg) else np.nan
    off = np.abs((looks - turn + 180.0) % 360.0 - 180.0)
    nearest = int(off.argmin())
    step = float(np.diff(np.sort(looks)).max()) if len(looks) > 1 else 1.0
    if not off[nearest] <= step + 1e-9:
        raise SensorgraphError(
            f"no ray at {bearing_deg:g}°: the sensor looks from {looks.min():.1f}° to {looks.max():.1f}°, "
            "counter-clockwise from straight ahead; choose a `bearing` in this interval"
        )
    return nearest


def chosen_ray(sensor: RangeSensor, ray: int | None, bearing_deg: float | None) -> int | None:
    """Return the index of the ray given by index or by bearing [deg]; None if neither is given.

    Raises
    ------
    SensorgraphError : Both are given, or no ray has this bearing.
    """
    if bearing_deg is None:
        return ray
    if ray is not None:
        raise SensorgraphError("both `ray` and `bearing` are given; give one of them")
    return ray_at(sensor, bearing_deg)
