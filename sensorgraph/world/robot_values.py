"""Values of robot.yaml: their types, dimensions and limits. Each mistake is an error of one line that contains the key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sensorgraph.errors import SensorgraphError, refuse_unknown
from sensorgraph.quantities import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    RATE,
    SPEED,
    TIME,
    TURN_ACCELERATION,
    TURN_RATE,
    Dimension,
    is_number,
    quantity,
    split_unit,
)

NUMBERS: tuple[tuple[Dimension, float, str], ...] = (
    (LENGTH, 200.0, "range_min range_max"),
    (LENGTH, 20.0, "footprint_radius turning_radius height radius base"),
    (LENGTH, 1.0, "sigma resolution sigma_xy map mount_xy pose_xy"),
    (ANGLE, 2 * math.pi, "fov angle_min angle_max angle_increment cone first"),
    (ANGLE, 1.0, "sigma_yaw mount_yaw pose_yaw"),
    (TIME, 10.0, "sweep_time sweep_period first_ray_delay tau delay"),
    (TIME, 1.0, "stamp control_period transport_jitter"),
    (RATE, 10_000.0, "rate"),
    (SPEED, 30.0, "v"),
    (SPEED, 1.0, "sigma_v"),
    (TURN_RATE, 20.0, "omega"),
    (TURN_RATE, 1.0, "sigma_omega"),
    (ACCELERATION, 50.0, "a"),
    (TURN_ACCELERATION, 100.0, "alpha"),
)
"""Dimension, largest absolute value that is accepted without a unit, and keys. A larger number lacks its unit: no
mobile robot is larger than 20 m or faster than 30 m/s, no laser measures beyond 200 m, and no error reaches 1."""
KINDS = {key: (dimension, most) for dimension, most, keys in NUMBERS for key in keys.split()}
MOUNT = ((LENGTH, 20.0), (LENGTH, 20.0), (ANGLE, 2 * math.pi))
MOST_COUNT = {"n_rays": 100_000, "interlaced_sweeps": 1000, "ring": 1000}
POSITIVE = {"v", "omega", "a", "alpha", "n_rays", "interlaced_sweeps", "fov", "range_max", "rate", "radius", "ring",
            "base", "footprint_radius"}  # fmt: skip
SIGNED = {
    "first_ray_delay",
    "sweep_time",
    "sweep_period",
    "angle_min",
    "angle_max",
    "angle_increment",
    "first",
}


def section(name: str, key: str, data: Any, defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return all values of a section; missing keys have their defaults.

    Raises
    ------
    SensorgraphError : A key is unknown or a value is invalid.
    """
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise SensorgraphError(f"{name}: `{key}` is {data!r}, expected keys {', '.join(defaults)}")
    refuse_unknown(data, defaults, "key", where=name, section=f"{key}.")
    return {k: value_of(name, f"{key}.{k}", data.get(k, default), default) for k, default in defaults.items()}


def value_of(name: str, key: str, value: Any, default: Any) -> Any:
    """Return a checked value of the type of its default, in SI units.

    Raises
    ------
    SensorgraphError : The value has another type, another unit, or is beyond its limits.
    """
    last = key.rpartition(".")[2]
    if value is None and default is None:
        return None
    if isinstance(default, str):
        if not isinstance(value, str):
            raise SensorgraphError(f"{name}: `{key}` is {value!r}, expected a word such as {default!r}")
        return value
    if isinstance(default, list):
        if not isinstance(value, list) or len(value) != len(default):
            raise SensorgraphError(
                f"{name}: `{key}` is {value!r}, expected {len(default)} numbers such as {default}"
            )
        return [_number(name, key, part, *kind) for part, kind in zip(value, MOUNT, strict=True)]
    number = (
        _count(name, key, value, default)
        if isinstance(default, int)
        else _number(name, key, value, *KINDS[last], default=default)
    )
    if (number < 0 and last not in SIGNED) or (number <= 0 and last in POSITIVE):
        least = "a value above 0" if last in POSITIVE else "0 or more"
        raise SensorgraphError(f"{name}: `{key}` is {value}, expected {least}")
    return number


def _count(name: str, key: str, value: Any, default: int) -> int:
    """Return a whole number."""
    number, unit = split_unit(value)
    if not is_number(number) or unit or number != int(number):
        raise SensorgraphError(f"{name}: `{key}` is {value!r}, expected a whole number such as {default}")
    most = MOST_COUNT[key.rpartition(".")[2]]
    if number > most:
        raise SensorgraphError(f"{name}: `{key}` is {number:g}, expected {most:g} or less")
    return int(number)


def _number(
    name: str, key: str, value: Any, dimension: Dimension, most: float, *, default: float | None = None
) -> float:
    """Return a number in the SI unit of its dimension; a rounded full turn is a full turn."""
    result = quantity(value, f"{name}: `{key}`", dimension, most=most, default=default)
    return math.copysign(min(abs(result), dimension.most), result)
