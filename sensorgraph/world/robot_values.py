"""Values of robot.yaml: their types, units and limits. Each mistake is an error of one line that contains the key."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sensorgraph.errors import SensorgraphError

LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6}
ANGLES = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180, "degrees": math.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """A physical dimension: its SI unit and its other units."""

    words: str
    """Name of the SI unit in a sentence."""
    units: Mapping[str, float]
    """Unit -> size in the SI unit; the SI unit is first."""
    most: float = math.inf
    """Largest absolute value, in the SI unit, whatever the unit it is written in."""


LENGTH = Dimension(words="metres", units=LENGTHS)
ANGLE = Dimension(words="radians", units=ANGLES, most=2 * math.pi)
TIME = Dimension(words="seconds", units=TIMES)
RATE = Dimension(words="hertz", units={"Hz": 1.0, "kHz": 1e3, "rpm": 1 / 60}, most=10_000.0)
SPEED = Dimension(
    words="m/s", units={f"{unit}/s": size for unit, size in LENGTHS.items()} | {"km/h": 1 / 3.6}
)
TURN_RATE = Dimension(
    words="rad/s", units={f"{unit}/s": size for unit, size in ANGLES.items()} | {"rpm": 2 * math.pi / 60}
)
ACCELERATION = Dimension(words="m/s²", units={f"{unit}/s²": size for unit, size in LENGTHS.items()})
TURN_ACCELERATION = Dimension(words="rad/s²", units={f"{unit}/s²": size for unit, size in ANGLES.items()})

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
ROUNDED = 0.005
"""[rad] Largest error of an angle with two decimals, such as 6.28 for a full turn."""
_NUMBER = re.compile(r"([-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")


def reject_unknown(name: str, where: str, data: Mapping[Any, Any], known: list[str]) -> None:
    """Refuse a key that is not known, and suggest the most similar one.

    Raises
    ------
    SensorgraphError : A key is unknown.
    """
    for key in data:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
            raise SensorgraphError(f"{name}: unknown key `{where}{key}`; did you mean `{where}{near[0]}`?")


def section(name: str, key: str, data: Any, defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return all values of a section; missing keys have their defaults.

    Raises
    ------
    SensorgraphError : A key is unknown or a value is invalid.
    """
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise SensorgraphError(f"{name}: `{key}` is {data!r}, expected keys {', '.join(defaults)}")
    reject_unknown(name, f"{key}.", data, list(defaults))
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
    number, unit = _split(value)
    if not _is_number(number) or unit or number != int(number):
        raise SensorgraphError(f"{name}: `{key}` is {value!r}, expected a whole number such as {default}")
    most = MOST_COUNT[key.rpartition(".")[2]]
    if number > most:
        raise SensorgraphError(f"{name}: `{key}` is {number:g}, expected {most:g} or less")
    return int(number)


def _number(
    name: str, key: str, value: Any, dimension: Dimension, most: float, *, default: float | None = None
) -> float:
    """Return a number in the SI unit of its dimension."""
    number, unit = _split(value)
    if not _is_number(number) or (unit and unit not in dimension.units):
        such = "" if default is None else f" such as {default}"
        raise SensorgraphError(
            f"{name}: `{key}` is {value!r}, expected a number{such}, in {dimension.words} or with a unit "
            f"({', '.join(dimension.units)})"
        )
    result = float(number) * (dimension.units[unit] if unit else 1.0)
    largest = most if not unit else dimension.most
    if dimension is ANGLE and largest == dimension.most < abs(result) <= largest + ROUNDED:
        return math.copysign(largest, result)
    if abs(result) > largest:
        raise SensorgraphError(
            f"{name}: `{key}` is {_beyond(value, float(number), unit, dimension, largest, default)}"
        )
    return result


def _beyond(
    value: Any, number: float, unit: str, dimension: Dimension, most: float, default: float | None
) -> str:
    """Return the end of the message on a number beyond its limit: with the unit that was probably meant, if it has none."""
    si = next(iter(dimension.units))
    if unit:
        return f"{value}; expected at most {_text(most / dimension.units[unit])} {unit}"
    sizes = {one: abs(number) * size for one, size in dimension.units.items() if size < 1}
    fitting = [one for one, size in sizes.items() if size <= most]
    if default:  # the unit in which the value is nearest to the default
        fitting.sort(key=lambda one: abs(math.log(sizes[one] / abs(default))))
    write = f"; write {number:g} {fitting[0]}" if fitting else ""
    if abs(number) <= dimension.most:
        write += f"{', or' if fitting else '; write'} {number:g} {si} if {dimension.words} are meant"
    return f"{number:g}; expected {dimension.words}, at most {_text(most)}{write}"


def _text(number: float) -> str:
    return f"{round(number, 2):g}"


def _split(value: Any) -> tuple[Any, str]:
    """Return a number and its unit: of `120 mm`, and of `1e-3`, which YAML reads as text; another value as it is."""
    found = _NUMBER.fullmatch(value.strip().replace("−", "-")) if isinstance(value, str) else None
    if found is None:
        return value, ""
    unit = found[2].replace("**2", "²").replace("^2", "²")
    return float(found[1]), unit[:-1] + "²" if unit.endswith("2") else unit


def _is_number(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return (
        abs(value) < math.inf and not math.isnan(value) if isinstance(value, float) else abs(value) < 10**300
    )
