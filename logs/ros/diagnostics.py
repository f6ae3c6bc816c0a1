"""DiagnosticArray and MarkerArray messages: statements with levels, and outlines in map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from logs.ros.definitions import header, message, serialized
from logs.types import Floats

DIAGNOSTICS_TYPE, MARKERS_TYPE = "diagnostic_msgs/msg/DiagnosticArray", "visualization_msgs/msg/MarkerArray"
OK, WARN, ERROR, STALE = range(4)
"""Levels of a diagnostic status."""
MARKER_TYPE, LINE_STRIP, DELETE_ALL = "visualization_msgs/msg/Marker", 4, 3
LINE_WIDTH = 0.05
"""[m]"""


@dataclass(frozen=True, kw_only=True)
class DiagnosticStatement:
    """One status of a DiagnosticArray."""

    level: int
    name: str
    message: str
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class OutlineMarker:
    """One closed line in map."""

    namespace: str
    points: Floats
    """(n, 2) [m]"""
    colour: tuple[float, float, float]
    """Red, green and blue, 0 to 1."""


def diagnostic_message(ns: int, statements: Sequence[DiagnosticStatement]) -> bytes:
    """Return a DiagnosticArray as CDR, with the stamp `ns` [ns]."""
    each = [
        message(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=one.level, name=one.name, message=one.message, hardware_id=one.hardware_id,
            values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in one.values.items()],
        )
        for one in statements
    ]  # fmt: skip
    return serialized(DIAGNOSTICS_TYPE, header=header(ns), status=each)


def marker_message(ns: int, outlines: Sequence[OutlineMarker]) -> bytes:
    """Return a MarkerArray as CDR that replaces all earlier markers of its topic."""
    delete = message(MARKER_TYPE, header=header(ns), action=DELETE_ALL)
    return serialized(
        MARKERS_TYPE, markers=[delete, *(_marker(ns, k, one) for k, one in enumerate(outlines))]
    )


def _marker(ns: int, number: int, one: OutlineMarker) -> Any:
    red, green, blue = one.colour
    upright = message("geometry_msgs/msg/Quaternion", w=1.0)
    return message(
        MARKER_TYPE, header=header(ns), ns=one.namespace, id=number, type=LINE_STRIP,
        pose=message("geometry_msgs/msg/Pose", orientation=upright),
        scale=message("geometry_msgs/msg/Vector3", x=LINE_WIDTH),
        color=message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        points=[message("geometry_msgs/msg/Point", x=float(x), y=float(y)) for x, y in one.points],
    )  # fmt: skip
