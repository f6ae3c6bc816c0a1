"""DiagnosticArray and MarkerArray messages: statements with levels, and outlines in map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from logs.ros.definitions import typestore
from logs.types import Floats

DIAGNOSTICS_TYPE, MARKERS_TYPE = "diagnostic_msgs/msg/DiagnosticArray", "visualization_msgs/msg/MarkerArray"
OK, WARN, ERROR, STALE = range(4)
"""Levels of a diagnostic status."""
LINE_STRIP, ADD, DELETE_ALL = 4, 0, 3
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
    store, types = typestore(), typestore().types
    status, pair = types["diagnostic_msgs/msg/DiagnosticStatus"], types["diagnostic_msgs/msg/KeyValue"]
    each = [
        status(
            level=one.level, name=one.name, message=one.message, hardware_id=one.hardware_id,
            values=[pair(key=key, value=value) for key, value in one.values.items()],
        )
        for one in statements
    ]  # fmt: skip
    message = types[DIAGNOSTICS_TYPE](header=_header(ns), status=each)
    return bytes(store.serialize_cdr(message, DIAGNOSTICS_TYPE))


def marker_message(ns: int, outlines: Sequence[OutlineMarker]) -> bytes:
    """Return a MarkerArray as CDR that replaces all earlier markers of its topic."""
    store, types = typestore(), typestore().types
    markers = [_marker(ns, k, one) for k, one in enumerate(outlines)]
    nothing = OutlineMarker(namespace="", points=_no_points(), colour=(0.0, 0.0, 0.0))
    message = types[MARKERS_TYPE](markers=[_marker(ns, 0, nothing, DELETE_ALL), *markers])
    return bytes(store.serialize_cdr(message, MARKERS_TYPE))


def _no_points() -> Floats:
    import numpy as np

    return np.zeros((0, 2))


def _header(ns: int) -> Any:
    types = typestore().types
    time = types["builtin_interfaces/msg/Time"](sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
    return types["std_msgs/msg/Header"](stamp=time, frame_id="map")


def _marker(ns: int, number: int, one: OutlineMarker, action: int = ADD) -> Any:
    import numpy as np

    types = typestore().types
    point, colour = types["geometry_msgs/msg/Point"], types["std_msgs/msg/ColorRGBA"]
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    pose = types["geometry_msgs/msg/Pose"](
        position=point(x=0.0, y=0.0, z=0.0), orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    red, green, blue = one.colour
    known = {
        "header": _header(ns), "ns": one.namespace, "id": number, "type": LINE_STRIP, "action": action, "pose": pose,
        "scale": vector(x=LINE_WIDTH, y=0.0, z=0.0), "color": colour(r=red, g=green, b=blue, a=1.0),
        "lifetime": types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0), "frame_locked": False,
        "points": [point(x=float(x), y=float(y), z=0.0) for x, y in one.points], "colors": [],
        "texture_resource": "", "texture": types["sensor_msgs/msg/CompressedImage"](
            header=_header(ns), format="", data=np.zeros(0, dtype=np.uint8)
        ),
        "uv_coordinates": [], "text": "",
        "mesh_resource": "", "mesh_file": types["visualization_msgs/msg/MeshFile"](filename="", data=np.zeros(0, dtype=np.uint8)),
        "mesh_use_embedded_materials": False,
    }  # fmt: skip
    marker: Any = types["visualization_msgs/msg/Marker"]
    return marker(**{name: known[name] for name in marker.__dataclass_fields__ if name in known})
