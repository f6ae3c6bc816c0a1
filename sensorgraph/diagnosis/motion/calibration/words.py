"""Names, units, materiality and possible causes of the calibrated quantities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sensorgraph.effects.effect import Effect
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.world.robot import Wheels


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """How a parameter is printed."""

    title: str
    unit: str
    factor: float
    """From SI to the unit."""
    materiality: float
    """[SI] minimum size that is reported."""
    causes: str
    """Possible causes of a change."""

    def text(self, value: float, stderr: float, *, sign: bool = True) -> str:
        """Return value and standard error in the unit."""
        digits = max(0, min(3, 1 - int(np.floor(np.log10(max(abs(self.factor * stderr), 1e-3))))))
        number = f"{self.factor * value:{'+' if sign else ''}.{digits}f}".replace("-", "−")
        space = "" if self.unit.startswith("°") else " "
        return f"{number}{space}{self.unit} ± {self.factor * stderr:.{digits}f}{space}{self.unit}"


def _material(effect: Effect, index: int = 0) -> float:
    """Return the materiality of a parameter of an effect."""
    size = effect.parameters[index].materiality
    assert size is not None
    return size


QUANTITIES: Mapping[str, Quantity] = {
    "way_scale": Quantity(
        title="distance scale",
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
        causes="a change of tyre, load or floor, which moves the contact points of the wheels",
    ),
    "heading_bias": Quantity(
        title="heading bias",
        unit="°/m",
        factor=float(np.degrees(1.0)),
        materiality=_material(WHEEL_RADIUS_DIFF, 0) / Wheels().base,
        causes="pressure loss or wear of one tyre, or a load on one side",
    ),
    "mount_x": Quantity(
        title="mount x",
        unit="cm",
        factor=100.0,
        materiality=_material(MOUNT_XY, 0),
        causes="the laser was moved, or a load shifts the centre of rotation",
    ),
    "mount_y": Quantity(
        title="mount y",
        unit="cm",
        factor=100.0,
        materiality=_material(MOUNT_XY, 1),
        causes="the laser was moved",
    ),
    "mount_phi": Quantity(
        title="mount angle",
        unit="°",
        factor=float(np.degrees(1.0)),
        materiality=_material(MOUNT_YAW, 0),
        causes="the laser was knocked, or the robot slides sideways on another floor",
    ),
    "delay": Quantity(
        title="scan delay",
        unit="ms",
        factor=1e3,
        materiality=0.01,
        causes="another driver, or a busy computer",
    ),
}
EFFECT_OF: Mapping[str, str] = {
    "way_scale": WHEEL_RADIUS.name,
    "turn_scale": WHEEL_BASE.name,
    "heading_bias": WHEEL_RADIUS_DIFF.name,
    "mount_x": MOUNT_XY.name,
    "mount_y": MOUNT_XY.name,
    "mount_phi": MOUNT_YAW.name,
    "delay": LATENCY.name,
}
"""Quantity -> effect that it becomes in a report."""
ABSORBED: Mapping[str, str] = {
    RANGE_SCALE.name: "too long ranges enlarge the map and make the wheels seem too small by the same factor, so that the "
    "distance scale is relative to the laser",
    "map_error": "the map is built from the run's own scans; its straightness is known only as far as loops close",
    "pose_error": "the poses fit the scans by construction; only motions between scans, matched without the wheels, are "
    "compared with the wheels",
}
"""What poses from the run's own scans absorb -> explanation."""
