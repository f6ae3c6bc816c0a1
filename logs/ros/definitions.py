"""ROS 2 message definitions (from rosbags) and the quality of service that makes a file play unconfigured."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

LATCHED = ("/tf_static", "/map", "/plan", "/coverage")
"""Topics that a late listener must still receive."""


@cache
def typestore() -> Typestore:
    """Return the messages of ROS 2 Humble; rosbags is imported only when a file is written."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def definition(msgtype: str) -> bytes:
    """Return the concatenated ros2msg text that an MCAP schema holds."""
    text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
    return text.encode()


QUALITY = "offered_qos_profiles"
"""Key of a channel's metadata."""


def quality(topic: str) -> str:
    """Return `offered_qos_profiles` with integer policies, as rosbag2 reads them without its own metadata.

    A text policy there crashes players (ros2/rosbag2 #1125); without transient_local a late listener never
    gets /tf_static (ros2/rosbag2 #1049).
    """
    is_latched = topic in LATCHED
    infinite = "{sec: 9223372036, nsec: 854775807}"
    return (
        f"- history: 1\n  depth: {1 if is_latched else 10}\n  reliability: 1\n"
        f"  durability: {1 if is_latched else 2}\n  deadline: {infinite}\n  lifespan: {infinite}\n"
        f"  liveliness: 1\n  liveliness_lease_duration: {infinite}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )
