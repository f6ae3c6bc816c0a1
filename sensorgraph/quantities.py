"""Numbers with a unit, as users write them: `120 mm`, `1.5 deg`, or in the SI unit without one.

Each mistake is an error of one line that says what came, what was expected and what to write.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sensorgraph.errors import SensorgraphError

LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6}
ANGLES = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180, "degrees": math.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
ROUNDED = 0.005
"""[rad] Largest error of an angle with two decimals, such as 6.28 for a full turn."""
_NUMBER = re.compile(r"([-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)")


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
NO_UNIT = Dimension(words="no unit", units={})
POSE = (LENGTH, LENGTH, ANGLE)
"""Dimensions of x, y, phi."""


def quantity(
    value: Any, what: str, dimension: Dimension, *, most: float | None = None, default: float | None = None
) -> float:
    """Return a number in the SI unit of its dimension; an angle may exceed a full turn by `ROUNDED`.

    Parameters
    ----------
    value : A number, or a text such as `120 mm`.
    what : Name of the value in a message, with its place.
    most : Largest absolute value that is accepted without a unit. None: that of the dimension.
    default : The usual value, for the choice of the unit that was probably meant.

    Raises
    ------
    SensorgraphError : The value is no number, has another unit, or is beyond its limit, as degrees without a unit are.
    """
    number, unit = split_unit(value)
    if not is_number(number) or (unit and unit not in dimension.units):
        such = "" if default is None else f" such as {default}"
        units = (
            f", in {dimension.words} or with a unit ({', '.join(dimension.units)})" if dimension.units else ""
        )
        raise SensorgraphError(f"{what} is {value!r}, expected a number{such}{units}")
    result = float(number) * (dimension.units[unit] if unit else 1.0)
    largest = dimension.most if unit or most is None else most
    if abs(result) > largest + (ROUNDED if dimension is ANGLE and largest == dimension.most else 0.0):
        raise SensorgraphError(
            f"{what} is {_beyond(value, float(number), unit, dimension, largest, default)}"
        )
    return result


def pose_of(values: Sequence[Any], what: str) -> list[float]:
    """Return x, y, phi [m, m, rad], each a number or a text with a unit.

    Raises
    ------
    SensorgraphError : A value is no number, or phi is more than a full turn, as degrees are.
    """
    names = ("x", "y", "phi")
    return [quantity(v, f"{what}: {name}", one) for v, name, one in zip(values, names, POSE, strict=True)]


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
    return f"{number:g}; {dimension.words} expected, at most {_text(most)}{write}"


def _text(number: float) -> str:
    return f"{round(number, 2):g}"


def split_unit(value: Any) -> tuple[Any, str]:
    """Return a number and its unit: of `120 mm`, and of `1e-3`, which YAML reads as text; another value as it is."""
    found = _NUMBER.fullmatch(value.strip().replace("−", "-")) if isinstance(value, str) else None
    if found is None:
        return value, ""
    unit = found[2].replace("**2", "²").replace("^2", "²")
    return float(found[1]), unit[:-1] + "²" if unit.endswith("2") else unit


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return (
        abs(value) < math.inf and not math.isnan(value) if isinstance(value, float) else abs(value) < 10**300
    )
