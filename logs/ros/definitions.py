"""ROS 2 message definitions (from rosbags), and the quality of service with which players replay a file."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

LATCHED = ("/tf_static", "/map", "/plan", "/coverage")
"""Topics that a late subscriber must receive."""


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Humble; rosbags is imported only when a file is written."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def definition(msgtype: str) -> bytes:
    """Return the concatenated ros2msg text for an MCAP schema."""
    text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
    return text.encode()


def message(msgtype: str, **values: Any) -> Any:
    """Return a message; a field that is not given is 0, empty, or such a message."""
    from rosbags.interfaces import Nodetype

    def default(kind: Any, of: Any) -> Any:
        if kind == Nodetype.NAME:
            return message(of)
        if kind == Nodetype.BASE:
            return "" if of[0] == "string" else np.dtype(of[0]).type(0).item()
        ((inner, base), length) = of
        return np.zeros(length, base[0]) if inner == Nodetype.BASE and base[0] != "string" else []

    fields = typestore().fielddefs[msgtype][1]
    made = {name: values[name] if name in values else default(*kind) for name, kind in fields}
    return typestore().types[msgtype](**made)


def header(ns: int) -> Any:
    """Return the header of a message in map at a time [ns]."""
    stamp = message(TIME_TYPE, sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id="map")


def serialized(msgtype: str, **values: Any) -> bytes:
    """Return a message as CDR."""
    return bytes(typestore().serialize_cdr(message(msgtype, **values), msgtype))


TIME_TYPE = "builtin_interfaces/msg/Time"
QUALITY = "offered_qos_profiles"
"""Key in the metadata of a channel."""


def quality(topic: str) -> str:
    """Return `offered_qos_profiles` with integer policies, as rosbag2 reads them without a metadata.yaml.

    A text policy crashes players (ros2/rosbag2 #1125). Without transient_local, a late subscriber does not receive
    /tf_static (ros2/rosbag2 #1049).
    """
    is_latched = topic in LATCHED
    infinite = "{sec: 9223372036, nsec: 854775807}"
    return (
        f"- history: 1\n  depth: {1 if is_latched else 10}\n  reliability: 1\n"
        f"  durability: {1 if is_latched else 2}\n  deadline: {infinite}\n  lifespan: {infinite}\n"
        f"  liveliness: 1\n  liveliness_lease_duration: {infinite}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )
