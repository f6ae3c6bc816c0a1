"""Names, units and resolutions of the quantities that a fleet is compared by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Label:
    """How a quantity is printed."""

    title: str
    unit: str
    factor: float
    """From SI to the unit."""
    neutral: float
    """[SI] Value of a robot as described, where it is not the robot's own."""
    resolution: float
    """[SI] Standard error that every log has at least; two drives of one robot differ by as much."""

    def change(self, size: float, sigma: float) -> str:
        """Return a change with its standard error, of which one digit at least is shown, in the unit."""
        digits = next((n for n in (1, 2) if self.factor * sigma >= 10.0**-n), 3)
        value = f"{self.factor * size:+.{digits}f}".replace("-", "−")
        unit = self.unit if self.unit.startswith("°") else f" {self.unit}"
        return f"{value}{unit} ± {self.factor * sigma:.{digits}f}{unit}"

    def shown(self, value: float, sigma: float) -> str:
        """Return a value with its standard error, relative to the neutral one."""
        return self.change(value - self.neutral, sigma)


LABELS: Mapping[str, Label] = {
    "left_wheel": Label(title="left wheel", unit="%", factor=100.0, neutral=1.0, resolution=0.0005),
    "right_wheel": Label(title="right wheel", unit="%", factor=100.0, neutral=1.0, resolution=0.0005),
    "wheel_difference": Label(
        title="right minus left wheel", unit="%", factor=100.0, neutral=0.0, resolution=0.0005
    ),
    "way_scale": Label(title="distance scale", unit="%", factor=100.0, neutral=1.0, resolution=0.0005),
    "turn_scale": Label(title="turn scale", unit="%", factor=100.0, neutral=1.0, resolution=0.0005),
    "heading_bias": Label(title="heading bias", unit="°/m", factor=57.2958, neutral=0.0, resolution=0.0002),
    "mount_x": Label(title="laser ahead", unit="cm", factor=100.0, neutral=0.0, resolution=0.0005),
    "mount_y": Label(title="laser to the left", unit="cm", factor=100.0, neutral=0.0, resolution=0.0005),
    "mount_phi": Label(title="yaw of the laser", unit="°", factor=57.2958, neutral=0.0, resolution=0.0005),
    "delay": Label(title="delay of the scans", unit="ms", factor=1000.0, neutral=0.0, resolution=0.001),
    "range_offset": Label(
        title="offset of the ranges", unit="cm", factor=100.0, neutral=0.0, resolution=0.0005
    ),
}
QUANTITIES = tuple(LABELS)


def quantities_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the quantities to compare: each wheel if its size is known, else distance and heading."""
    known = {name for row in rows for name in row["quantities"]}
    redundant = {"way_scale", "heading_bias"} if "left_wheel" in known else set()
    return [name for name in QUANTITIES if name in known - redundant]
