"""How rmw_zenoh names topics: key expressions of data, and the tokens by which publishers announce themselves.

Source: the design page of ros2/rmw_zenoh. Humble writes `TypeHashNotSupported` where later distributions write the
hash of a type's definition; the definitions of the types read here are the same in all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

ADMIN_SPACE = "@ros2_lv"
PUBLISHER = "MP"
TRANSIENT_LOCAL = "1"
N_PARTS = 13
"""Of a token: space, domain, session, node, entity, kind, enclave, namespace, node, topic, type, hash, quality."""


@dataclass(frozen=True, kw_only=True)
class PublishedTopic:
    """What a publisher announces."""

    name: str
    type: str
    is_latched: bool = False
    """A late listener still gets the last message."""


def tokens_of(domain: int) -> str:
    """Return the key expression of all publishers' tokens of a domain."""
    return f"{ADMIN_SPACE}/{domain}/*/*/*/{PUBLISHER}/**"


def parse_token(key: str) -> PublishedTopic | None:
    """Read what a publisher's token announces; None: it is no such token."""
    parts = key.split("/")
    if len(parts) != N_PARTS or parts[0] != ADMIN_SPACE or parts[5] != PUBLISHER:
        return None
    quality = parts[12].split(":")
    return PublishedTopic(
        name="/" + parts[9].replace("%", "/").lstrip("/"),
        type=ros_type(parts[10]),
        is_latched=len(quality) > 1 and quality[1] == TRANSIENT_LOCAL,
    )


def data_key(domain: int, topic: PublishedTopic) -> str:
    """Return the key expression of a topic's messages, whatever the distribution calls its type's hash."""
    return f"{domain}/{topic.name.strip('/')}/{dds_type(topic.type)}/*"


def ros_type(name: str) -> str:
    """Return `sensor_msgs/msg/LaserScan` of `sensor_msgs::msg::dds_::LaserScan_`."""
    return name.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


def dds_type(name: str) -> str:
    """Return `sensor_msgs::msg::dds_::LaserScan_` of `sensor_msgs/msg/LaserScan`."""
    head, _, last = name.rpartition("/")
    return f"{head.replace('/', '::')}::dds_::{last}_"
