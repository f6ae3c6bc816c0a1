"""Families of structure of the motion channels that no effect of the library explains: names and titles."""

from __future__ import annotations

from collections.abc import Mapping

from sensorgraph.diagnosis.motion.motor_structure import DRIVE_FAMILIES
from sensorgraph.diagnosis.motion.wheel_structure import ODOMETRY_FAMILIES

FAMILIES_OF: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "odometry": ODOMETRY_FAMILIES,
    "drive": DRIVE_FAMILIES,
}
"""Channel -> its families."""
