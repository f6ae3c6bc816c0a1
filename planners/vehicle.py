"""Vehicle: the robot as planners need it; `sensorgraph.world.robot.Robot` is a Vehicle with a sensor."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import numpy as np

Drive = Literal["diff", "reeds_shepp", "dubins"]
DRIVES: tuple[str, ...] = get_args(Drive)
SHORTEST_ARC = 0.01
"""[m] minimum length of a car's arc, because steering takes time. A constant of compiled code, see
`planners.kernel`."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of the drive.

    Raises
    ------
    ValueError : A limit is not positive, or the turning radius is negative.
    """

    v: float = 0.4
    """[m/s] maximum forward speed (and backward, unless the drive is `dubins`)."""
    omega: float = 1.0
    """[rad/s] maximum turn rate, in both directions."""
    a: float = 0.5
    """[m/s²] maximum rate of change of v."""
    alpha: float = 2.0
    """[rad/s²] maximum rate of change of omega."""
    turning_radius: float = 0.0
    """[m] minimum turning radius of a car; 0 for a robot that turns in place."""

    @property
    def v_on_arc(self) -> float:
        """[m/s] maximum speed of a car on an arc of minimum radius, where omega limits it too."""
        return min(self.v, self.omega * self.turning_radius)

    @property
    def a_on_arc(self) -> float:
        """[m/s²] maximum acceleration of a car on an arc of minimum radius, where alpha limits it too."""
        return min(self.a, self.alpha * self.turning_radius)

    def __post_init__(self) -> None:
        for name in ("v", "omega", "a", "alpha"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"limits.{name} is {value}, expected a positive number")
        if not (np.isfinite(self.turning_radius) and self.turning_radius >= 0):
            raise ValueError(f"limits.turning_radius is {self.turning_radius}, expected 0 or more")


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A disc that turns in place, or a car.

    Raises
    ------
    ValueError : The drive is unknown, the radius is not positive, or a car has no turning radius.
    """

    name: str = "radix"
    drive: Drive = "diff"
    footprint_radius: float = 0.20
    """[m] radius of the disc around `base_link` that must stay free."""
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        if self.drive not in DRIVES:
            raise ValueError(f"drive is {self.drive!r}, expected one of {', '.join(DRIVES)}")
        if not (np.isfinite(self.footprint_radius) and self.footprint_radius > 0):
            raise ValueError(f"footprint_radius is {self.footprint_radius}, expected a positive number")
        if self.drive != "diff" and self.limits.turning_radius <= 0:
            raise ValueError(
                f"drive {self.drive!r} is a car and needs limits.turning_radius > 0, "
                f"got {self.limits.turning_radius}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return name, drive, radius and limits as plain data; fields of subclasses are left out."""
        return {
            "name": self.name,
            "drive": self.drive,
            "footprint_radius": self.footprint_radius,
            "limits": asdict(self.limits),
        }
