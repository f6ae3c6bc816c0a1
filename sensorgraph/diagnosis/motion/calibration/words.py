"""Calibration in the words of a robot engineer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sensorgraph.effects.effect import Effect
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF

USUAL_BASE = 0.4
"""[m] between the wheels of a robot that nobody has described: only to say when a heading bias matters."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """How a parameter is written."""

    title: str
    unit: str
    factor: float
    """From SI to the unit."""
    materiality: float
    """[SI] smaller is not worth a word."""
    causes: str
    """What changes it."""

    def text(self, value: float, stderr: float, *, sign: bool = True) -> str:
        """Return value and standard error in the unit."""
        digits = max(0, min(3, 1 - int(np.floor(np.log10(max(abs(self.factor * stderr), 1e-3))))))
        number = f"{self.factor * value:{'+' if sign else ''}.{digits}f}".replace("-", "−")
        space = "" if self.unit.startswith("°") else " "
        return f"{number}{space}{self.unit} ± {self.factor * stderr:.{digits}f}{space}{self.unit}"


def _material(effect: Effect, index: int = 0) -> float:
    """Return from which size on a parameter of an effect matters."""
    size = effect.parameters[index].materiality
    assert size is not None
    return size


QUANTITIES: Mapping[str, Quantity] = {
    "way_scale": Quantity(
        title="way scale",
        unit="%",
        factor=100.0,
        materiality=_material(WHEEL_RADIUS, 0),
        causes="tyre pressure or wear, a load, another floor, or another laser",
    ),
    "turn_scale": Quantity(
        title="turn scale",
        unit="%",
        factor=100.0,
        materiality=_material(WHEEL_BASE, 0),
        causes="a tyre, a load or a floor has changed: where the wheels touch it decides how far they are apart",
    ),
    "heading_bias": Quantity(
        title="heading bias",
        unit="°/m",
        factor=float(np.degrees(1.0)),
        materiality=_material(WHEEL_RADIUS_DIFF, 0) / USUAL_BASE,
        causes="one tyre has lost pressure or worn, or a load sits on one side",
    ),
    "mount_x": Quantity(
        title="laser ahead of the axle",
        unit="cm",
        factor=100.0,
        materiality=_material(MOUNT_XY, 0),
        causes="the laser was moved, or a load shifts the point about which the robot turns",
    ),
    "mount_y": Quantity(
        title="laser to the left",
        unit="cm",
        factor=100.0,
        materiality=_material(MOUNT_XY, 1),
        causes="the laser was moved",
    ),
    "mount_phi": Quantity(
        title="laser turned",
        unit="°",
        factor=float(np.degrees(1.0)),
        materiality=_material(MOUNT_YAW, 0),
        causes="the laser was knocked, or the robot slides sideways on another floor",
    ),
}
ABSORBED: Mapping[str, str] = {
    RANGE_SCALE.name: "a laser whose ranges are all too long makes the map larger and the wheels look too small alike: the "
    "way scale is that of wheels against laser",
    "map_error": "the map is made of the run's own scans; nothing tells whether it is straight beyond what loops close",
    "pose_error": "the poses fit the scans by construction; only motions from scan to scan, matched without the wheels, "
    "are compared with these",
}
"""What poses from the run's own scans absorb -> in words."""
