"""Which ray a person means: by its index, or by where it looks from the robot."""

from __future__ import annotations

import math

import numpy as np

from logs.run import RangeSensor
from sensorgraph.errors import SensorgraphError


def ray_at(sensor: RangeSensor, bearing_deg: float) -> int:
    """Return the index of the ray that looks nearest to a bearing.

    Parameters
    ----------
    bearing_deg : [deg] from straight ahead of the robot, counter-clockwise; the mount's yaw is counted

    Raises
    ------
    SensorgraphError : the sensor does not look there: the nearest ray is more than the widest step between rays away
    """
    looks = np.degrees(sensor.bearings + sensor.mount[2])
    turn = bearing_deg if math.isfinite(bearing_deg) else np.nan
    off = np.abs((looks - turn + 180.0) % 360.0 - 180.0)
    nearest = int(off.argmin())
    step = float(np.diff(np.sort(looks)).max()) if len(looks) > 1 else 1.0
    if not off[nearest] <= step + 1e-9:
        raise SensorgraphError(
            f"no ray looks to {bearing_deg:g}°: the sensor looks from {looks.min():.1f}° to {looks.max():.1f}°, "
            "counted counter-clockwise from straight ahead; choose a `bearing` in between"
        )
    return nearest


def chosen_ray(sensor: RangeSensor, ray: int | None, bearing_deg: float | None) -> int | None:
    """Return the index of the ray that was asked for by index or by bearing [deg]; None: neither was given.

    Raises
    ------
    SensorgraphError : both are given, or no ray looks there
    """
    if bearing_deg is None:
        return ray
    if ray is not None:
        raise SensorgraphError("both `ray` and `bearing` are given; give one of them")
    return ray_at(sensor, bearing_deg)
