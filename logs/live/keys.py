"""Topic names of rmw_zenoh: key expressions of the data, and the liveliness tokens that announce publishers.

Source: the design page of ros2/rmw_zenoh. Humble uses `TypeHashNotSupported` in place of the hash of the type
definition. The definitions of the types read here are the same in all distributions.
"""

from __future__ import annotations

from dataclasses import dataclass

ADMIN_SPACE = "@ros2_lv"
PUBLISHER = "MP"
TRANSIENT_LOCAL = "1"
N_PARTS = 13
"""Parts of a token: space, domain, session, node, entity, kind, enclave, namespace, node, topic, type, hash, quality."""


@dataclass(frozen=True, kw_only=True)
class PublishedTopic:
    """A topic that a publisher announces."""

    name: str
    type: str
    is_latched: bool = False
    """Whether a late subscriber receives the last message."""


def tokens_of(domain: int) -> str:
    """Return the key expression of the tokens of all publishers in a domain."""
    return f"{ADMIN_SPACE}/{domain}/*/*/*/{PUBLISHER}/**"


def parse_token(key: str) -> PublishedTopic | None:
    """Parse the token of a publisher; None if the key is not such a token."""
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
    """Return the key expression of the messages of a topic, for any type hash."""
    return f"{domain}/{topic.name.strip('/')}/{dds_type(topic.type)}/*"


NO_HASH = "TypeHashNotSupported"
"""Hash of every type in Humble."""


def type_hash(key: str) -> str:
    """Return the hash of the type in a token."""
    return key.split("/")[11]


def publisher_tokens(
    domain: int, session: str, number: int, topic: PublishedTopic, hash_text: str
) -> tuple[str, str]:
    """Return the tokens of a node, and of its publisher number `number`, for a topic that is not latched."""
    node = f"{ADMIN_SPACE}/{domain}/{session}/0"
    named = topic.name.replace("/", "%")
    quality = "::,10:,:,:,,"
    return (
        f"{node}/0/NN/%/%/sensorgraph_watch",
        f"{node}/{number}/{PUBLISHER}/%/%/sensorgraph_watch/{named}/{dds_type(topic.type)}/{hash_text}/{quality}",
    )


def ros_type(name: str) -> str:
    """Return `sensor_msgs/msg/LaserScan` of `sensor_msgs::msg::dds_::LaserScan_`."""
    return name.replace("::dds_::", "::").removesuffix("_").replace("::", "/")


def dds_type(name: str) -> str:
    """Return `sensor_msgs::msg::dds_::LaserScan_` of `sensor_msgs/msg/LaserScan`."""
    head, _, last = name.rpartition("/")
    return f"{head.replace('/', '::')}::dds_::{last}_"
